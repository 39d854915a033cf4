"""A network as a heuristic: what it is shown, what it answers, and its files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from visualrhp.environments.task import ObservationFunction
from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.heuristics.checkpoint import load_heuristic, load_network, save_heuristic
from visualrhp.heuristics.heuristic import GaussianGuidance, SoftmaxGuidance
from visualrhp.heuristics.learned import LearnedHeuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file
from visualrhp.scene.sampling import SceneDistribution, Split, sample_task_instance
from visualrhp.scene.scene import TaskInstance

IMAGE = ObservationFunction("image")
CARTESIAN = ObservationFunction("cartesian", 2)


def tasks(count: int, num_objects: int = 2) -> list[TaskInstance]:
    distribution = SceneDistribution(num_objects=(num_objects, num_objects))
    return [sample_task_instance(distribution, 0, Split.TUNING, index) for index in range(count)]


def test_guidance_in_the_discrete_action_space_is_the_networks_q_values() -> None:
    network = make_network("discrete", IMAGE)
    some = tasks(3)
    guidance = LearnedHeuristic(network, temperature=2.5).guide([t.scene for t in some], [t.state for t in some])
    assert isinstance(guidance, SoftmaxGuidance)
    images = torch.from_numpy(np.stack([IMAGE(t.scene, t.state) for t in some]))
    with torch.no_grad():
        expected = network(images, torch.zeros(3))
    np.testing.assert_allclose(guidance.q_values, expected.numpy(), rtol=1e-5, atol=1e-5)
    assert guidance.q_values.dtype == np.float64
    assert guidance.temperature == 2.5


def test_guidance_in_the_continuous_action_space_is_a_gaussian() -> None:
    some = tasks(3)
    heuristic = LearnedHeuristic(make_network("continuous", CARTESIAN))
    guidance = heuristic.guide([t.scene for t in some], [t.state for t in some])
    assert isinstance(guidance, GaussianGuidance)
    assert guidance.means.shape == guidance.stds.shape == (3, 4)
    assert guidance.values.shape == (3,)
    assert heuristic.action_space == "continuous"


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_states_that_are_asked_about_twice_are_looked_at_once(
    action_space: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = tasks(2)
    heuristic = LearnedHeuristic(make_network(action_space, IMAGE))
    pairs = [
        (one.scene, one.state),
        (other.scene, other.state),
        (other.scene, one.state),
    ]  # a scene's target is its own
    separate = [heuristic.guide([scene], [state]) for scene, state in pairs]
    looks = []
    call = ObservationFunction.__call__
    monkeypatch.setattr(ObservationFunction, "__call__", lambda *args: looks.append(args) or call(*args))
    order = [0, 1, 0, 2, 1, 0]
    together = heuristic.guide(*zip(*[pairs[k] for k in order], strict=True))
    assert len(looks) == len(pairs)
    assert len({values.tobytes() for values in together.values}) == len(pairs)
    for row, k in enumerate(order):
        assert together.values[row] == separate[k].values[0]
        assert np.array_equal(together.mode()[row], separate[k].mode()[0])


@pytest.mark.parametrize(
    "change",
    [
        lambda network: torch.optim.SGD(network.parameters(), lr=0.1).step(),
        lambda network: torch.optim.Adam(network.parameters(), lr=0.1, fused=True).step(),
        lambda network: network.load_state_dict({n: 1.1 * t for n, t in network.state_dict().items()}),
        lambda network: network.double(),
    ],
    ids=["optimizer", "fused optimizer", "weights from elsewhere", "other precision"],
)
def test_a_network_in_training_guides_with_its_present_weights(change: Callable[[torch.nn.Module], None]) -> None:
    torch.manual_seed(4)
    network = make_network("discrete", IMAGE)
    heuristic = LearnedHeuristic(network)
    task = tasks(1)[0]
    heuristic.guide([task.scene], [task.state])
    network(torch.from_numpy(IMAGE(task.scene, task.state))[None], torch.zeros(1)).sum().backward()
    change(network)
    after = heuristic.guide([task.scene], [task.state])
    np.testing.assert_array_equal(after.values, LearnedHeuristic(network).guide([task.scene], [task.state]).values)


def test_temperature_must_be_positive() -> None:
    with pytest.raises(ConfigError, match="temperature=0"):
        LearnedHeuristic(make_network("discrete", CARTESIAN), temperature=0.0)


def test_cartesian_network_refuses_another_density() -> None:
    task = tasks(1, num_objects=3)[0]
    with pytest.raises(CheckpointError, match=r"scenes of 2 objects.*3"):
        LearnedHeuristic(make_network("discrete", CARTESIAN)).guide([task.scene], [task.state])


@pytest.mark.parametrize("function", [IMAGE, CARTESIAN], ids=["image", "cartesian"])
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_file_round_trip(tmp_path: Path, action_space: str, function: ObservationFunction) -> None:
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
    before = LearnedHeuristic(network).guide([t.scene for t in some], [t.state for t in some])
    after = load_heuristic(path).guide([t.scene for t in some], [t.state for t in some])
    np.testing.assert_array_equal(before.values, after.values)


def test_file_holds_nothing_but_weights(tmp_path: Path) -> None:
    """Tables that the code computes are no part of a released heuristic."""
    path = tmp_path / "heuristic.safetensors"
    network = make_network("discrete", IMAGE)
    save_heuristic(path, network)
    tensors, _ = read_tensor_file(path)
    assert set(tensors) == {name for name, _ in network.named_parameters()}


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
    write_tensor_file(path, {"weight": torch.zeros(2)}, {"format": "something else"})
    with pytest.raises(CheckpointError, match="no trained heuristic"):
        load_heuristic(path)


def test_another_architecture_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "heuristic.safetensors"
    save_heuristic(path, make_network("discrete", CARTESIAN))
    tensors, document = read_tensor_file(path)
    tensors["q_head.bias"] = torch.zeros(9)
    write_tensor_file(path, tensors, document)
    with pytest.raises(CheckpointError, match="another architecture"):
        load_heuristic(path)
