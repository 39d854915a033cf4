"""Faults of every device of a robot cell in episodes: no blind motion, a named end, and the arm at rest.

One case is an episode with one fault (kind, begin and duration are random) in a cell on the planar simulator; one in
:data:`MUJOCO_EVERY` is in the cell in MuJoCo. Counted are the faults that have shown, the blind
motions (:mod:`tests.torture.robot_monitor`) and surprises: an exception, an end without a name, an arm that is not at
rest, or a robot that was not stopped.
"""

from __future__ import annotations

import traceback
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from tests.embodiment.planar_cell import PlanarCell, PlanarKinematics, planar_task
from tests.torture.robot_faults import KINDS, FaultyCell, FaultyPerception, FaultyPlanner
from tests.torture.robot_monitor import Fault, MonitoredCell
from visualrhp.embodiment.guarded_planner import GuardedPlanner
from visualrhp.embodiment.robot_world import RobotWorld
from visualrhp.errors import CellFault, PerceptionError
from visualrhp.execution import EpisodeResult, run_episode
from visualrhp.planning.planner import Decision, Planner
from visualrhp.scene.scene import ObjectShape
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.types import Outcome, State

MUJOCO_EVERY = 50
_LATEST_S = 8.0
_MOST_ACTIONS = 12
_BRAKING_S = 0.5  # for a stop in motion, after a fault that leaves the loop unable to see the rest
_MOST_EXAMPLES = 10
_FAR = 1_000_000


class Wandering(Planner):
    """Moves to and fro at random, and gives up after some actions."""

    name = "Wandering"

    def __init__(self, num_actions: int = _MOST_ACTIONS) -> None:
        self.num_actions = num_actions

    def start(self, model, rng):
        left = self.num_actions

        def policy(state: State) -> Decision:
            nonlocal left
            left -= 1
            inwards = -state.gripper_position
            c, s = np.cos(state.gripper_pose[2]), np.sin(state.gripper_pose[2])
            ahead = np.array([c * inwards[0] + s * inwards[1], c * inwards[1] - s * inwards[0]])
            action = np.clip(rng.normal(0.0, 0.4, 4) + 2.0 * np.array([*ahead, 0.0, 0.0]), -1.0, 1.0)
            return Decision(action if left >= 0 else None)

        return policy


class PlanarCase:
    """A cell on the planar simulator, and how its scene is disturbed."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([seed, 1])
        self.cell = PlanarCell(planar_task(0, seed % 40, num_objects=1 + seed % 3), seed)
        self.kinematics = PlanarKinematics()

    def truth(self):
        return self.cell.scene, self.cell.state

    def disturb(self, kind: str) -> None:
        """Change the true scene."""
        cell = self.cell
        state, poses = cell.state, cell.state.object_poses.copy()
        shapes = cell.scene.objects
        match kind:
            case "vanished" if len(shapes) > 1:
                poses, shapes = poses[:-1], shapes[:-1]
            case "appeared":
                square = 0.015 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
                shapes = (*shapes, ObjectShape(square))
                poses = np.vstack([poses, [*self.rng.uniform(-0.2, 0.2, 2), 0.0]])
            case "dropped":
                poses[-1, :2] = 0.3, 0.1
            case _:
                poses[int(self.rng.integers(len(poses))), :2] += self.rng.choice([-0.07, 0.07], 2)
        cell.change(replace(cell.scene, objects=shapes), state, poses)


class MujocoCase:
    """The cell in MuJoCo, seen by its true state."""

    def __init__(self, seed: int) -> None:
        from visualrhp.embodiment.kinematics import ArmKinematics
        from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
        from visualrhp.embodiment.simulated_cell.sampling import CellDistribution, sample_cell
        from visualrhp.streams import Split

        self.kinematics = ArmKinematics()
        self.cell = SimulatedCell(sample_cell(CellDistribution(num_objects=(2, 2)), 1, Split.TUNING, seed))

    def truth(self):
        truth = self.cell.truth()
        return truth.scene, truth.state

    def disturb(self, kind: str) -> None:
        """Hands are not simulated."""


def run_case(
    seed: int, kind: str | None = None, *, start_s: float | None = None, mujoco: bool = False
) -> tuple[Fault, MonitoredCell, Any]:
    """Run an episode with a fault; return the fault, what is true, and the result or the error."""
    rng = np.random.default_rng(seed)
    kind = kind or KINDS[seed % len(KINDS)]
    duration = float(rng.choice([0.3, 1.5, 1e9]))
    case = MujocoCase(seed) if mujoco else PlanarCase(seed)
    true = MonitoredCell(case.cell, case.truth)
    drawn_start_s = float(rng.uniform(0.0, _LATEST_S))
    fault = Fault(kind, true.now() + (drawn_start_s if start_s is None else start_s), duration)
    true.fault = fault
    told = FaultyCell(true, fault, seed)
    space = make_action_space("continuous")
    world = RobotWorld(told, FaultyPerception(true, fault, seed), case.kinematics, space, host_clock=case.cell.now)
    planner = FaultyPlanner(Wandering(4 if mujoco else _MOST_ACTIONS), true, fault, case.disturb)
    result: EpisodeResult | Exception
    try:
        model = TransitionModel(case.truth()[0], space)
        result = run_episode(GuardedPlanner(planner, world.stop), world, model, rng)
    except (CellFault, PerceptionError) as error:  # in the first look
        result = error
        if not world.fault:
            raise
    if isinstance(result, Exception) or result.outcome is Outcome.STOPPED:
        if not told.num_stops:
            raise RuntimeError(f"the robot was not stopped: {world.fault}")
    elif fault.must_stop:
        raise RuntimeError(f"the episode went on to {result.outcome!r} after '{fault.kind}'")
    case.cell.wait(_BRAKING_S)
    before = case.cell.arm().positions
    case.cell.wait(0.1)
    if np.abs(case.cell.arm().positions - before).max() > 2e-3 and kind != "drifting":
        raise RuntimeError("the arm is not at rest at the end")
    world.close()
    return fault, true, result


def run(cases: int, seed: int) -> dict[str, Any]:
    """Run episodes until ``cases`` faults have shown; faults are blind motions, surprises all else that must not be."""
    by_kind: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
    num_episodes, num_shown, num_motions, num_blind, num_surprises = 0, 0, 0, 0, 0
    examples: list[str] = []
    while num_shown < cases:
        case_seed = seed * _FAR + num_episodes
        is_mujoco = num_episodes % MUJOCO_EVERY == MUJOCO_EVERY - 1
        num_episodes += 1
        try:
            fault, true, result = run_case(case_seed, mujoco=is_mujoco)
        except Exception as error:
            num_surprises += 1
            num_shown += 1
            where = traceback.format_exc().strip().splitlines()[-3:]
            examples.append(f"{case_seed} {KINDS[case_seed % len(KINDS)]}: {error!r:.200} {where}")
            continue
        if fault.num_shown:
            num_shown += 1
            by_kind[fault.kind]["stopped" if isinstance(result, Exception) else result.outcome.value] += 1
        num_motions += true.num_motions
        num_blind += len(true.blind)
        examples += [f"{case_seed} {fault.kind}: {reason}" for reason in true.blind]
    return {
        "cases": num_shown,
        "episodes": num_episodes,
        "motions": num_motions,
        "faults": num_blind,
        "surprises": num_surprises,
        "ends": dict(sum(by_kind.values(), Counter())),
        "by_kind": {kind: dict(counts) for kind, counts in by_kind.items()},
        "examples": examples[:_MOST_EXAMPLES],
    }
