"""What a planner remembers within an episode."""

from __future__ import annotations

import numpy as np

from tests.planning.conftest import LEFT, RIGHT, at
from visualrhp.planning.episode_memory import RESOLUTION, EpisodeMemory
from visualrhp.planning.planner import Decision, Rollout
from visualrhp.types import Column, State

ROLLOUTS = tuple(Rollout(actions, (at(0),), (), 0.0, 0.0) for actions in ((RIGHT, LEFT, RIGHT), (LEFT,)))


def test_the_rest_of_the_chosen_rollout_is_remembered() -> None:
    memory = EpisodeMemory()
    assert memory.rest == ()
    memory.remember(Decision(RIGHT, ROLLOUTS, chosen=0))
    assert memory.rest == (LEFT, RIGHT)
    memory.remember(Decision(LEFT, ROLLOUTS, chosen=1))
    assert memory.rest == ()
    memory.remember(Decision(RIGHT, ROLLOUTS, chosen=0))
    memory.remember(Decision(RIGHT, ROLLOUTS))
    assert memory.rest == (), "an action of no roll-out"


def test_states_are_visited_up_to_the_resolution() -> None:
    memory = EpisodeMemory()
    memory.enter(at(1))
    memory.enter(at(2))
    assert memory.has_visited(at(1)) and memory.has_visited(at(2)) and not memory.has_visited(at(3))
    for column in (Column.GRIPPER_X, Column.GRIPPER_THETA, Column.DESIRED_Y):
        for distance, expected in ((0.9 * RESOLUTION, True), (1.1 * RESOLUTION, False)):
            vector = np.array(at(1).vector)
            vector[column] += distance
            assert memory.has_visited(State(vector)) == expected
    closed = np.array(at(1).vector)
    closed[Column.CLOSED] = 1.0
    assert not memory.has_visited(State(closed))


def test_angles_that_differ_by_a_full_turn_are_equal() -> None:
    for column in (Column.GRIPPER_THETA, 7):  # of the gripper, and of the object
        vector = at(1).vector.copy()
        vector[column] = np.pi - 2e-4
        memory = EpisodeMemory()
        memory.enter(State(vector))
        vector[column] = -np.pi + 2e-4
        assert memory.has_visited(State(vector))
        vector[column] = -np.pi + 2e-3
        assert not memory.has_visited(State(vector))
