"""The greedy baseline does what its heuristic says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tests.planning.conftest import at
from tests.planning.scripted import STAY, ScriptedHeuristic
from visualrhp.heuristics.heuristic import Guidance, Heuristic, SoftmaxGuidance
from visualrhp.planning import Decision, Greedy
from visualrhp.scene import Scene
from visualrhp.types import State


class Nearest(Heuristic):
    """Prefers the action whose number is that of the cell."""

    action_space = "discrete"

    def __init__(self) -> None:
        self.scenes: list[Scene] = []

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        self.scenes += scenes
        cells = np.array([state.object_poses[0, 0] for state in states])
        return SoftmaxGuidance(-np.abs(np.arange(8.0) - cells[:, None]), temperature=100.0)


def test_greedy_takes_the_mode_and_simulates_nothing(line_world: Callable[..., Any]) -> None:
    world = line_world()
    decision = Greedy(ScriptedHeuristic({})).start(world, np.random.default_rng(0))(at(0))
    assert decision.action == STAY and decision.rollouts == ()
    assert world.simulated == []


def test_greedy_takes_the_action_with_the_highest_value_in_each_state(line_world: Callable[..., Any]) -> None:
    """Almost all actions are equally likely at this temperature, so sampled ones would not agree."""
    policy = Greedy(Nearest()).start(line_world(), np.random.default_rng(0))
    order = [3, 0, 7, 7, 1, 5]
    assert [policy(at(cell)).action for cell in order] == order


def test_greedy_observes_the_scene_of_its_model(line_world: Callable[..., Any]) -> None:
    heuristic = Nearest()
    worlds = [line_world(), line_world()]
    policies = [Greedy(heuristic).start(world, np.random.default_rng(0)) for world in worlds]
    for policy in (policies[1], policies[0], policies[1]):
        policy(at(0))
    assert [scene is worlds[1].scene for scene in heuristic.scenes] == [True, False, True]


def test_greedy_draws_nothing_from_its_generator(line_world: Callable[..., Any]) -> None:
    rng = np.random.default_rng(4)
    policy = Greedy(ScriptedHeuristic({})).start(line_world(), rng)
    assert policy(at(1)) == policy(at(1)) == Decision(action=STAY)
    assert rng.random() == np.random.default_rng(4).random()
