"""Files of heuristics: what fits is read, what does not is named."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visualrhp.errors import CheckpointError, LearningError
from visualrhp.heuristics.checkpoint import StoredNetwork, load_heuristic, read_network, write_network
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


def refused(path: Path, *words: str, **expected: Any) -> None:
    """Both ways to load a file refuse it in one sentence that names it."""
    for load in (load_heuristic, load_network):
        with pytest.raises(CheckpointError) as caught:
            load(path, **expected)
        message = str(caught.value)
        assert path.name in message and len(message) < 2000 and "\n" not in message
        for word in words:
            assert word in message


@pytest.fixture(params=["discrete", "continuous"])
def stored(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    path = tmp_path / "heuristic.safetensors"
    save_heuristic(path, make_network(request.param, CARTESIAN), {"seed": 3})
    return path


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_weights_that_are_not_finite_are_refused(stored: Path, value: float) -> None:
    weights, document = read_tensor_file(stored)
    for name in ("body.0.weight", "body.2.bias"):
        changed = weights[name].copy()
        changed.reshape(-1)[-1] = value
        write_tensor_file(stored, weights | {name: changed}, document)
        refused(stored, f"holds no network: its weights {name} are not finite", "train the network again")


def test_weights_that_overflow_are_refused(stored: Path) -> None:
    weights, document = read_tensor_file(stored)
    write_tensor_file(stored, {name: np.full(values.shape, 1e300) for name, values in weights.items()}, document)
    refused(stored, "not finite (in single precision)")
    write_tensor_file(stored, {name: np.full_like(values, 1e37) for name, values in weights.items()}, document)
    refused(stored, "its outputs are not finite")


@pytest.mark.parametrize("dtype", [np.int8, np.int64, np.uint8, np.bool_])
def test_weights_of_another_type_are_refused(stored: Path, dtype: Any) -> None:
    weights, document = read_tensor_file(stored)
    write_tensor_file(stored, {name: values.astype(dtype) for name, values in weights.items()}, document)
    refused(stored, f"are {np.dtype(dtype)}, but weights are floating-point numbers")


def test_complex_weights_are_refused(stored: Path) -> None:
    weights, document = read_tensor_file(stored)
    write_tensor_file(stored, {name: values.astype(np.complex64) for name, values in weights.items()}, document)
    refused(stored)


@pytest.mark.parametrize("dtype", [np.float16, np.float64])
def test_weights_of_another_precision_are_read(stored: Path, dtype: Any) -> None:
    weights, document = read_tensor_file(stored)
    write_tensor_file(stored, {name: values.astype(dtype) for name, values in weights.items()}, document)
    task = tasks(1)[0]
    values = load_heuristic(stored).guide([task.scene], [task.state]).values
    assert np.isfinite(values).all()


@pytest.mark.parametrize("change", ["missing", "additional", "transposed", "one row less", "none"])
def test_other_names_and_shapes_are_refused(stored: Path, change: str) -> None:
    weights, document = read_tensor_file(stored)
    name = "body.2.weight"
    changed: dict[str, Any] = {
        "missing": {key: values for key, values in weights.items() if key != name},
        "additional": weights | {"body.4.weight": np.zeros((1, 1), np.float32)},
        "transposed": weights | {name: weights[name].T[None]},
        "one row less": weights | {name: weights[name][:-1]},
        "none": {},
    }[change]
    write_tensor_file(stored, changed, document)
    refused(stored, "another architecture", "body.")


@pytest.mark.parametrize(
    "change",
    [
        {"action_space": "both"},
        {"action_space": None},
        {"action_space": ["discrete"]},
        {"observation": 3},
        {"observation": "smell"},
        {"observation": "image"},
        {"num_objects": "abc"},
        {"num_objects": 0},
        {"num_objects": 10**30},
        {"num_objects": 3},
        {"num_objects": None},
        {"num_objects": 2.0},
        {"card": None},
        {"card": []},
        {"format": 2},
        {"format": ["x" * 5000]},
    ],
    ids=lambda change: str(change)[:30],
)
def test_documents_that_do_not_fit_are_refused(stored: Path, change: dict[str, Any]) -> None:
    weights, document = read_tensor_file(stored)
    write_tensor_file(stored, weights, document | change)
    refused(stored)


@pytest.mark.parametrize("key", ["format", "action_space", "observation", "num_objects", "card"])
def test_documents_that_lack_a_key_are_refused(stored: Path, key: str) -> None:
    weights, document = read_tensor_file(stored)
    write_tensor_file(stored, weights, {name: value for name, value in document.items() if name != key})
    refused(stored)


def test_a_network_of_another_observation_is_refused(stored: Path) -> None:
    refused(stored, "is a network for cartesian observations of 2 objects, but one for", expect_observation=IMAGE)
    other = make_observation("cartesian", 3)
    refused(stored, "cartesian observations of 3 objects is needed here", expect_observation=other)
    assert load_heuristic(stored, expect_observation=CARTESIAN).observation == CARTESIAN
    assert load_network(stored, expect_observation=CARTESIAN)[1] == {"seed": 3}


def test_files_that_cannot_be_opened_are_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "heuristic.safetensors"
    path.mkdir()
    refused(path, "is a folder")
    path.rmdir()
    path.symlink_to(path)
    refused(path, "loop of links")
    path.unlink()
    path.symlink_to(tmp_path / "nowhere")
    refused(path, "which does not exist")
    path.unlink()
    os.mkfifo(path)
    refused(path, "not a regular file")
    path.unlink()
    path.write_bytes(b"")
    refused(path, "0 bytes")


def test_a_network_that_diverged_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "heuristic.safetensors"
    save_heuristic(path, make_network("discrete", CARTESIAN))
    network = read_network(path)
    weights = {name: np.full_like(values, np.nan) for name, values in network.weights.items()}
    before = path.read_bytes()
    with pytest.raises(LearningError, match=r"the training diverged: .* and 3 more .* learning rate"):
        write_network(path, StoredNetwork(weights, network.action_space, network.observation, {}))
    assert path.read_bytes() == before
