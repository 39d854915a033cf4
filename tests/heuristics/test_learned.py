"""A network as a heuristic: its observations and its guidance."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from visualrhp.errors import ConfigError, SceneError
from visualrhp.heuristics.conversion import heuristic_of
from visualrhp.heuristics.heuristic import GaussianGuidance, SoftmaxGuidance
from visualrhp.heuristics.networks import make_network
from visualrhp.observation import LabelImageObservation, make_observation
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import TaskInstance
from visualrhp.streams import Split

IMAGE = make_observation("image")
CARTESIAN = make_observation("cartesian", 2)


def tasks(count: int, num_objects: int = 2) -> list[TaskInstance]:
    distribution = SceneDistribution(num_objects=(num_objects, num_objects))
    return [sample_task_instance(distribution, 0, Split.TUNING, index) for index in range(count)]


def test_guidance_in_the_discrete_action_space_is_the_networks_q_values() -> None:
    network = make_network("discrete", IMAGE)
    some = tasks(3)
    guidance = heuristic_of(network, temperature=2.5).guide([t.scene for t in some], [t.state for t in some])
    assert isinstance(guidance, SoftmaxGuidance)
    images = torch.from_numpy(np.stack([IMAGE(t.scene, t.state) for t in some]))
    with torch.no_grad():
        expected = network(images, torch.zeros(3))
    np.testing.assert_allclose(guidance.q_values, expected.numpy(), rtol=1e-5, atol=1e-5)
    assert guidance.q_values.dtype == np.float64
    assert guidance.temperature == 2.5


def test_guidance_in_the_continuous_action_space_is_a_gaussian() -> None:
    some = tasks(3)
    heuristic = heuristic_of(make_network("continuous", CARTESIAN))
    guidance = heuristic.guide([t.scene for t in some], [t.state for t in some])
    assert isinstance(guidance, GaussianGuidance)
    assert guidance.means.shape == guidance.stds.shape == (3, 4)
    assert guidance.values.shape == (3,)
    assert heuristic.action_space == "continuous"


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_equal_states_are_observed_once(action_space: str, monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = tasks(2)
    heuristic = heuristic_of(make_network(action_space, IMAGE))
    pairs = [
        (one.scene, one.state),
        (other.scene, other.state),
        (other.scene, one.state),
    ]  # a scene's target is its own
    separate = [heuristic.guide([scene], [state]) for scene, state in pairs]
    looks = []
    call = LabelImageObservation.__call__
    monkeypatch.setattr(LabelImageObservation, "__call__", lambda *args: looks.append(args) or call(*args))
    order = [0, 1, 0, 2, 1, 0]
    together = heuristic.guide(*zip(*[pairs[k] for k in order], strict=True))
    assert len(looks) == len(pairs)
    assert len({values.tobytes() for values in together.values}) == len(pairs)
    for row, k in enumerate(order):
        assert together.values[row] == separate[k].values[0]
        assert np.array_equal(together.mode()[row], separate[k].mode()[0])


def test_a_heuristic_has_the_weights_that_it_was_made_with() -> None:
    torch.manual_seed(4)
    network = make_network("discrete", IMAGE)
    task = tasks(1)[0]
    heuristic = heuristic_of(network)
    before = heuristic.guide([task.scene], [task.state]).values
    network(torch.from_numpy(IMAGE(task.scene, task.state))[None], torch.zeros(1)).sum().backward()
    torch.optim.SGD(network.parameters(), lr=0.1).step()
    np.testing.assert_array_equal(heuristic.guide([task.scene], [task.state]).values, before)
    assert (heuristic_of(network).guide([task.scene], [task.state]).values != before).all()


def test_temperature_must_be_positive() -> None:
    with pytest.raises(ConfigError, match="temperature=0"):
        heuristic_of(make_network("discrete", CARTESIAN), temperature=0.0)


def test_cartesian_network_refuses_another_number_of_objects() -> None:
    task = tasks(1, num_objects=3)[0]
    with pytest.raises(SceneError, match=r"3 objects.*of 2 objects"):
        heuristic_of(make_network("discrete", CARTESIAN)).guide([task.scene], [task.state])
