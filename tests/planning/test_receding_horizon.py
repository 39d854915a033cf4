"""Algorithm 1 and Eq. 3 on a line of cells, with returns worked out by hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from tests.planning.conftest import BREAK, LEFT, RIGHT, at
from tests.planning.scripted import STAY, ScriptedHeuristic, cells
from visualrhp.errors import ConfigError
from visualrhp.heuristics.heuristic import Guidance, Heuristic, SoftmaxGuidance
from visualrhp.planning import RecedingHorizon
from visualrhp.scene import Scene
from visualrhp.types import State

GAMMA = 0.5


def rhp(heuristic: Heuristic, n: int, h: int) -> RecedingHorizon:
    return RecedingHorizon(heuristic, num_rollouts=n, horizon=h, discount=GAMMA)


def test_returns_by_hand(line_world: Callable[..., Any]) -> None:
    """From cell 1, gamma 1/2, v(3) = -8, v(1) = -4: right, right -> -1 - 1/2 - 8/4 = -3.5; left, right -> -2.5."""
    heuristic = ScriptedHeuristic({3: -8.0, 1: -4.0}, script=[RIGHT, LEFT, RIGHT, RIGHT])
    decision = rhp(heuristic, n=2, h=2).plan(line_world(goal=9), at(1), np.random.default_rng(0))
    assert [rollout.total_return for rollout in decision.rollouts] == [-3.5, -2.5]
    assert [rollout.value_estimate for rollout in decision.rollouts] == [-8.0, -4.0]
    assert [cells(rollout.states) for rollout in decision.rollouts] == [[1, 2, 3], [1, 0, 1]]
    assert [rollout.actions for rollout in decision.rollouts] == [(RIGHT, RIGHT), (LEFT, RIGHT)]
    assert [rollout.rewards for rollout in decision.rollouts] == [(-1.0, -1.0), (-1.0, -1.0)]
    assert decision.action == LEFT
    assert decision.num_invalid == 0


def test_a_terminal_state_ends_the_rollout_and_is_not_bootstrapped(line_world: Callable[..., Any]) -> None:
    """Goal after one of three actions: -1. Drop after one: -50. Neither is bootstrapped, even where v is high."""
    heuristic = ScriptedHeuristic({1: 1000.0, -1: 1000.0, 0: -20.0}, script=[STAY, LEFT, RIGHT, STAY, STAY])
    decision = rhp(heuristic, n=3, h=3).plan(line_world(goal=1), at(0), np.random.default_rng(0))
    waiting = -1.0 - 0.5 - 0.25 - 20.0 / 8.0
    assert [rollout.total_return for rollout in decision.rollouts] == [waiting, -50.0, -1.0]
    assert [len(rollout.actions) for rollout in decision.rollouts] == [3, 1, 1]
    assert [rollout.value_estimate for rollout in decision.rollouts] == [-20.0, 0.0, 0.0]
    assert decision.action == RIGHT


def test_a_goal_in_the_last_step_of_the_horizon_is_not_bootstrapped(line_world: Callable[..., Any]) -> None:
    heuristic = ScriptedHeuristic({2: -1000.0}, script=[RIGHT, RIGHT])
    decision = rhp(heuristic, n=1, h=2).plan(line_world(goal=2), at(0), np.random.default_rng(0))
    assert decision.rollouts[0].total_return == -1.5


def test_a_diverged_rollout_is_minus_infinity_and_counted(line_world: Callable[..., Any]) -> None:
    """One breaks the physics, one reaches a value that is not a number; the drop beats both."""
    heuristic = ScriptedHeuristic({1: math.nan}, script=[BREAK, RIGHT, LEFT])
    decision = rhp(heuristic, n=3, h=1).plan(line_world(goal=9), at(0), np.random.default_rng(0))
    assert [rollout.total_return for rollout in decision.rollouts] == [-math.inf, -math.inf, -50.0]
    assert decision.num_invalid == 2
    assert decision.action == LEFT


def test_if_all_rollouts_diverge_the_mode_of_the_heuristic_decides(line_world: Callable[..., Any]) -> None:
    heuristic = ScriptedHeuristic({}, script=[BREAK, RIGHT, BREAK])
    decision = rhp(heuristic, n=2, h=2).plan(line_world(goal=9), at(0), np.random.default_rng(0))
    assert decision.num_invalid == 2
    assert decision.action == STAY
    assert [rollout.actions for rollout in decision.rollouts] == [(BREAK,), (RIGHT, BREAK)]
    assert all(len(rollout.states) == len(rollout.rewards) + 1 for rollout in decision.rollouts)


def test_a_network_whose_values_are_no_numbers_decides_nothing(line_world: Callable[..., Any]) -> None:
    class Broken(Heuristic):
        action_space = "discrete"

        def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
            return SoftmaxGuidance(np.full((len(states), 8), np.nan), 1.0)

    world = line_world(goal=9)
    decision = rhp(Broken(), n=3, h=2).plan(world, at(4), np.random.default_rng(0))
    assert decision.num_invalid == 3 and decision.action == 0  # the first of equals
    assert all(rollout.is_diverged for rollout in decision.rollouts)


def test_the_first_of_equal_returns_wins(line_world: Callable[..., Any]) -> None:
    heuristic = ScriptedHeuristic({}, script=[LEFT, RIGHT, STAY])
    decision = rhp(heuristic, n=3, h=1).plan(line_world(goal=9), at(4), np.random.default_rng(0))
    assert decision.action == LEFT


def test_one_call_of_the_heuristic_per_depth_over_all_rollouts_and_tasks(line_world: Callable[..., Any]) -> None:
    heuristic = ScriptedHeuristic({})
    worlds = [line_world(goal=90, edge=-90) for _ in range(2)]
    rngs = [np.random.default_rng(seed) for seed in range(2)]
    rhp(heuristic, n=3, h=4).plan_batch(worlds, [at(10), at(20)], rngs)
    assert [len(call) for call in heuristic.calls] == [2, 6, 6, 6, 6]


def test_a_task_is_planned_alike_alone_and_among_others(line_world: Callable[..., Any]) -> None:
    values = {cell: -float(cell % 5) for cell in range(-20, 60)}
    planner = rhp(ScriptedHeuristic(values), n=4, h=3)
    seeds_and_cells = [(0, 10), (1, 20), (2, 30)]
    together = planner.plan_batch(
        [line_world(goal=90) for _ in seeds_and_cells],
        [at(cell) for _, cell in seeds_and_cells],
        [np.random.default_rng(seed) for seed, _ in seeds_and_cells],
    )
    for decision, (seed, cell) in zip(together, seeds_and_cells, strict=True):
        alone = planner.plan(line_world(goal=90), at(cell), np.random.default_rng(seed))
        assert alone == decision


def test_what_was_simulated_in_a_decision_is_not_simulated_again(line_world: Callable[..., Any]) -> None:
    world = line_world(goal=90)
    heuristic = ScriptedHeuristic({}, script=[RIGHT, RIGHT, LEFT, RIGHT, STAY, RIGHT])
    rhp(heuristic, n=3, h=2).plan(world, at(5), np.random.default_rng(0))
    assert world.simulated == [(5, RIGHT), (5, LEFT), (6, RIGHT), (6, STAY), (4, RIGHT)]


def test_a_policy_draws_from_its_generator_alone(line_world: Callable[..., Any]) -> None:
    planner = rhp(ScriptedHeuristic({}), n=3, h=3)
    decisions = []
    for _ in range(2):
        policy = planner.start(line_world(goal=90), np.random.default_rng(3))
        decisions.append([policy(at(10)) for _ in range(4)])
    assert decisions[0] == decisions[1]


@pytest.mark.parametrize(
    "parameters",
    [
        {"num_rollouts": 0},
        {"horizon": 0},
        {"discount": 0.0},
        {"discount": 1.1},
        {"discount": math.nan},
        {"deadline_s": 0.0},
        {"deadline_s": -1.0},
        {"deadline_s": math.nan},
        {"deadline_s": math.inf},
    ],
)
def test_a_parameter_out_of_range_is_named(parameters: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(parameters))):
        RecedingHorizon(ScriptedHeuristic({}), **parameters)


def test_the_default_name_has_the_number_and_depth_of_rollouts() -> None:
    assert RecedingHorizon(ScriptedHeuristic({})).name == "RHP 3x3"
    assert RecedingHorizon(ScriptedHeuristic({}), name="mine", deadline_s=0.05).name == "mine"
