"""What torchrl is told about the entries, and devices."""

from __future__ import annotations

import pytest
import torch

from visualrhp.environments import specs
from visualrhp.environments.slots import TaskFamily
from visualrhp.errors import ConfigError
from visualrhp.observation import make_observation
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.streams import Split
from visualrhp.types import ActionSpaceName

BATCH = torch.Size([3])


def family(action_space: ActionSpaceName, observation: str) -> TaskFamily:
    objects = 2 if observation == "cartesian" else None
    distribution = SceneDistribution(num_objects=(2, 2))
    return TaskFamily(distribution, Split.REINFORCEMENT, action_space, make_observation(observation, objects))


def test_the_entries_have_their_shapes_and_types() -> None:
    image = specs.observation_spec(family("discrete", "image"), BATCH)
    assert image["observation"].shape == (3, 64, 64) and image["observation"].dtype is torch.uint8
    assert image["observation"].n == 6 and image["state"].shape == (3, 5 + 3 * 2)
    features = specs.observation_spec(family("discrete", "cartesian"), BATCH)["observation"]
    assert features.shape == (3, 4 * 2 + 6) and features.dtype is torch.float32
    assert specs.reward_spec(BATCH).shape == (3, 1)
    assert {key: spec.shape for key, spec in specs.done_spec(BATCH).items()} == {
        key: torch.Size([3, 1]) for key in ("done", "terminated", "truncated")
    }


def test_the_actions_are_those_of_the_space() -> None:
    discrete = specs.action_spec(family("discrete", "image"), BATCH)
    assert discrete.n == 8 and discrete.shape == (3,) and discrete.dtype is torch.int64
    continuous = specs.action_spec(family("continuous", "image"), BATCH)
    assert continuous.shape == (3, 4) and (continuous.low == -1.0).all() and (continuous.high == 1.0).all()


@pytest.mark.parametrize("device", ["cpu", torch.device("cpu"), "meta"])
def test_a_device_that_is_here(device: str | torch.device) -> None:
    assert specs.usable_device(device) == torch.device(device)


def test_a_device_that_is_not_here_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*args: object, **kwargs: object) -> None:
        raise AssertionError("Torch not compiled with CUDA enabled\nCompile with TORCH_USE_CUDA_DSA")

    monkeypatch.setattr(torch, "empty", broken)
    with pytest.raises(ConfigError, match=r"device='cuda' cannot be used: Torch not compiled with CUDA enabled; "):
        specs.usable_device("cuda")


@pytest.mark.parametrize("device", ["sonar", "cuda:99", "cpu:x", None, 1.5, torch.float32, [], "x" * 10_000], ids=repr)
def test_what_is_no_device_is_refused(device: object) -> None:
    with pytest.raises(ConfigError, match="cannot be used") as caught:
        specs.usable_device(device)
    assert len(str(caught.value)) < 600
