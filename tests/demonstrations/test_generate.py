"""Demonstrations are a function of (seed, index)."""

from __future__ import annotations

import pytest

from tests.demonstrations.conftest import ACTION_SPACES, attempt
from visualrhp.demonstrations.generate import Attempt
from visualrhp.demonstrations.replay import replay_difference
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.types import ActionSpaceName


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_a_demonstration_is_a_function_of_seed_and_index_and_replays_exactly(
    attempts: dict[ActionSpaceName, list[Attempt]], space: ActionSpaceName
) -> None:
    first, again = attempts[space][3], attempt(space, 3)
    assert first.task.scene == again.task.scene
    assert first.episode is not None and again.episode is not None
    assert first.episode.states == again.episode.states
    model = TransitionModel(first.task.scene, make_action_space(space))
    assert replay_difference(first.task, first.episode, model) is None
    wrong_start = attempts[space][5].task
    assert replay_difference(wrong_start, first.episode, model) is not None
