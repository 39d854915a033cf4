"""What is left of a plan, and what it predicts."""

from __future__ import annotations

import pytest

from tests.planning.conftest import RIGHT, at
from visualrhp.planning.plan import Plan
from visualrhp.planning.planner import Decision
from visualrhp.types import Episode, Outcome


def plan_to_cell_2() -> Plan:
    states = tuple(at(cell) for cell in (0, 1, 2))
    return Plan(Episode(states, (RIGHT, RIGHT), (-1.0, -1.0), Outcome.SUCCESS))


def test_it_is_followed_to_its_end_and_shows_what_is_left() -> None:
    plan = plan_to_cell_2()
    first, second, over = plan.follow(), plan.follow(), plan.follow()
    assert (first.action, second.action, over) == (RIGHT, RIGHT, Decision(action=None))
    assert first.rollouts[0].states == (at(0), at(1), at(2))
    assert first.rollouts[0].actions == (RIGHT, RIGHT)
    assert first.rollouts[0].total_return == pytest.approx(-1.0 - 0.995)
    assert second.rollouts[0].states == (at(1), at(2))
    assert second.rollouts[0].total_return == -1.0
    assert not plan.actions


def test_it_foresees_the_state_of_its_next_action_alone() -> None:
    plan = plan_to_cell_2()
    assert [plan.predicts(at(cell)) for cell in (0, 1)] == [True, False]
    plan.follow()
    assert [plan.predicts(at(cell)) for cell in (0, 1)] == [False, True]
    plan.follow()
    assert not plan.predicts(at(2)), "nothing is left to be done there"


@pytest.mark.parametrize("episode", [None, Episode((at(0),), (), (), Outcome.SUCCESS)])
def test_no_plan_gives_up_and_foresees_nothing(episode: Episode | None) -> None:
    plan = Plan(episode)
    assert plan.follow() == Decision(action=None) and not plan.predicts(at(0)) and list(plan.actions) == []
