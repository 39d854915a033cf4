"""Closed-loop K.RRT: open loop where the model is the world, a new plan where it is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from tests.planning.conftest import LEFT, RIGHT, at
from visualrhp.execution.episode import run_task
from visualrhp.planning import ClosedLoopKRRT, KinodynamicRRT, PlanningModel, SearchResult
from visualrhp.scene import NOISE_LEVELS, SceneDistribution, sample_task_instance
from visualrhp.simulation import MAX_ACTIONS, make_action_space
from visualrhp.streams import Split
from visualrhp.types import State

SMALL = KinodynamicRRT(max_simulations=2000)


@dataclass(frozen=True)
class CountedRRT(KinodynamicRRT):
    """Records the action limit of each search."""

    limits: list[int] = field(default_factory=list)

    def search(
        self, model: PlanningModel, state: State, rng: np.random.Generator, max_actions: int = MAX_ACTIONS - 1
    ) -> SearchResult:
        self.limits.append(max_actions)
        return super().search(model, state, rng, max_actions)


@pytest.mark.parametrize("keep_plan", [True, False])
def test_nothing_is_planned_again_while_the_world_does_as_foreseen(
    line_world: Callable[..., Any], keep_plan: bool
) -> None:
    rrt = CountedRRT()
    policy = ClosedLoopKRRT(rrt, keep_plan).start(line_world(goal=3), np.random.default_rng(0))
    assert [policy(at(cell)).action for cell in (0, 1, 2)] == [RIGHT, RIGHT, RIGHT]
    assert rrt.limits == [49]


def test_an_unforeseen_state_is_planned_in_with_the_actions_that_are_left(line_world: Callable[..., Any]) -> None:
    rrt = CountedRRT()
    policy = ClosedLoopKRRT(rrt).start(line_world(goal=3), np.random.default_rng(0))
    assert policy(at(0)).action == RIGHT
    assert policy(at(5)).action == LEFT  # pushed past the goal
    assert policy(at(4)).action == LEFT
    assert rrt.limits == [49, 48]


def test_a_plan_that_still_leads_to_the_goal_is_kept(line_world: Callable[..., Any]) -> None:
    for keep_plan, limits in ((True, [49]), (False, [49, 48])):
        rrt = CountedRRT()
        policy = ClosedLoopKRRT(rrt, keep_plan).start(line_world(goal=3), np.random.default_rng(0))
        assert policy(at(0)).action == RIGHT  # leaves two steps to the right
        assert policy(at(2)).action == RIGHT  # of which one is enough
        assert rrt.limits == limits


def test_without_a_new_plan_the_old_one_is_followed_and_then_given_up(line_world: Callable[..., Any]) -> None:
    policy = ClosedLoopKRRT(SMALL).start(line_world(goal=3), np.random.default_rng(0))
    assert policy(at(0)).action == RIGHT
    hopeless = at(-9)  # dropped: every action leads to a drop, or nowhere
    assert [policy(hopeless).action for _ in range(3)] == [RIGHT, RIGHT, None]
    gives_up = ClosedLoopKRRT(SMALL).start(line_world(goal=10**6), np.random.default_rng(0))
    assert gives_up(at(0)).action is None


@pytest.mark.parametrize("action_space", ["continuous", "discrete"])
def test_it_is_open_loop_k_rrt_without_noise_and_recovers_with_it(action_space: Any) -> None:
    def outcomes(planner: Any, noise: str) -> list[tuple[bool, int]]:
        results = [
            run_task(
                planner,
                sample_task_instance(SceneDistribution(), 5, Split.TUNING, index),
                5,
                Split.TUNING,
                index,
                action_space=make_action_space(action_space),
                noise=NOISE_LEVELS[noise],
            )
            for index in range(6)
        ]
        return [(result.success, result.num_actions) for result in results]

    open_loop, closed_loop = KinodynamicRRT(), ClosedLoopKRRT(KinodynamicRRT(max_simulations=20000))
    assert outcomes(closed_loop, "none") == outcomes(open_loop, "none")
    successes = [sum(success for success, _ in outcomes(planner, "high")) for planner in (open_loop, closed_loop)]
    assert successes[0] < successes[1] and successes[1] >= 5
