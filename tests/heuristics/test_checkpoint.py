"""Files of heuristics: what fits is read, what does not is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from visualrhp.errors import CheckpointError
from visualrhp.heuristics.checkpoint import load_heuristic
from visualrhp.heuristics.conversion import load_network, save_heuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file
from visualrhp.observation import make_observation
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import TaskInstance
from visualrhp.streams import Split

IMAGE = make_observation("image")
CARTESIAN = make_observation("cartesian", 2)


def tasks(count: int, num_objects: int = 2) -> list[TaskInstance]:
    distribution = SceneDistribution(num_objects=(num_objects, num_objects))
    return [sample_task_instance(distribution, 0, Split.TUNING, index) for index in range(count)]


def test_files_that_do_not_fit_are_named(tmp_path: Path) -> None:
    path = tmp_path / "heuristic.safetensors"
    with pytest.raises(CheckpointError, match=r"heuristic\.safetensors does not exist"):
        load_heuristic(path)
    save_heuristic(path, make_network("discrete", CARTESIAN))
    with pytest.raises(CheckpointError, match="discrete action space, but the continuous one"):
        load_heuristic(path, expect_action_space="continuous")
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="damaged"):
        load_heuristic(path)
    path.write_bytes(b"not a checkpoint")
    with pytest.raises(CheckpointError, match="damaged"):
        load_heuristic(path)
    write_tensor_file(path, {"weight": np.zeros(2, np.float32)}, {"format": "something else"})
    with pytest.raises(CheckpointError, match="not a trained heuristic"):
        load_heuristic(path)


def test_another_architecture_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "heuristic.safetensors"
    save_heuristic(path, make_network("discrete", CARTESIAN))
    tensors, document = read_tensor_file(path)
    tensors["q_head.bias"] = np.zeros(9, np.float32)
    write_tensor_file(path, tensors, document)
    with pytest.raises(CheckpointError, match="another architecture"):
        load_heuristic(path)


def test_another_architecture_is_refused_by_pytorch_and_by_numpy(tmp_path: Path) -> None:
    path = tmp_path / "heuristic.safetensors"
    save_heuristic(path, make_network("continuous", IMAGE))
    weights, document = read_tensor_file(path)
    for change in ({"body.0.weight": np.zeros((256, 99), np.float32)}, {"body.0.bias": None}):
        changed = {name: values for name, values in (weights | change).items() if values is not None}
        write_tensor_file(path, changed, document)
        for load in (load_heuristic, load_network):
            with pytest.raises(CheckpointError, match="another architecture"):
                load(path)
