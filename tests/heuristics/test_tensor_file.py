"""Arrays and a document in one file: every bit comes back, damage is noticed."""

import json
import os

import numpy as np
import pytest
from safetensors.numpy import save_file

from visualrhp.errors import CheckpointError
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file

ARRAYS = {
    "weights": np.linspace(-1.0, 1.0, 12, dtype=np.float32).reshape(3, 4).T,  # not contiguous
    "count": np.array(7),
    "mask": np.array([True, False]),
    "empty": np.zeros((0, 3)),
}


def test_every_bit_comes_back(tmp_path):
    path = tmp_path / "file.safetensors"
    write_tensor_file(path, ARRAYS, {"epoch": 3})
    arrays, document = read_tensor_file(path)
    assert document == {"epoch": 3}
    assert set(arrays) == set(ARRAYS)
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array)
        assert arrays[name].flags.writeable


def test_the_same_content_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_tensor_file(tmp_path / name, dict(sorted(ARRAYS.items(), reverse=name == "b")), {"x": [1, None]})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("position", [3, 60, -1])
def test_a_flipped_bit_is_noticed(tmp_path, position):
    path = tmp_path / "file.safetensors"
    write_tensor_file(path, ARRAYS, {"epoch": 3})
    content = bytearray(path.read_bytes())
    content[position] ^= 1
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="is damaged"):
        read_tensor_file(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(CheckpointError, match=r"none\.safetensors does not exist"):
        read_tensor_file(tmp_path / "none.safetensors")


@pytest.mark.parametrize(
    "header",
    [
        "[]",
        "null",
        "{}",
        '{"checksum": "1", "document": "{}"}',
        '{"checksum": 1, "document": {}}',
        '{"checksum": NaN, "document": "{}"}',
        '{"checksum": 1, "checksum": 1, "document": "{}"}',
        '{"checksum": 223132457, "document": "[]"}',
        '{"checksum": 1, "document": "{"}',
        json.dumps({"checksum": 1, "document": "[" * 100_000}),
    ],
    ids=lambda header: header[:30],
)
def test_headers_that_were_not_written_here_are_refused(tmp_path, header):
    path = tmp_path / "file.safetensors"
    save_file({"a": np.zeros(2)}, path, metadata={"visualrhp": header})
    with pytest.raises(CheckpointError, match=r"file\.safetensors is damaged: the document in its header") as caught:
        read_tensor_file(path)
    assert len(str(caught.value)) < 2000
    save_file({"a": np.zeros(2)}, path)
    with pytest.raises(CheckpointError, match="not a file of visualrhp"):
        read_tensor_file(path)


def test_files_of_another_kind_are_refused(tmp_path):
    path = tmp_path / "file.safetensors"
    for content in (b"\xff" * 8 + b"{}", b"\0" * 100, b"PK\x03\x04" + b"\0" * 50, b"x"):
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match="is damaged"):
            read_tensor_file(path)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(CheckpointError, match="not a regular file"):
        read_tensor_file(path)
