"""Stored demonstrations replay exactly, and altered ones do not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.demonstrations.conftest import ACTION_SPACES
from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.generate import Attempt
from visualrhp.demonstrations.replay import ReplayBlock, replay, replay_blocks, replay_difference
from visualrhp.demonstrations.shards import between, pack
from visualrhp.simulation import Physics, TransitionModel, make_action_space
from visualrhp.types import ActionSpaceName, State


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_an_altered_demonstration_does_not_replay(
    attempts: dict[ActionSpaceName, list[Attempt]], space: ActionSpaceName
) -> None:
    """One bit of the start, of a state on the way, of an action or of a reward; or an end before the goal."""
    task, episode = attempts[space][3].task, attempts[space][3].episode
    assert episode is not None and len(episode) >= 2
    model = TransitionModel(task.scene, make_action_space(space))

    def another(state: State) -> State:
        vector = state.vector.copy()
        vector[0] = np.nextafter(vector[0], 1.0)
        return State(vector)

    states, actions, rewards = list(episode.states), list(episode.actions), list(episode.rewards)
    last = (actions[-1] + 1) % 6 if space == "discrete" else -actions[-1]
    altered = {
        "state 0 is not that of the task": {"states": (another(states[0]), *states[1:])},
        f"state 1 of {len(episode)} differs by ": {"states": (states[0], another(states[1]), *states[2:])},
        f"state {len(episode)} of {len(episode)} differs": {"actions": (*actions[:-1], last)},
        f"reward 1 of {len(episode)} is -1, not -0.5": {"rewards": (-0.5, *rewards[1:])},
        f"the last of {len(episode) - 1} states is not a goal": {
            "states": tuple(states[:-1]),
            "actions": tuple(actions[:-1]),
            "rewards": tuple(rewards[:-1]),
        },
        "cannot be simulated": {"actions": (99 if space == "discrete" else np.full(4, np.nan), *actions[1:])},
    }
    assert replay_difference(task, episode, model) is None
    for words, change in altered.items():
        found = replay_difference(task, dataclasses.replace(episode, **change), model)
        assert found is not None and words in found, (words, found)


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_a_block_is_replayed_and_the_index_named(
    attempts: dict[ActionSpaceName, list[Attempt]], space: ActionSpaceName
) -> None:
    arrays = pack(attempts[space], space)
    physics = Physics()
    summary = replay(ReplayBlock("shard", arrays, physics))
    assert (summary.num_exact, summary.num_transitions, summary.differences) == (5, int(arrays["length"].sum()), [])
    arrays["rewards"][arrays["length"][:3].sum()] += 1e-12  # the first reward of attempt 3
    (difference,) = replay(ReplayBlock("shard", arrays, physics)).differences
    assert difference[:2] == ("shard", 3) and difference[2].startswith("reward 1 of")
    summary.add(replay(ReplayBlock("shard", between(arrays, 5, 7), physics)))
    assert summary.num_replayed == 7


def test_blocks_are_the_set_and_hold_no_open_files(stored: DemonstrationSet) -> None:
    parts = list(replay_blocks(stored, Physics(), size=3))
    indices = np.concatenate([part.arrays["index"] for part in parts])
    assert indices.tolist() == list(range(stored.card["num_attempts"]))
    assert all(type(array) is np.ndarray for part in parts for array in part.arrays.values())  # no memory maps
