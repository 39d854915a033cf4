"""Shards keep every bit, and damaged files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from visualrhp.demonstrations.generate import Attempt
from visualrhp.demonstrations.shards import between, map_arrays, pack, read_arrays, write_arrays
from visualrhp.errors import DataError
from visualrhp.types import ActionSpaceName


def test_parts_of_a_shard_joined_are_the_shard(attempts: dict[ActionSpaceName, list[Attempt]]) -> None:
    arrays = pack(attempts["continuous"], "continuous")
    for start in range(7):
        expected = pack(attempts["continuous"][start:6], "continuous")
        found = between(arrays, start, 6)
        assert all(np.array_equal(found[name], expected[name]) for name in arrays)


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
