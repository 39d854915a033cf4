"""Noisy walks towards the objects, and the bare Chipmunk loop that goes the same way."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass

import numpy as np

from visualrhp.scene import Scene, SceneDistribution, Split, TaskInstance, sample_task_instance
from visualrhp.simulation import GripperMotion, Physics, TransitionModel, make_action_space
from visualrhp.simulation.simulator import Simulator, lib
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
    """

    instance: TaskInstance
    index: int
    actions: list[Action]
    motions: list[GripperMotion]
    states: list[State]

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
    x, y, theta = state.robot_pose
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
        actions, states = [], [instance.state]
        while len(actions) < min(_LENGTH, missing):
            actions.append(_action(space, states[-1], rng))
            transition = model.simulate(states[-1], actions[-1])
            states.append(transition.next_state)
            if transition.is_terminal:
                break
        walks.append(Walk(instance, index, actions, [model.action_space.motion(action) for action in actions], states))
        missing -= len(actions)
        index += 1
    return walks


class BareLoop:
    """The engine alone: the bodies, shapes and joints of a simulator in one space, set up once and never restored.

    It makes the same calls into Chipmunk as the simulator makes from the first to the last substep of a motion.
    """

    def __init__(self, simulator: Simulator, state: State) -> None:
        self._simulator = simulator
        self._closed = state.gripper_closed
        self._theta = state.robot_pose[2]
        self._space = lib.cpSpaceNew()
        simulator._set_up(self._space, state, self._closed)

    def run(self, motion: GripperMotion) -> float:
        """Substeps of one motion, going on from wherever the last one ended; how long they took [s]."""
        simulator, physics, space = self._simulator, self._simulator.physics, self._space
        self._closed = self._closed if motion.closed is None else motion.closed
        duration = physics.motion_steps * physics.time_step
        c, s = math.cos(self._theta), math.sin(self._theta)
        velocity = (c * motion.forward - s * motion.left) / duration, (s * motion.forward + c * motion.left) / duration
        self._theta += motion.rotation
        guide, motor, step = simulator._guide.pointer, simulator._motor.pointer, lib.cpSpaceStep
        time_step = physics.time_step
        start = time.process_time()
        lib.cpSimpleMotorSetRate(motor, simulator._closing_rate if self._closed else -simulator._closing_rate)
        lib.cpBodySetVelocity(guide, velocity)
        lib.cpBodySetAngularVelocity(guide, motion.rotation / duration)
        for _ in range(physics.motion_steps):
            step(space, time_step)
        lib.cpBodySetVelocity(guide, (0.0, 0.0))
        lib.cpBodySetAngularVelocity(guide, 0.0)
        for _ in range(physics.settle_steps):
            step(space, time_step)
        return time.process_time() - start

    def state(self) -> State:
        """Where the world is now."""
        return self._simulator._read(self._closed)

    def close(self) -> None:
        lib.cpSpaceFree(self._space)


def simulators(walks: list[Walk]) -> list[Simulator]:
    """One for each walk's scene."""
    return [Simulator(walk.scene, Physics()) for walk in walks]


def bare_seconds(walks: list[Walk], of: list[Simulator]) -> float:
    """Time of a motion in the bare loop [s], the mean over ``walks``."""
    total = 0.0
    for walk, simulator in zip(walks, of, strict=True):
        loop = BareLoop(simulator, walk.states[0])
        total += sum(loop.run(motion) for motion in walk.motions)
        loop.close()
    return total / count(walks)


def bare_pushes(walks: list[Walk], of: list[Simulator]) -> int:
    """How many motions of the bare loop move an object: that it does the same work."""
    pushes = 0
    for walk, simulator in zip(walks, of, strict=True):
        loop = BareLoop(simulator, walk.states[0])
        states = [walk.states[0]]
        for motion in walk.motions:
            loop.run(motion)
            states.append(loop.state())
        loop.close()
        pushes += Walk(walk.instance, walk.index, walk.actions, walk.motions, states).pushes
    return pushes


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
