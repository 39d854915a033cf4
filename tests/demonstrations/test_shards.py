"""Shards keep every bit, and damaged files are refused."""

from __future__ import annotations

import io
import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visualrhp.demonstrations.generate import Attempt
from visualrhp.demonstrations.shards import between, check_arrays, map_arrays, pack, read_arrays, write_arrays
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


class Marked:
    """An object whose pickle makes a folder when it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


def zipped(path: Path, **members: bytes) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name.replace("_", "."), content)


def npy(array: Any, **options: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array, **options)
    return file.getvalue()


def test_no_file_runs_code_and_what_is_no_archive_of_arrays_is_refused(tmp_path: Path) -> None:
    path, marker = tmp_path / "block.npz", tmp_path / "ran"
    objects = npy(np.array([Marked(marker)], dtype=object), allow_pickle=True)
    contents: list[Any] = [
        lambda: path.write_bytes(pickle.dumps(Marked(marker))),
        lambda: path.write_bytes(objects),
        lambda: path.write_bytes(npy(np.arange(3))),
        lambda: zipped(path, x_npy=objects),
        lambda: zipped(path, x_npy=pickle.dumps(Marked(marker))),
        lambda: zipped(path, x_txt=b"text"),
        lambda: zipped(path, x_npy=npy(np.arange(3)) + b"more"),
        lambda: zipped(path, x_npy=npy(np.arange(3))[:-1]),
        lambda: zipped(path, x_npy=npy(np.arange(3)).replace(b"(3,)", b"(9,)")),
        lambda: zipped(path, x_npy=npy(np.arange(3)).replace(b"(3,), }    ", b"(10**99,),}")),
        lambda: path.write_bytes(b"PK\x03\x04" + b"\0" * 100),
    ]
    for make in contents:
        make()
        with pytest.raises(DataError, match=r"block\.npz is damaged"):
            read_arrays(path)
        with pytest.raises(DataError, match=r"block\.npz is damaged"):
            map_arrays(path)
    assert not marker.exists()


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "block.npz"
    for read in (read_arrays, map_arrays):
        path.mkdir()
        with pytest.raises(DataError, match=r"block\.npz is a folder"):
            read(path)
        path.rmdir()
        path.symlink_to(path)
        with pytest.raises(DataError, match=r"block\.npz is a link in a loop"):
            read(path)
        path.unlink()
        os.mkfifo(path)
        with pytest.raises(DataError, match=r"block\.npz is not a regular file"):
            read(path)
        path.unlink()


def test_arrays_of_a_shard_have_their_types_and_lengths(attempts: dict[ActionSpaceName, list[Attempt]]) -> None:
    path = Path("block.npz")
    for space in ("continuous", "discrete"):
        arrays = pack(attempts[space], space)
        check_arrays(path, arrays)
        for name, array in arrays.items():
            others = {name: other for name, other in arrays.items() if name != name}
            for changed in (
                others,
                arrays | {name: array[:-1]},
                arrays | {name: array.astype(str)},
                arrays | {name: array[..., None]},
            ):
                with pytest.raises(DataError, match=r"block\.npz is damaged"):
                    check_arrays(path, changed)
        for name, value in (("length", -1), ("num_objects", 0), ("num_vertices", 2), ("num_edges", 2**62)):
            with pytest.raises(DataError, match=name):
                check_arrays(path, arrays | {name: np.full_like(arrays[name], value)})
