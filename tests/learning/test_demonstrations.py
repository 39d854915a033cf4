"""Demonstrations: generated as a function of (seed, index), stored to the bit, damage noticed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from visualrhp.errors import DataError
from visualrhp.learning.demonstrations import (
    Attempt,
    DemonstrationSet,
    DemonstrationWriter,
    generate_demonstration,
    monte_carlo_returns,
    pack,
    read_arrays,
    replays_exactly,
    write_arrays,
)
from visualrhp.planning import KinodynamicRRT
from visualrhp.scene import SceneDistribution
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.types import ActionSpaceName

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
