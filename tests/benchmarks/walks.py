"""Noisy walks towards the objects, and the bare Chipmunk loops that go the same way."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass
from unittest import mock

import numpy as np

from visualrhp.scene import Scene, SceneDistribution, TaskInstance, sample_task_instance
from visualrhp.simulation import GripperMotion, Physics, TransitionModel, make_action_space
from visualrhp.simulation.chipmunk import Space, lib
from visualrhp.simulation.simulator import MORE_ITERATIONS, PATIENCE, Simulator
from visualrhp.streams import Split
from visualrhp.types import Action, ActionSpaceName, State

SEED = 0
SPLIT = Split.TUNING
_LENGTH = 10


@dataclass(frozen=True)
class Walk:
    """Consecutive transitions of one task instance.

    Attributes:
        instance: scene and initial state.
        index: of the instance in its stream.
        actions: taken one after the other.
        motions: that they command.
        states: one more than actions; the first is the initial state.
        settling: substeps that each motion takes after the hand has stopped.
    """

    instance: TaskInstance
    index: int
    actions: list[Action]
    motions: list[GripperMotion]
    states: list[State]
    settling: list[int]

    @property
    def scene(self) -> Scene:
        return self.instance.scene

    @property
    def pushes(self) -> int:
        """How many of the motions move an object."""
        poses = [state.object_poses for state in self.states]
        return sum(not np.array_equal(before, after) for before, after in itertools.pairwise(poses))


def _action(space: ActionSpaceName, state: State, rng: np.random.Generator) -> Action:
    """Roughly towards the nearest object, and on where it is."""
    x, y, theta = state.gripper_pose
    c, s = math.cos(theta), math.sin(theta)
    ahead = (state.object_poses[:, :2] - (x, y)) @ [[c, -s], [s, c]]
    forward, left = ahead[np.argmin(np.linalg.norm(ahead, axis=1))]
    if space == "discrete":
        if rng.random() < 0.3:
            return int(rng.integers(8))
        return 0 if forward > abs(left) else 2 if left > 0.0 else 3
    wanted = [max(forward / 0.1, 0.3), left / 0.1, math.atan2(left, max(forward, 0.05)) / math.radians(50.0)]
    action = np.append(np.clip(wanted, -1.0, 1.0) + rng.normal(0.0, 0.2, 3), rng.choice([-1.0, 1.0]))
    return np.clip(action, -1.0, 1.0)


def distribution(num_objects: int) -> SceneDistribution:
    """Scenes of ``num_objects`` objects."""
    return SceneDistribution(num_objects=(num_objects, num_objects))


def random_walks(num_objects: int, motions: int, space: ActionSpaceName = "continuous") -> list[Walk]:
    """Walks of up to ten actions, ``motions`` of them in all; one that ends the episode ends the walk."""
    walks, missing, index = [], motions, 0
    while missing > 0:
        instance = sample_task_instance(distribution(num_objects), SEED, SPLIT, index)
        model = TransitionModel(instance.scene, make_action_space(space))
        rng = np.random.default_rng(index)
        motion_of = model.action_space.motion
        actions, states, settling = [], [instance.state], []
        while len(actions) < min(_LENGTH, missing):
            actions.append(_action(space, states[-1], rng))
            with mock.patch.object(Simulator, "step", autospec=True, side_effect=Simulator.step) as step:
                transition = model.simulate(states[-1], actions[-1])
            settling.append(sum(call.args[2] for call in step.call_args_list) - Physics().motion_steps)
            states.append(transition.next_state)
            if transition.is_terminal:
                break
        walks.append(Walk(instance, index, actions, [motion_of(action) for action in actions], states, settling))
        missing -= len(actions)
        index += 1
    return walks


def _bare_loop(simulator: Simulator, space: Space, walk: Walk, number: int) -> float:
    """The substeps of one motion, by the calls into Chipmunk that the simulator makes; how long they took [s]."""
    settling = walk.settling[number]
    patient = min(settling, PATIENCE)
    closed = walk.states[number + 1].gripper_closed
    start = time.process_time()
    lib.cpSpaceSetIterations(space, simulator.physics.iterations)
    lib.cpSimpleMotorSetRate(simulator.motor, simulator.closing_rate if closed else -simulator.closing_rate)
    simulator.move(space, walk.states[number], walk.motions[number])
    simulator.step(space, patient)
    if settling > patient:
        lib.cpSpaceSetIterations(space, MORE_ITERATIONS * simulator.physics.iterations)
        simulator.step(space, settling - patient)
    return time.process_time() - start


def simulators(walks: list[Walk]) -> list[Simulator]:
    """One for each walk's scene."""
    return [Simulator(walk.scene, Physics()) for walk in walks]


def bare_seconds(walks: list[Walk], of: list[Simulator]) -> float:
    """Time of the substeps of a motion alone [s], from the same state; the mean over ``walks``."""
    total = 0.0
    for walk, simulator in zip(walks, of, strict=True):
        for number, state in enumerate(walk.states[:-1]):
            space = simulator.begin(state, state.gripper_closed)
            total += _bare_loop(simulator, space, walk, number)
            lib.cpSpaceFree(space)
    return total / count(walks)


def unrestored_seconds(walks: list[Walk], of: list[Simulator]) -> float:
    """Time of a motion [s] in spaces that are set up once a walk and never restored.

    An object sleeps until the robot touches it for the first time; in the simulator, for the first time in a motion.
    """
    total = 0.0
    for walk, simulator in zip(walks, of, strict=True):
        space = simulator.begin(walk.states[0], walk.states[0].gripper_closed)
        total += sum(_bare_loop(simulator, space, walk, number) for number in range(len(walk.motions)))
        lib.cpSpaceFree(space)
    return total / count(walks)


def advance_seconds(walks: list[Walk], of: list[Simulator]) -> float:
    """Time of a motion in the exact simulator [s], the mean over ``walks``."""
    start = time.process_time()
    for walk, simulator in zip(walks, of, strict=True):
        for state, motion in zip(walk.states, walk.motions, strict=False):
            simulator.advance(state, motion)
    return (time.process_time() - start) / count(walks)


def count(walks: list[Walk]) -> int:
    """Motions in all."""
    return sum(len(walk.motions) for walk in walks)
