"""The networks in NumPy are the networks in PyTorch, layer by layer; an output is bit-exact in any batch."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import nn

from visualrhp.environments import ClutterManipulation
from visualrhp.heuristics.checkpoint import load_heuristic
from visualrhp.heuristics.conversion import save_heuristic, weights_of
from visualrhp.heuristics.inference import InferenceNetwork
from visualrhp.heuristics.networks import ActorCritic, QNetwork, make_network
from visualrhp.observation import Observation, make_observation
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.streams import Split

ROOT = Path(__file__).resolve().parents[2]
FUNCTIONS = {"image": make_observation("image"), "cartesian": make_observation("cartesian", 4)}


def seen(name: str) -> tuple[np.ndarray, npt.NDArray[np.bool_]]:
    """Observations of twenty states, two of them noise of all labels, and grippers open and closed."""
    distribution = SceneDistribution(num_objects=(4, 4))
    tasks = [sample_task_instance(distribution, 0, Split.TUNING, index) for index in range(20)]
    observations = np.stack([FUNCTIONS[name](task.scene, task.state) for task in tasks])
    if name == "image":
        observations[7:9] = np.random.default_rng(0).integers(6, size=(2, 64, 64))
        observations[9] = 1  # no cell of several labels
    return observations, np.arange(20) % 3 == 0


def a_network(action_space: str, name: str) -> QNetwork | ActorCritic:
    """A network with weights as if trained: no layer is at its initial value, outputs are spread."""
    torch.manual_seed(5)
    network = make_network(action_space, FUNCTIONS[name])
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.1 * torch.randn(parameter.shape)
    return network


def inference_of(network: QNetwork | ActorCritic) -> InferenceNetwork:
    return InferenceNetwork(weights_of(network), network.action_space)


def outputs_of(network: QNetwork | ActorCritic, observations: np.ndarray, closed: np.ndarray) -> list[np.ndarray]:
    with torch.no_grad():
        outputs = network(torch.from_numpy(observations), torch.from_numpy(closed))
    return [output.numpy() for output in (outputs if isinstance(outputs, tuple) else (outputs,))]


@pytest.mark.parametrize("name", ["image", "cartesian"])
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
@pytest.mark.parametrize("batch", [1, 3, 20])
def test_it_computes_the_network(action_space: str, name: str, batch: int) -> None:
    network = a_network(action_space, name)
    observations, closed = (values[:batch] for values in seen(name))
    outputs = inference_of(network)(observations, closed)
    expected = outputs_of(network, observations, closed)
    assert len(outputs) == len(expected) == (1 if action_space == "discrete" else 3)
    for ours, theirs in zip(outputs, expected, strict=True):
        assert ours.dtype == np.float32 and ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)
        assert batch == 1 or np.ptp(ours) > 0.01


def test_it_computes_a_network_in_double_precision_in_single() -> None:
    network = a_network("continuous", "image").double()
    outputs = inference_of(network)(*seen("image"))
    for ours, theirs in zip(outputs, inference_of(network.float())(*seen("image")), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["image", "cartesian"])
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_an_output_is_bit_exact_in_any_batch(action_space: str, name: str) -> None:
    """Also wherever in memory it is computed: other arrays come and go in between."""
    inference = inference_of(a_network(action_space, name))
    observations, closed = seen(name)
    together = inference(observations, closed)
    rng = np.random.default_rng(1)
    others = []
    for _ in range(60):
        chosen = rng.integers(20, size=rng.integers(1, 20))
        others.append(np.empty(int(rng.integers(1, 4000)), dtype=np.uint8))
        for all_of_it, part in zip(together, inference(observations[chosen], closed[chosen]), strict=True):
            np.testing.assert_array_equal(part, all_of_it[chosen])


def fingerprint() -> str:
    """Of the outputs of two networks."""
    digest = hashlib.sha256()
    for name in FUNCTIONS:
        for output in inference_of(a_network("continuous", name))(*seen(name)):
            digest.update(output.tobytes())
    return digest.hexdigest()


def test_outputs_are_bit_exact_in_another_process_with_two_threads() -> None:
    code = "from tests.heuristics.test_inference import fingerprint; print(fingerprint())"
    environment = os.environ | {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
    command = [sys.executable, "-c", code]
    answer = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == fingerprint()


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_every_layer_of_the_encoder_is_the_networks(action_space: str) -> None:
    network = a_network(action_space, "image")
    labels = seen("image")[0]
    encoder = inference_of(network).encoder
    assert encoder is not None
    maps = torch.from_numpy(labels)
    ours = encoder.maps(labels)
    layers = network.encoder.layers
    assert isinstance(layers, nn.Sequential)
    activated = []
    with torch.no_grad():
        for layer in layers:
            maps = layer(maps)
            if isinstance(layer, nn.LeakyReLU):
                activated.append(maps.permute(0, 2, 3, 1).numpy())
    assert len(ours) == len(activated) == 3
    for mine, theirs in zip(ours, activated, strict=True):
        assert mine.shape == theirs.shape
        np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(encoder(labels), maps.numpy(), rtol=1e-4, atol=1e-5)


class Distance(Observation):
    """A third observation, defined by a user: two features, for any number of objects."""

    name = "distance"
    dtype = np.float32
    low, high = 0.0, 10.0

    @property
    def shape(self):
        return (2,)

    def __call__(self, scene, state):
        offset = state.object_poses[0, :2] - scene.target.position
        return np.array([np.hypot(*offset), state.gripper_opening], np.float32)

    def mirror(self, observations):
        return observations


def test_a_third_observation_needs_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "heuristic.safetensors"
    torch.manual_seed(0)
    network = make_network("continuous", Distance())
    save_heuristic(path, network)
    heuristic = load_heuristic(path)
    task = sample_task_instance(SceneDistribution(num_objects=3), 0, Split.TUNING, 0)
    guidance = heuristic.guide([task.scene], [task.state])
    observed = torch.from_numpy(Distance()(task.scene, task.state))[None]
    with torch.no_grad():
        mean, _, value = network(observed, torch.tensor([task.state.gripper_closed]))
    np.testing.assert_allclose(guidance.mode()[0], mean[0].numpy(), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(guidance.values, value.numpy(), rtol=1e-4)
    env = ClutterManipulation(observation="distance")
    assert env.reset(seed=0)[0]["observation"].shape == (2,)


PLAN = """
import sys
import numpy as np
import visualrhp
from visualrhp.heuristics.checkpoint import load_heuristic
from visualrhp.planning import RecedingHorizon
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.streams import Split

for path in sys.argv[1:]:
    heuristic = load_heuristic(path)
    task = sample_task_instance(SceneDistribution(num_objects=4), 0, Split.TUNING, 0)
    model = TransitionModel(task.scene, make_action_space(heuristic.action_space))
    decision = RecedingHorizon(heuristic).plan(model, task.state, np.random.default_rng(0))
    assert decision.action is not None and len(decision.rollouts) == 3
heavy = {"torch", "torchrl", "tensordict", "scipy", "pandas", "matplotlib"} & set(sys.modules)
sys.exit(f"planning imported {sorted(heavy)}" if heavy else 0)
"""


def test_a_planning_process_never_imports_torch(tmp_path: Path) -> None:
    paths = []
    for action_space in ("continuous", "discrete"):
        for name in FUNCTIONS:
            paths.append(str(tmp_path / f"{action_space}_{name}.safetensors"))
            save_heuristic(paths[-1], a_network(action_space, name))
    command = [sys.executable, "-c", PLAN, *paths]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
