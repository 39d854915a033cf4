"""Networks in PyTorch to heuristics and files, and back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from visualrhp.errors import ConfigError, LearningError
from visualrhp.heuristics.checkpoint import load_heuristic
from visualrhp.heuristics.conversion import (
    average_networks,
    heuristic_of,
    load_network,
    save_heuristic,
    weights_of,
)
from visualrhp.heuristics.networks import make_network
from visualrhp.heuristics.tensor_file import read_tensor_file
from visualrhp.observation import Observation, make_observation
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import TaskInstance
from visualrhp.streams import Split

IMAGE = make_observation("image")
CARTESIAN = make_observation("cartesian", 2)


def tasks(count: int, num_objects: int = 2) -> list[TaskInstance]:
    distribution = SceneDistribution(num_objects=(num_objects, num_objects))
    return [sample_task_instance(distribution, 0, Split.TUNING, index) for index in range(count)]


@pytest.mark.parametrize("function", [IMAGE, CARTESIAN], ids=["image", "cartesian"])
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_file_round_trip(tmp_path: Path, action_space: str, function: Observation) -> None:
    path = tmp_path / "heuristic.safetensors"
    network = make_network(action_space, function)
    save_heuristic(path, network, {"seed": 3, "commit": "abc"})
    loaded, card = load_network(path)
    assert card == {"seed": 3, "commit": "abc"}
    assert json.loads(path.with_suffix(".json").read_text())["card"] == card
    assert loaded.action_space == action_space
    assert loaded.observation == function
    for name, tensor in network.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor)
    some = tasks(2)
    before = heuristic_of(network).guide([t.scene for t in some], [t.state for t in some])
    after = load_heuristic(path).guide([t.scene for t in some], [t.state for t in some])
    np.testing.assert_array_equal(before.values, after.values)


def test_file_holds_nothing_but_weights(tmp_path: Path) -> None:
    """Constants that the code computes are not stored."""
    path = tmp_path / "heuristic.safetensors"
    network = make_network("discrete", IMAGE)
    save_heuristic(path, network)
    tensors, _ = read_tensor_file(path)
    assert set(tensors) == {name for name, _ in network.named_parameters()}


@pytest.mark.parametrize("function", [IMAGE, CARTESIAN], ids=["image", "cartesian"])
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_the_average_has_the_mean_weights(action_space: str, function: Observation) -> None:
    networks = [make_network(action_space, function) for _ in range(3)]
    shares = [0.5, 0.3, 0.2]
    averaged = weights_of(average_networks(networks, shares))
    weights = [weights_of(network) for network in networks]
    for name, values in averaged.items():
        expected = sum(share * each[name] for share, each in zip(shares, weights, strict=True))
        np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-6)
    for name, values in weights_of(average_networks(networks, [0.0, 1.0, 0.0])).items():
        np.testing.assert_array_equal(values, weights[1][name])


def test_what_cannot_be_averaged() -> None:
    network = make_network("discrete", IMAGE)
    for networks, shares in (([], []), ([network], [0.5]), ([network, network], [1.0])):
        with pytest.raises(ConfigError, match="one per network, sum 1"):
            average_networks(networks, shares)
    for other in (make_network("continuous", IMAGE), make_network("discrete", CARTESIAN)):
        with pytest.raises(ConfigError, match="cannot be averaged"):
            average_networks([network, other], [0.5, 0.5])


def test_a_network_that_diverged_is_no_heuristic() -> None:
    network = make_network("discrete", make_observation("cartesian", 1))
    with torch.no_grad():
        network.q_head.bias[3] = torch.nan
    with pytest.raises(LearningError, match=r"the training diverged: the weights q_head\.bias .*learner\.lr"):
        heuristic_of(network)
