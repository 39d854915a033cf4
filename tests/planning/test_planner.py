"""Returns of roll-outs (Eq. 3) worked out by hand, and what makes two decisions the same."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from tests.planning.conftest import LEFT, RIGHT, LineWorld, at
from visualrhp.planning import Decision, Planner, Rollout
from visualrhp.planning.planner import PlanningModel, Policy, Timing
from visualrhp.types import State

STATES = (at(0), at(1), at(2))
TIMING = Timing(total_s=1.0, simulation_s=0.5, observation_s=0.25, heuristic_s=0.125)


def test_a_return_by_hand() -> None:
    """gamma 1/2: -1 - 1/2 - 8/4 = -3.5."""
    rollout = Rollout.of([RIGHT, RIGHT], STATES, [-1.0, -1.0], value_estimate=-8.0, discount=0.5)
    assert rollout.total_return == -3.5
    assert (rollout.actions, rollout.states, rollout.rewards) == ((RIGHT, RIGHT), STATES, (-1.0, -1.0))
    assert not rollout.is_diverged


def test_the_value_and_the_discount_of_the_paper_are_the_default() -> None:
    """49 actions at -1 are a geometric series with gamma = 0.995; what follows has no value."""
    rollout = Rollout.of([RIGHT] * 49, [at(0)] * 50, [-1.0] * 49)
    assert rollout.total_return == pytest.approx(-(1.0 - 0.995**49) / 0.005)
    assert rollout.value_estimate == 0.0


def test_without_discount_a_return_is_the_sum() -> None:
    assert Rollout.of([LEFT], STATES[:2], [-50.0], value_estimate=-7.0, discount=1.0).total_return == -57.0


def test_a_return_is_that_of_the_first_step_and_the_rest() -> None:
    """R = r_1 + gamma R', with R' the return of the roll-out from the second state."""
    rewards = np.random.default_rng(0).uniform(-50.0, 0.0, 6).tolist()
    whole = Rollout.of([RIGHT] * 6, [at(0)] * 7, rewards, -9.0, 0.9)
    rest = Rollout.of([RIGHT] * 5, [at(0)] * 6, rewards[1:], -9.0, 0.9)
    assert whole.total_return == pytest.approx(rewards[0] + 0.9 * rest.total_return)


def test_a_rollout_of_no_actions_has_the_value_of_its_state() -> None:
    assert Rollout.of([], STATES[:1], [], value_estimate=-12.0).total_return == -12.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_a_divergence(value: float) -> None:
    rollout = Rollout.of([RIGHT], STATES[:1], [], value_estimate=value)
    assert rollout.is_diverged
    assert rollout.total_return == -math.inf and math.isnan(rollout.value_estimate)
    assert max(rollout, Rollout.of([LEFT], STATES[:2], [-50.0]), key=lambda r: r.total_return).actions == (LEFT,)


def test_decisions_are_compared_without_their_durations() -> None:
    rollout = Rollout.of([RIGHT], STATES[:2], [-1.0], -3.0)
    decision = Decision(RIGHT, (rollout,), 0, TIMING)
    assert decision == Decision(RIGHT, (rollout,))
    assert decision != Decision(LEFT, (rollout,), 0, TIMING)
    assert decision != Decision(RIGHT, (), 0, TIMING)
    assert decision != Decision(RIGHT, (rollout,), 1, TIMING)


def test_decisions_and_rollouts_are_not_changed_afterwards() -> None:
    with pytest.raises(FrozenInstanceError):
        Decision(RIGHT).action = LEFT  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(FrozenInstanceError):
        Rollout.of([], STATES[:1], []).total_return = 0.0  # pyright: ignore[reportAttributeAccessIssue]


def test_a_planner_has_to_start() -> None:
    class Idle(Planner):
        name = "Idle"

    with pytest.raises(TypeError, match="start"):
        Idle()  # pyright: ignore[reportAbstractUsage]


def test_a_planner_in_a_few_lines() -> None:
    """The interface is enough to solve the line world: look one action ahead, and give up in the goal."""

    class OneAhead(Planner):
        name = "one ahead"

        def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
            def policy(state: State) -> Decision:
                if model.is_goal(state):
                    return Decision(None)
                ends = {action: model.simulate(state, action).next_state for action in (RIGHT, LEFT)}
                return Decision(max(ends, key=lambda action: ends[action].object_poses[0, 0]))

            return policy

    world = LineWorld(goal=3)
    policy = OneAhead().start(world, np.random.default_rng(0))
    assert [policy(at(cell)).action for cell in range(4)] == [RIGHT, RIGHT, RIGHT, None]
