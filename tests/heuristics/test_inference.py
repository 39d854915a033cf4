"""The networks in NumPy are the networks in PyTorch, and what they answer for a state is theirs alone."""

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

from visualrhp.environments.task import ObservationFunction
from visualrhp.heuristics.inference import FastNetwork
from visualrhp.heuristics.networks import ActorCritic, QNetwork, make_network
from visualrhp.scene.sampling import SceneDistribution, Split, sample_task_instance

ROOT = Path(__file__).resolve().parents[2]
FUNCTIONS = {"image": ObservationFunction("image"), "cartesian": ObservationFunction("cartesian", 4)}


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
    outputs = FastNetwork(network)(observations, closed)
    expected = outputs_of(network, observations, closed)
    assert len(outputs) == len(expected) == (1 if action_space == "discrete" else 3)
    for ours, theirs in zip(outputs, expected, strict=True):
        assert ours.dtype == np.float32 and ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)
        assert batch == 1 or np.ptp(ours) > 0.01


def test_it_computes_a_network_in_double_precision_in_single() -> None:
    network = a_network("continuous", "image").double()
    outputs = FastNetwork(network)(*seen("image"))
    for ours, theirs in zip(outputs, FastNetwork(network.float())(*seen("image")), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["image", "cartesian"])
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_an_answer_is_the_same_to_the_bit_in_any_company(action_space: str, name: str) -> None:
    """Also wherever in memory it is computed: other arrays come and go in between."""
    fast = FastNetwork(a_network(action_space, name))
    observations, closed = seen(name)
    together = fast(observations, closed)
    rng = np.random.default_rng(1)
    others = []
    for _ in range(60):
        chosen = rng.integers(20, size=rng.integers(1, 20))
        others.append(np.empty(int(rng.integers(1, 4000)), dtype=np.uint8))
        for all_of_it, part in zip(together, fast(observations[chosen], closed[chosen]), strict=True):
            np.testing.assert_array_equal(part, all_of_it[chosen])


def fingerprint() -> str:
    """Of what two networks answer."""
    digest = hashlib.sha256()
    for name in FUNCTIONS:
        for output in FastNetwork(a_network("continuous", name))(*seen(name)):
            digest.update(output.tobytes())
    return digest.hexdigest()


def test_answers_are_the_same_to_the_bit_in_another_process_with_two_threads() -> None:
    code = "from tests.heuristics.test_inference import fingerprint; print(fingerprint())"
    environment = os.environ | {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
    command = [sys.executable, "-c", code]
    answer = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == fingerprint()
