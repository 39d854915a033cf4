"""The dynamic horizon: motions end with enough progress, in the goal, or with the budget."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.planning.conftest import LEFT, RIGHT, LineWorld, at
from visualrhp.errors import ConfigError
from visualrhp.execution.episode import run_task
from visualrhp.planning import DHRRT, KinodynamicRRT
from visualrhp.planning.dhrrt import distance_to_target
from visualrhp.scene import NOISE_LEVELS, ObjectShape, Scene, SceneDistribution, TargetRegion, sample_task_instance
from visualrhp.simulation import make_action_space
from visualrhp.streams import Split


def world_with_goal(goal: int) -> LineWorld:
    """A line whose target region is in the goal cell, so that the heuristic knows of it."""
    shape = ObjectShape.centred([[0.0, 0.0], [0.03, 0.0], [0.0, 0.03]])
    edges = 99.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    scene = Scene(TargetRegion(np.array([float(goal), 0.0]), radius=0.5), (shape,), edges=edges)
    return LineWorld(goal=goal, edge=-50, scene=scene)


def test_the_heuristic_is_the_distance_from_the_edge_of_the_region() -> None:
    scene = world_with_goal(4).scene
    assert [distance_to_target(scene, at(cell)) for cell in (0, 3, 4, 6)] == [3.5, 0.5, 0.0, 1.5]


@pytest.mark.parametrize(
    ("goal", "progress", "length"),
    [(10, 1.0, 1), (10, 2.5, 3), (10, 100.0, 10), (2, 1.9, 2), (0, 1.0, 0)],
)
def test_a_motion_ends_with_the_progress_that_is_asked_for_or_in_the_goal(
    goal: int, progress: float, length: int
) -> None:
    motion = DHRRT(KinodynamicRRT(), progress).plan_motion(world_with_goal(goal), at(0), np.random.default_rng(0))
    assert motion is not None and motion.actions == (RIGHT,) * length


def test_the_horizon_ends_with_the_budget_in_the_best_state_so_far() -> None:
    planner = DHRRT(KinodynamicRRT(max_simulations=30), progress=100.0)
    motion = planner.plan_motion(world_with_goal(20), at(0), np.random.default_rng(0))
    assert 1 <= len(motion) <= 4 and set(motion.actions) == {RIGHT}  # 30 simulations are four expansions


def test_a_motion_is_executed_to_its_end_and_the_next_is_planned_from_what_is_observed() -> None:
    policy = DHRRT(KinodynamicRRT(), progress=2.0).start(world_with_goal(10), np.random.default_rng(0))
    assert [policy(at(cell)).action for cell in (0, 17)] == [RIGHT, RIGHT]
    assert [policy(at(cell)).action for cell in (18, 17)] == [LEFT, LEFT]


def test_it_gives_up_where_nothing_is_better(line_world: Callable[..., Any]) -> None:
    world = line_world(goal=10**6)  # its target region is at cell 0
    policy = DHRRT(KinodynamicRRT(max_simulations=500)).start(world, np.random.default_rng(0))
    assert policy(at(0)).action is None


def test_no_motion_passes_the_action_limit() -> None:
    policy = DHRRT(KinodynamicRRT(), progress=5.0).start(world_with_goal(60), np.random.default_rng(0))
    motions = [policy(at(step % 5)).action for step in range(49)]
    assert motions == [RIGHT] * 48 + [None]  # the last action can only be one that reaches the goal


@pytest.mark.parametrize("action_space", ["continuous", "discrete"])
def test_it_solves_tasks_in_a_world_that_departs_from_the_model(action_space: Any) -> None:
    results = [
        run_task(
            DHRRT(KinodynamicRRT(max_simulations=20000)),
            sample_task_instance(SceneDistribution(), 5, Split.TUNING, index),
            5,
            Split.TUNING,
            index,
            action_space=make_action_space(action_space),
            noise=NOISE_LEVELS["high"],
        )
        for index in range(8)
    ]
    assert sum(result.success for result in results) >= 7


@pytest.mark.parametrize("progress", [0.0, -1.0, float("nan")])
def test_progress_has_to_be_positive(progress: float) -> None:
    with pytest.raises(ConfigError, match="progress"):
        DHRRT(KinodynamicRRT(), progress)
