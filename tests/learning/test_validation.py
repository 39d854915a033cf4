"""Greedy validation: the same rates as single episodes of the greedy planner, and figures by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from visualrhp.errors import ConfigError
from visualrhp.execution.episode import run_task
from visualrhp.heuristics.crafted import CostToGo
from visualrhp.heuristics.heuristic import Guidance, Heuristic, SoftmaxGuidance
from visualrhp.learning.validation import GreedyValidation
from visualrhp.planning import Greedy
from visualrhp.scene import Scene, SceneDistribution, sample_task_instance
from visualrhp.simulation import Physics, TransitionModel, make_action_space
from visualrhp.streams import Split
from visualrhp.types import Outcome, State

DISTRIBUTION = SceneDistribution(num_objects=(1, 3))
SPACE = make_action_space("discrete")
OPEN = 7
"""The action that opens the open gripper: nothing moves."""


class Always(Heuristic):
    """Prefers one action in every state."""

    action_space = "discrete"

    def __init__(self, action: int) -> None:
        self.action = action

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        return SoftmaxGuidance(np.tile(np.eye(8)[self.action], (len(states), 1)), 1.0)


class OneStepAhead(Heuristic):
    """Values every action by the handcrafted cost of the state after it."""

    action_space = "discrete"

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        rows = []
        for scene, state in zip(scenes, states, strict=True):
            model = TransitionModel(scene, SPACE)
            following = [model.simulate(state, action).next_state for action in range(8)]
            rows.append(-CostToGo()([scene] * 8, following))
        return SoftmaxGuidance(np.array(rows), 1.0)


@pytest.mark.parametrize("heuristic", [OneStepAhead(), Always(0)], ids=["one step ahead", "always forward"])
def test_the_rates_are_those_of_the_greedy_planner_on_the_same_instances(heuristic: Heuristic) -> None:
    num_instances = 8
    found = GreedyValidation(DISTRIBUTION, num_instances, seed=2)(heuristic)
    results = []
    for index in range(num_instances):
        task = sample_task_instance(DISTRIBUTION, 2, Split.VALIDATION, index)
        results.append(run_task(Greedy(heuristic), task, 2, Split.VALIDATION, index, action_space=SPACE))
    solved = [result for result in results if result.outcome is Outcome.SUCCESS]
    dropped = [result for result in results if result.outcome is Outcome.DROPPED]
    assert solved if isinstance(heuristic, OneStepAhead) else dropped
    assert found["success_rate"] == len(solved) / num_instances
    assert found["dropped_rate"] == len(dropped) / num_instances
    if solved:
        assert found["num_actions"] == np.mean([result.num_actions for result in solved])
        efficiencies = [result.num_objects / result.num_actions for result in solved]
        assert found["action_efficiency"] == pytest.approx(np.mean(efficiencies))


def test_without_a_success_the_means_are_zero() -> None:
    found = GreedyValidation(DISTRIBUTION, 2, seed=0)(Always(OPEN))
    assert found == {"success_rate": 0.0, "dropped_rate": 0.0, "action_efficiency": 0.0, "num_actions": 0.0}


def test_no_instances_are_an_error() -> None:
    with pytest.raises(ConfigError, match="num_instances=0"):
        GreedyValidation(DISTRIBUTION, 0, seed=0)


@pytest.mark.parametrize("physics", [None, Physics(motion_steps=20)], ids=["default", "shorter motions"])
def test_the_instances_are_those_of_the_split_with_the_given_physics(physics: Physics | None) -> None:
    """The first states that the heuristic sees are those of the instances; the next ones are simulated from them."""
    seen: list[list[State]] = []

    class Watched(Always):
        def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
            seen.append(list(states))
            return super().guide(scenes, states)

    GreedyValidation(DISTRIBUTION, 3, 2, Split.TUNING, physics)(Watched(0))
    tasks = [sample_task_instance(DISTRIBUTION, 2, Split.TUNING, index) for index in range(3)]
    assert seen[0] == [task.state for task in tasks]
    assert seen[1] == [TransitionModel(t.scene, SPACE, physics).simulate(t.state, 0).next_state for t in tasks]
