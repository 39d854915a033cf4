"""Sets are read as they were written; damage is noticed and named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.demonstrations.conftest import ACTION_SPACES, write
from visualrhp.demonstrations.dataset import DemonstrationSet, damaged_shards
from visualrhp.demonstrations.generate import Attempt
from visualrhp.demonstrations.shards import read_arrays
from visualrhp.errors import DataError
from visualrhp.types import ActionSpaceName


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
