"""A training that resumes from a file is bit-exact; a file that does not fit changes nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from visualrhp.errors import CheckpointError
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file
from visualrhp.learning.history import ImitationProgress
from visualrhp.learning.training_state import load_training_state, save_training_state


class _Training:
    """A small training with every kind of part: a convolution in channels last, fused Adam, both generators."""

    def __init__(self, seed: int) -> None:
        torch.manual_seed(seed)
        self.network = nn.Sequential(nn.Conv2d(2, 4, 3), nn.Flatten(), nn.Linear(16, 2)).to(
            memory_format=torch.channels_last  # pyright: ignore[reportCallIssue]
        )
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=0.01, fused=True)
        self.noise = torch.Generator().manual_seed(seed)
        self.order = np.random.default_rng(seed)

    @property
    def parts(self) -> dict[str, Any]:
        return {"network": self.network, "optimizer": self.optimizer, "noise": self.noise, "order": self.order}

    def step(self) -> None:
        inputs = torch.rand(3, 2, 4, 4, generator=self.noise) * float(self.order.random())
        self.optimizer.zero_grad()
        self.network(inputs).square().sum().backward()
        self.optimizer.step()

    def bits(self) -> bytes:
        return b"".join(tensor.detach().numpy().tobytes() for tensor in self.network.state_dict().values())


def test_resumed_training_ends_at_the_same_bits(tmp_path: Path) -> None:
    path = tmp_path / "state.safetensors"
    uninterrupted = _Training(seed=1)
    for _ in range(3):
        uninterrupted.step()
    save_training_state(path, uninterrupted.parts)
    resumed = _Training(seed=2)
    load_training_state(path, resumed.parts)
    for training in (uninterrupted, resumed):
        for _ in range(3):
            training.step()
    assert uninterrupted.bits() == resumed.bits()


def test_values_arrays_and_tensors_come_back(tmp_path: Path) -> None:
    path = tmp_path / "state.safetensors"
    values = {"epoch": 3, "history": [{"loss": 0.5, "best": True}], "name": None}
    tensors = {"array": np.arange(6).reshape(2, 3), "tensor": torch.ones(2, dtype=torch.bool)}
    save_training_state(path, {**values, **tensors})
    loaded = load_training_state(path, {})
    assert {key: loaded[key] for key in values} == values
    np.testing.assert_array_equal(loaded["array"], np.arange(6).reshape(2, 3))
    assert loaded["tensor"].dtype is torch.bool


def test_same_content_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_training_state(tmp_path / name, _Training(seed=1).parts)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a", "b"]  # no temporary file stays


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"absent\.safetensors does not exist"):
        load_training_state(tmp_path / "absent.safetensors", {})


@pytest.mark.parametrize("position", [0, 60, 100, 200, 400, -1])
def test_one_flipped_byte_is_noticed(tmp_path: Path, position: int) -> None:
    path = tmp_path / "state.safetensors"
    save_training_state(path, _Training(seed=1).parts)
    content = bytearray(path.read_bytes())
    content[position] ^= 0x55
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="damaged"):
        load_training_state(path, _Training(seed=1).parts)


def test_truncated_file_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "state.safetensors"
    save_training_state(path, _Training(seed=1).parts)
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(CheckpointError, match="damaged"):
        load_training_state(path, _Training(seed=1).parts)


def test_state_that_does_not_fit_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "state.safetensors"
    save_training_state(path, _Training(seed=1).parts)
    training = _Training(seed=2)
    before = training.bits()
    with pytest.raises(CheckpointError, match="another architecture"):
        load_training_state(path, {**training.parts, "network": nn.Linear(2, 2)})
    with pytest.raises(CheckpointError, match="groups"):
        load_training_state(path, {**training.parts, "optimizer": torch.optim.Adam(nn.Linear(2, 2).parameters())})
    with pytest.raises(CheckpointError, match="torch_generator"):
        load_training_state(path, {**training.parts, "noise": np.random.default_rng()})
    with pytest.raises(CheckpointError, match="another kind of training"):
        load_training_state(path, {"network": training.network})
    assert training.bits() == before


def test_unknown_part_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="set"):
        save_training_state(tmp_path / "state.safetensors", {"part": {1, 2}})


# ------------------------------------------------------------------------------------- documents that are no states
VALUES = {"epoch": 1, "history": [{"epoch": 1.0, "loss": 0.5}]}


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    path = tmp_path / "state.safetensors"
    training = _Training(seed=1)
    training.step()
    save_training_state(path, training.parts | VALUES)
    return path


def refused(path: Path) -> str:
    """The file is refused, in a sentence that says what to delete, and nothing is changed."""
    training = _Training(seed=2)
    before = training.bits(), training.order.bit_generator.state, training.noise.get_state().tolist()
    with pytest.raises(CheckpointError) as caught:
        load_training_state(path, training.parts, ImitationProgress)
    assert before == (training.bits(), training.order.bit_generator.state, training.noise.get_state().tolist())
    message = str(caught.value)
    assert len(message) < 2000 and "\n" not in message and path.name in message
    assert message.endswith("delete this file and rerun the command: the training starts again from its beginning.")
    return message


def test_values_have_a_schema(stored: Path) -> None:
    assert load_training_state(stored, _Training(seed=2).parts, ImitationProgress) == VALUES
    for values, words in (
        ({"epoch": "1"}, "epoch=1 has the wrong type"),
        ({"epoch": -1}, "out of range"),
        ({"epoch": 2}, "epoch=2 does not match its history of 1 epochs"),
        ({"history": None}, "history=null"),
        ({"history": [{"loss": 0.5}]}, "row 0 of the history lacks epoch"),
        ({"history": [{"epoch": 1.0, "loss": "0.5"}]}, "loss=0.5 has the wrong type"),
        ({"history": [{"epoch": 7.0}]}, "row 0 of the history has epoch=7"),
        ({"history": [[1]]}, "history"),
    ):
        save_training_state(stored, _Training(seed=1).parts | VALUES | values)
        assert words in refused(stored)
    save_training_state(stored, _Training(seed=1).parts | {"epoch": 0})
    assert "The key history is missing" in refused(stored)


DOCUMENTS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "empty": lambda document: {},
    "a part that is null": lambda document: document | {"network": None},
    "a part without a kind": lambda document: document | {"network": {"content": None}},
    "an unknown kind": lambda document: document | {"network": {"kind": "code", "content": "import os"}},
    "a kind of another type": lambda document: document | {"network": {"kind": ["module"], "content": None}},
    "another kind": lambda document: document | {"network": {"kind": "optimizer", "content": None}},
    "a tensor that is missing": lambda document: document | {"more": {"kind": "tensor", "content": None}},
    "an additional part": lambda document: document | {"more": {"kind": "module", "content": None}},
    "a part that is missing": lambda document: {name: document[name] for name in document if name != "noise"},
}
CONTENTS: dict[str, tuple[str, Any]] = {
    "optimizer null": ("optimizer", None),
    "optimizer list": ("optimizer", []),
    "optimizer empty": ("optimizer", {}),
    "optimizer groups null": ("optimizer", {"scalars": {}, "groups": None}),
    "optimizer groups of numbers": ("optimizer", {"scalars": {}, "groups": [1]}),
    "optimizer without settings": ("optimizer", {"scalars": {}, "groups": [{"params": [0, 1, 2, 3]}]}),
    "optimizer scalars null": ("optimizer", {"scalars": None, "groups": []}),
    "generator null": ("order", None),
    "generator empty": ("order", {}),
    "generator of another kind": ("order", {"bit_generator": "MT19937", "state": {}}),
    "generator without state": ("order", {"bit_generator": "PCG64"}),
    "generator of text": ("order", {"bit_generator": "PCG64", "state": {"state": "1", "inc": "2"}}),
    "generator of a list": ("order", [1, 2]),
}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_documents_that_are_no_states_are_refused(stored: Path, name: str) -> None:
    arrays, document = read_tensor_file(stored)
    write_tensor_file(stored, arrays, DOCUMENTS[name](document))
    refused(stored)


@pytest.mark.parametrize("name", CONTENTS)
def test_contents_of_parts_that_do_not_fit_are_refused(stored: Path, name: str) -> None:
    arrays, document = read_tensor_file(stored)
    part, content = CONTENTS[name]
    write_tensor_file(stored, arrays, document | {part: document[part] | {"content": content}})
    refused(stored)


@pytest.mark.parametrize(
    ("key", "value"),
    [("lr", "0.01"), ("lr", None), ("lr", 10**30), ("lr", -1.0), ("betas", [0.9]), ("betas", "abcd"), ("eps", 1.0),
     ("amsgrad", True), ("params", [3, 2, 1, 0]), ("params", [0, 1, 2]), ("foreach", "yes")],
)  # fmt: skip
def test_settings_of_an_optimizer_are_those_of_the_training(stored: Path, key: str, value: Any) -> None:
    arrays, document = read_tensor_file(stored)
    document["optimizer"]["content"]["groups"][0][key] = value
    write_tensor_file(stored, arrays, document)
    refused(stored)


ARRAYS: dict[str, dict[str, Any]] = {
    "weights that are not finite": {"network/0.bias": np.full(4, np.nan, np.float32)},
    "weights of another type": {"network/0.bias": np.zeros(4, np.int64)},
    "weights in double precision": {"network/0.bias": np.zeros(4)},
    "a missing weight": {"network/0.bias": None},
    "moments that are not finite": {"optimizer/1.exp_avg": np.full(4, np.inf, np.float32)},
    "moments of another shape": {"optimizer/1.exp_avg": np.zeros(3, np.float32)},
    "moments of another type": {"optimizer/1.exp_avg": np.zeros(4, np.int64)},
    "moments of no parameter": {"optimizer/9.exp_avg": np.zeros(4, np.float32)},
    "moments without a number": {"optimizer/x.exp_avg": np.zeros(4, np.float32)},
    "missing moments": {"optimizer/1.exp_avg": None},
    "a generator of another length": {"noise/state": np.zeros(3, np.uint8)},
    "a generator of another type": {"noise/state": np.zeros(5056)},
    "a missing generator": {"noise/state": None},
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_that_do_not_fit_are_refused(stored: Path, name: str) -> None:
    arrays, document = read_tensor_file(stored)
    changed = {key: values for key, values in (arrays | ARRAYS[name]).items() if values is not None}
    write_tensor_file(stored, changed, document)
    refused(stored)


def test_files_that_cannot_be_opened_say_what_to_delete(tmp_path: Path) -> None:
    path = tmp_path / "state.safetensors"
    path.mkdir()
    assert "is a folder" in refused(path)
    path.rmdir()
    path.symlink_to(path)
    assert "loop of links" in refused(path)
    path.unlink()
    os.mkfifo(path)
    assert "not a regular file" in refused(path)
    path.unlink()
    path.write_bytes(b"")
    assert "0 bytes" in refused(path)
    path.write_bytes(b"x" * 100)
    assert "is damaged" in refused(path)
