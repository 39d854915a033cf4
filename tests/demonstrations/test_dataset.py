"""Sets are read as they were written; damage is noticed and named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.demonstrations.conftest import ACTION_SPACES, write
from visualrhp.demonstrations.dataset import DemonstrationSet, damaged_shards, file_hash, read_card
from visualrhp.demonstrations.generate import Attempt
from visualrhp.demonstrations.shards import read_arrays, write_arrays
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


def refused(folder: Path, name: str, words: str | None = None) -> None:
    with pytest.raises(DataError, match=words) as caught:
        list(DemonstrationSet.open(folder))
    message = str(caught.value)
    assert name in message and "pipelines.generate_demos" in message and len(message) < 2000 and "\n" not in message


REQUIRED = ("action_space", "content_hash", "num_attempts", "num_demonstrations", "num_transitions", "shards")


def test_every_key_of_a_card_is_required_and_has_its_type(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]
) -> None:
    folder = write(tmp_path, attempts["discrete"], "discrete", shard_size=2)
    card = read_card(folder)
    path = folder / "card.json"
    for key in REQUIRED:
        path.write_text(json.dumps({name: value for name, value in card.items() if name != key}))
        refused(folder, "card.json", f"The key {key} is missing")
        for value in (None, "abc", [[1]], {"a": 1}, -1, 10**30):
            path.write_text(json.dumps(card | {key: value}))
            refused(folder, "card.json")
    for key in card["shards"][0]:
        first, *others = card["shards"]
        without = {name: value for name, value in first.items() if name != key}
        path.write_text(json.dumps(card | {"shards": [without, *others]}))
        refused(folder, "card.json", rf"The key shards\[0\]\.{key} is missing")
        for value in (None, [[1]], -1, 7, "../../etc/passwd", "a\0b"):
            path.write_text(json.dumps(card | {"shards": [first | {key: value}, *others]}))
            with pytest.raises(DataError):
                list(DemonstrationSet.open(folder))


@pytest.mark.parametrize("content", [None, [], "card", 3, [{"kind": "demonstrations", "format": 1}]])
def test_what_is_no_card_is_refused(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]], content: Any
) -> None:
    folder = write(tmp_path, attempts["discrete"], "discrete")
    (folder / "card.json").write_text(json.dumps(content))
    refused(folder, "card.json", "is not the card of a demonstration set")


def test_what_stands_in_the_place_of_a_file_is_named(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]
) -> None:
    folder = write(tmp_path, attempts["discrete"], "discrete", shard_size=2)
    for name in ("shard-00000.npz", "card.json"):
        path = folder / name
        content = path.read_bytes()
        path.unlink()
        path.mkdir()
        refused(folder, name, "is a folder")
        path.rmdir()
        path.symlink_to(path)
        refused(folder, name, "loop of links")
        path.unlink()
        path.write_bytes(content)


@pytest.mark.parametrize("change", ["missing array", "another type", "more attempts", "fewer states", "other actions"])
def test_a_shard_of_other_arrays_is_refused(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]], change: str
) -> None:
    """Even if the card has its checksum."""
    folder = write(tmp_path, attempts["discrete"], "discrete", shard_size=2)
    path = folder / "shard-00001.npz"
    arrays = read_arrays(path)
    changed: dict[str, Any] = {
        "missing array": {name: array for name, array in arrays.items() if name != "gripper"},
        "another type": arrays | {"length": arrays["length"].astype(float)},
        "more attempts": arrays | {"index": np.append(arrays["index"], 99)},
        "fewer states": arrays | {"states": arrays["states"][:-1]},
        "other actions": arrays | {"actions": np.zeros((len(arrays["actions"]), 4))},
    }[change]
    write_arrays(path, changed)
    card = read_card(folder)
    card["shards"][1] |= {"bytes": path.stat().st_size, "sha256": file_hash(path)}
    (folder / "card.json").write_text(json.dumps(card))
    with pytest.raises(DataError, match=r"shard-00001\.npz"):
        list(DemonstrationSet.open(folder))
