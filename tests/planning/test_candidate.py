"""A roll-out that grows action by action."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.planning.conftest import BREAK, LEFT, RIGHT, at
from visualrhp.planning.candidate import Candidate
from visualrhp.planning.planner import RolloutOrigin

STAY = 2
GAMMA = 0.5


def candidate(world: Any, action: int, **others: Any) -> Candidate:
    return Candidate(world, np.random.default_rng(0), {}, at(1), action, **others)


def test_known_transitions_are_not_simulated_again(line_world: Callable[..., Any]) -> None:
    world = line_world(goal=9)
    known: dict[Any, Any] = {}
    for _ in range(2):
        growing = Candidate(world, np.random.default_rng(0), known, at(1), RIGHT)
        growing.simulate()
        assert growing.current == at(2)
    assert world.simulated == [(1, RIGHT)]


def test_the_script_comes_before_the_policy(line_world: Callable[..., Any]) -> None:
    growing = candidate(line_world(goal=9), RIGHT, origin="warm start", script=(RIGHT, LEFT))
    for _ in range(3):
        growing.simulate()
        growing.choose_next(sampled=STAY, mode=RIGHT)
    assert growing.actions == [RIGHT, LEFT, RIGHT]


@pytest.mark.parametrize(("origin", "expected"), [("policy", STAY), ("resampling", STAY), ("mode", LEFT)])
def test_the_origin_decides_between_the_sample_and_the_mode(
    line_world: Callable[..., Any], origin: RolloutOrigin, expected: int
) -> None:
    growing = candidate(line_world(goal=9), RIGHT, origin=origin)
    growing.simulate()
    growing.choose_next(sampled=STAY, mode=LEFT)
    assert growing.next_action == expected
    growing.value(-4.0)
    assert growing.finish(GAMMA).origin == origin


def test_the_return_by_hand(line_world: Callable[..., Any]) -> None:
    """-1 - 1/2 + v / 4 with v = -8; actions after the last value do not count."""
    growing = candidate(line_world(goal=9), RIGHT)
    growing.simulate()
    growing.simulate()
    growing.value(-8.0)
    growing.simulate()
    rollout = growing.finish(GAMMA)
    assert (rollout.total_return, rollout.actions, len(rollout.states)) == (-3.5, (RIGHT, RIGHT), 3)


@pytest.mark.parametrize(("start", "action", "is_dropped"), [(1, LEFT, True), (8, RIGHT, False)])
def test_terminal_states_end_it(line_world: Callable[..., Any], start: int, action: int, is_dropped: bool) -> None:
    growing = Candidate(line_world(goal=9, edge=1), np.random.default_rng(0), {}, at(start), action)
    growing.simulate()
    assert growing.is_terminal and growing.is_valued and not growing.is_open
    assert growing.is_dropped == is_dropped
    assert growing.finish(GAMMA).total_return == (-50.0 if is_dropped else -1.0)


def test_a_failure_of_the_physics_is_minus_infinity(line_world: Callable[..., Any]) -> None:
    growing = candidate(line_world(goal=9), BREAK)
    growing.simulate()
    assert growing.is_diverged and growing.is_valued
    assert growing.finish(GAMMA).total_return == -math.inf
