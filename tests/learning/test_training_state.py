"""A training that resumes from a file is bit-exact; a file that does not fit changes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from visualrhp.errors import CheckpointError
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
