"""Demonstrations: generated as a function of (seed, index), stored to the bit, damage noticed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from visualrhp.errors import DataError
from visualrhp.learning.demonstrations import (
    Attempt,
    DemonstrationSet,
    DemonstrationWriter,
    between,
    damaged_shards,
    generate_demonstration,
    map_arrays,
    monte_carlo_returns,
    pack,
    read_arrays,
    replay_block,
    replay_difference,
    replays_exactly,
    write_arrays,
)
from visualrhp.planning import KinodynamicRRT
from visualrhp.scene import SceneDistribution
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.types import ActionSpaceName, State

SEED = 3
DISTRIBUTION = SceneDistribution(num_objects=(1, 3))
ACTION_SPACES: tuple[ActionSpaceName, ...] = ("continuous", "discrete")


def attempt(action_space: ActionSpaceName, index: int, planner: KinodynamicRRT | None = None) -> Attempt:
    return generate_demonstration(DISTRIBUTION, action_space, planner or KinodynamicRRT(), SEED, index)


@pytest.fixture(scope="module")
def attempts() -> dict[ActionSpaceName, list[Attempt]]:
    """Seven attempts a space; those with the indices 1 and 4 fail for want of a budget."""
    hopeless = KinodynamicRRT(max_simulations=1)
    return {
        space: [attempt(space, index, hopeless if index in (1, 4) else None) for index in range(7)]
        for space in ACTION_SPACES
    }


def write(folder: Path, attempts: list[Attempt], space: ActionSpaceName, count: int = 5, **settings: int) -> Path:
    writer = DemonstrationWriter(folder, space, count, **settings)
    writer.add(pack(attempts, space))
    writer.finish(seed=SEED, commit="0" * 40, config={"count": count})
    return folder


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_a_demonstration_is_a_function_of_seed_and_index_and_replays_exactly(
    attempts: dict[ActionSpaceName, list[Attempt]], space: ActionSpaceName
) -> None:
    first, again = attempts[space][3], attempt(space, 3)
    assert first.task.scene == again.task.scene
    assert first.episode is not None and again.episode is not None
    assert first.episode.states == again.episode.states
    model = TransitionModel(first.task.scene, make_action_space(space))
    assert replays_exactly(first.task, first.episode, model)
    wrong_start = attempts[space][5].task
    assert not replays_exactly(wrong_start, first.episode, model)


@pytest.mark.parametrize("space", ACTION_SPACES)
@pytest.mark.parametrize("shard_size", [2, 1000])
def test_storage_keeps_every_bit(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]], space: ActionSpaceName, shard_size: int
) -> None:
    stored = DemonstrationSet.open(write(tmp_path, attempts[space], space, shard_size=shard_size), space)
    solved = [a for a in attempts[space] if a.episode is not None]
    assert len(stored) == len(solved) == 5
    assert stored.indices.tolist() == [0, 2, 3, 5, 6]
    assert stored.num_objects.tolist() == [a.task.scene.num_objects for a in solved]
    assert stored.lengths.tolist() == [len(a.episode or ()) for a in solved]
    assert stored.num_transitions == stored.lengths.sum()
    for (task, episode), original in zip(stored, solved, strict=True):
        assert original.episode is not None
        assert task.scene == original.task.scene and task.state == original.task.state
        assert episode.states == original.episode.states
        assert episode.rewards == original.episode.rewards
        assert episode.is_goal and not episode.is_dropped
        assert np.array(episode.actions).tobytes() == np.array(original.episode.actions).tobytes()
        assert all(isinstance(action, int if space == "discrete" else np.ndarray) for action in episode.actions)
    assert stored[-1][1].states == stored[4][1].states
    with pytest.raises(IndexError):
        stored[5]


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_whatever_is_altered_does_not_replay(
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
        f"state 1 of {len(episode)} is another one, by ": {"states": (states[0], another(states[1]), *states[2:])},
        f"state {len(episode)} of {len(episode)} is another": {"actions": (*actions[:-1], last)},
        f"reward 1 of {len(episode)} is -1, not -0.5": {"rewards": (-0.5, *rewards[1:])},
        f"the last of {len(episode) - 1} states is no goal": {
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
    assert replay_block(arrays) == (5, int(arrays["length"].sum()), [])
    arrays["rewards"][arrays["length"][:3].sum()] += 1e-12  # the first reward of attempt 3
    (differing,) = replay_block(arrays)[2]
    assert differing[0] == 3 and differing[1].startswith("reward 1 of")
    assert replay_block(between(arrays, 5, 7))[0] == 2


def test_parts_of_a_shard_joined_are_the_shard(attempts: dict[ActionSpaceName, list[Attempt]]) -> None:
    arrays = pack(attempts["continuous"], "continuous")
    for start in range(7):
        expected = pack(attempts["continuous"][start:6], "continuous")
        found = between(arrays, start, 6)
        assert all(np.array_equal(found[name], expected[name]) for name in arrays)


def test_shards_are_mapped_not_read(tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]) -> None:
    folder = write(tmp_path, attempts["continuous"], "continuous", shard_size=2)
    stored = DemonstrationSet.open(folder)
    for number, shard in enumerate(stored.card["shards"]):
        arrays = stored.shard(number).arrays
        copies = read_arrays(folder / shard["file"])
        assert arrays.keys() == copies.keys()
        for name, array in arrays.items():
            assert array.dtype == copies[name].dtype and np.array_equal(array, copies[name])
            assert isinstance(array, np.memmap) and not array.flags.writeable


def test_the_card_counts(tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]) -> None:
    folder = write(tmp_path, attempts["discrete"], "discrete", count=3, shard_size=2)
    card = json.loads((folder / "card.json").read_text())
    assert card["num_demonstrations"] == 3
    assert card["num_attempts"] == 4  # 0, 2 and 3 are demonstrations, 1 a failure; the others are not needed
    assert card["failed_indices"] == [1]
    assert sum(density["failed"] for density in card["densities"].values()) == 1
    assert sum(density["solved"] for density in card["densities"].values()) == 3
    assert sum(card["lengths"].values()) == 3
    assert [shard["num_demonstrations"] for shard in card["shards"]] == [2, 1]
    assert card["seed"] == SEED and card["config"] == {"count": 3}


def test_the_same_attempts_give_the_same_bytes_however_they_arrive(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]
) -> None:
    at_once = write(tmp_path / "a", attempts["continuous"], "continuous", shard_size=2)
    writer = DemonstrationWriter(tmp_path / "b", "continuous", 5, shard_size=2)
    for single in attempts["continuous"]:
        writer.add(pack([single], "continuous"))
    writer.finish(seed=SEED, commit="0" * 40, config={"count": 5})
    names = sorted(path.name for path in at_once.iterdir())
    assert names == ["card.json", "shard-00000.npz", "shard-00001.npz", "shard-00002.npz"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_returns_of_eq_4() -> None:
    """L = 3, gamma = 1/2, rewards -1: -1 - 1/2 - 1/4, -1 - 1/2, -1."""
    assert monte_carlo_returns([-1.0, -1.0, -1.0], 0.5).tolist() == [-1.75, -1.5, -1.0]
    assert monte_carlo_returns([], 0.5).tolist() == []


def test_returns_follow_the_order_of_the_demonstrations(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]
) -> None:
    stored = DemonstrationSet.open(write(tmp_path, attempts["discrete"], "discrete"))
    expected = np.concatenate([monte_carlo_returns(episode.rewards, 0.9) for _, episode in stored])
    assert np.array_equal(stored.returns(0.9), expected)


def damage(folder: Path, how: str) -> str:
    """Damage a set; return the name of the file."""
    path = folder / ("card.json" if how.endswith("card") else "shard-00001.npz")
    if how.startswith("missing"):
        path.unlink()
    elif how == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    elif how == "bit-flipped":
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    else:
        path.write_text("{" if how == "unreadable card" else '{"kind": "something else"}')
    return path.name


@pytest.mark.parametrize(
    "how", ["missing", "truncated", "bit-flipped", "missing card", "unreadable card", "foreign card"]
)
def test_damage_is_noticed_and_the_file_named(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]], how: str
) -> None:
    folder = write(tmp_path, attempts["continuous"], "continuous", shard_size=2)
    name = damage(folder, how)
    with pytest.raises(DataError, match=name):
        DemonstrationSet.open(folder)


def test_every_damaged_shard_is_found(tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]) -> None:
    folder = write(tmp_path, attempts["continuous"], "continuous", shard_size=2)
    card = json.loads((folder / "card.json").read_text())
    assert damaged_shards(folder, card) == {}
    damage(folder, "bit-flipped")
    (folder / "shard-00002.npz").unlink()
    damages = damaged_shards(folder, card)
    assert list(damages) == [1, 2]
    assert "shard-00001.npz does not have the SHA-256 checksum" in damages[1]
    assert "shard-00002.npz is missing" in damages[2]


def test_another_action_space_is_refused(tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]) -> None:
    folder = write(tmp_path, attempts["continuous"], "continuous")
    with pytest.raises(DataError, match="belongs to demonstrations in the continuous action space"):
        DemonstrationSet.open(folder, "discrete")


def test_the_writer_refuses_gaps_other_spaces_and_unfinished_sets(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]
) -> None:
    writer = DemonstrationWriter(tmp_path, "discrete", 5)
    with pytest.raises(DataError, match="indices 0 to 0"):
        writer.add(pack(attempts["discrete"][2:3], "discrete"))
    with pytest.raises(DataError, match="continuous actions"):
        DemonstrationWriter(tmp_path, "discrete", 5).add(pack(attempts["continuous"][:1], "continuous"))
    with pytest.raises(DataError, match="lacks 5"):
        DemonstrationWriter(tmp_path, "discrete", 5).finish()
    assert not any(tmp_path.iterdir())


def test_a_block_file_is_read_back_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "block.npz"
    arrays = {"x": np.arange(5), "y": np.zeros((0, 4))}
    write_arrays(path, arrays)
    back = read_arrays(path)
    assert back.keys() == arrays.keys() and all(np.array_equal(back[name], arrays[name]) for name in arrays)
    assert back["y"].shape == (0, 4)
    content = bytearray(path.read_bytes())
    content[200] ^= 1
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"block\.npz is damaged"):
        read_arrays(path)
    with pytest.raises(DataError, match=r"none\.npz is missing"):
        read_arrays(tmp_path / "none.npz")
    with pytest.raises(DataError, match=r"none\.npz is missing"):
        map_arrays(tmp_path / "none.npz")


def test_only_what_was_written_here_is_mapped(tmp_path: Path) -> None:
    arrays = {"x": np.arange(5), "y": np.zeros((0, 4)), "z": np.array(["a", 1], dtype=object)}
    path = tmp_path / "block.npz"
    write_arrays(path, {"x": arrays["x"], "y": arrays["y"]})
    mapped = map_arrays(path)
    assert mapped["x"].tolist() == [0, 1, 2, 3, 4] and mapped["y"].shape == (0, 4)
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(DataError, match=r"block\.npz is damaged"):
        map_arrays(path)
    np.savez_compressed(path, x=arrays["x"])
    with pytest.raises(DataError, match=r"x\.npy is compressed"):
        map_arrays(path)
    np.savez(path, z=arrays["z"])
    with pytest.raises(DataError, match=r"z\.npy holds objects"):
        map_arrays(path)
