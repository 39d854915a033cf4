"""Why episodes failed, from their last states."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from tests.evaluation.samples import sample_scene
from visualrhp.evaluation.failures import MAX_PERIOD, RECURRENCE, WINDOW, Failure, failure_of
from visualrhp.types import Episode, Outcome, State

Position = tuple[float, float]


def state(gripper: Position, desired: Position = (0.0, 0.0), other: Position = (0.1, 0.1), theta: float = 0.0) -> State:
    return State.create([*gripper, theta], 0.085, False, [[*desired, 0.0], [*other, 0.0]])


def failure(states: Sequence[State], outcome: Outcome = Outcome.OUT_OF_ACTIONS) -> Failure:
    count = len(states) - 1
    return failure_of(sample_scene(2), Episode(tuple(states), (0,) * count, (-1.0,) * count, outcome))


@pytest.mark.parametrize(
    ("desired", "other", "expected"),
    [
        ((0.3, 0.0), (0.1, 0.1), Failure.DESIRED_DROPPED),
        ((0.3, 0.0), (0.0, -0.4), Failure.DESIRED_DROPPED),
        ((0.2, 0.0), (0.0, -0.4), Failure.OBSTACLE_DROPPED),
    ],
)
def test_a_drop_is_of_the_desired_object_or_of_another(desired: Position, other: Position, expected: Failure) -> None:
    assert failure([state((0.0, 0.0)), state((0.0, 0.0), desired, other)], Outcome.DROPPED) is expected


@pytest.mark.parametrize("outcome", [outcome for outcome in Outcome if outcome is not Outcome.DROPPED])
def test_every_outcome_has_a_reason(outcome: Outcome) -> None:
    found = failure([state((0.0, 0.0)), state((0.0, 0.05), (0.05, 0.0))], outcome)
    assert (found is Failure.NONE) == (outcome is Outcome.SUCCESS)


@pytest.mark.parametrize("period", [2, 3, MAX_PERIOD])
def test_a_gripper_that_comes_back_again_and_again_oscillates(period: int) -> None:
    places = [(0.03 * (number % period), 0.0) for number in range(50)]
    assert failure([state(place) for place in places]) is Failure.OSCILLATION
    turning = [state((0.0, 0.0), theta=0.5 * (number % period) - math.pi) for number in range(50)]
    assert failure(turning) is Failure.OSCILLATION


def test_a_longer_period_and_a_single_return_are_no_oscillation() -> None:
    period = MAX_PERIOD + 1
    assert failure([state((0.03 * (number % period), 0.0)) for number in range(50)]) is Failure.IDLE
    there_and_back = [0.02 * min(number, 49 - number) for number in range(50)]
    assert failure([state((x, 0.0)) for x in there_and_back]) is Failure.IDLE


@pytest.mark.parametrize(("returns", "expected"), [(0, Failure.IDLE), (WINDOW, Failure.OSCILLATION)])
def test_returns_count_in_the_window_only(returns: int, expected: Failure) -> None:
    """Before it, the gripper goes back and forth; in it, it goes on for some actions."""
    early = [state((0.03 * (number % 2), 0.0)) for number in range(50 - WINDOW)]
    late = [state((0.03 * (number % 2) if number < returns else 0.05 * number, 0.1)) for number in range(WINDOW)]
    assert 0.0 < RECURRENCE <= 1.0
    assert failure([*early, *late]) is expected


@pytest.mark.parametrize(("step", "expected"), [(0.0, Failure.IDLE), (0.004, Failure.OUT_OF_ACTIONS)])
def test_objects_that_still_move_make_no_idle_episode(step: float, expected: Failure) -> None:
    states = [state((0.02 * number, 0.0), other=(0.1, step * number)) for number in range(50)]
    assert failure(states) is expected


def test_a_gripper_at_rest_is_idle_and_does_not_oscillate() -> None:
    assert failure([state((0.0, 0.0))] * 50) is Failure.IDLE


def test_a_short_episode_is_judged_as_a_whole() -> None:
    assert failure([state((0.0, 0.0)), state((0.05, 0.0))]) is Failure.IDLE
