"""The architectures of Sec. 7.2: shapes, ranges, sizes, and independence of the images of a batch."""

from __future__ import annotations

import pytest
import torch
from torch import nn
from torch.nn import functional

from visualrhp.heuristics.architecture import MAX_STD, MIN_STD
from visualrhp.heuristics.networks import ActorCritic, CoordConv, QNetwork, make_network
from visualrhp.observation import Observation, make_observation
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace

IMAGE = make_observation("image")
CARTESIAN = make_observation("cartesian", 4)


def observations(function: Observation, batch: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    if function.name == "image":
        return torch.randint(6, (batch, *function.shape), generator=generator, dtype=torch.uint8)
    return torch.randn(batch, *function.shape, generator=generator)


def dense_sizes(network: nn.Module) -> set[tuple[int, int]]:
    return {(layer.in_features, layer.out_features) for layer in network.modules() if isinstance(layer, nn.Linear)}


def test_dense_layers_are_those_of_the_paper() -> None:
    assert dense_sizes(QNetwork(IMAGE)) == {(257, 128), (128, 128), (128, 8)}
    shared, value_head, policy_head = {(257, 256), (256, 128)}, {(128, 64), (64, 1)}, {(128, 128), (128, 8)}
    assert dense_sizes(ActorCritic(IMAGE)) == shared | value_head | policy_head
    features = CARTESIAN.shape[0] + 1
    assert (features, 128) in dense_sizes(QNetwork(CARTESIAN))
    assert (features, 256) in dense_sizes(ActorCritic(CARTESIAN))


def test_convolutions_are_those_of_the_paper() -> None:
    convolutions = [layer for layer in QNetwork(IMAGE).modules() if isinstance(layer, nn.Conv2d)]
    assert [(layer.in_channels, layer.out_channels) for layer in convolutions] == [(5, 8), (10, 8), (10, 16)]
    assert all(layer.kernel_size == (3, 3) for layer in convolutions)


@pytest.mark.parametrize("function", [IMAGE, CARTESIAN], ids=["image", "cartesian"])
@pytest.mark.parametrize("batch", [1, 3])
def test_outputs_have_their_shapes_and_ranges(function: Observation, batch: int) -> None:
    seen, closed = observations(function, batch), torch.ones(batch, dtype=torch.bool)
    assert QNetwork(function)(seen, closed).shape == (batch, DiscreteActionSpace.NUM_ACTIONS)
    network = ActorCritic(function)
    with torch.no_grad():
        for parameter in network.policy_head.parameters():
            parameter.mul_(40.0)  # far into the saturation of tanh and sigmoid
        mean, std, value = network(seen, closed)
    assert mean.shape == std.shape == (batch, ContinuousActionSpace.DIMENSION)
    assert value.shape == (batch,)
    assert (mean.abs() <= 1.0).all()
    assert (std >= MIN_STD - 1e-6).all() and (std <= MAX_STD + 1e-6).all()


@pytest.mark.parametrize("function", [IMAGE, CARTESIAN], ids=["image", "cartesian"])
def test_an_output_does_not_depend_on_the_rest_of_the_batch(function: Observation) -> None:
    """Otherwise the policy that collects would not be the one that is updated (the ratio of Eq. 8)."""
    network = make_network("discrete", function)
    seen, closed = observations(function, 6), torch.tensor([True, False] * 3)
    together = network.train()(seen, closed)
    alone = network.eval()(seen[3:4], closed[3:4])
    torch.testing.assert_close(together[3:4], alone, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("function", [IMAGE, CARTESIAN], ids=["image", "cartesian"])
def test_the_gripper_state_counts(function: Observation) -> None:
    network = make_network("discrete", function)
    seen = observations(function, 1)
    q = [network(seen, torch.tensor([closed])) for closed in (True, False)]
    assert not torch.allclose(*q)


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_every_parameter_receives_a_gradient(action_space: str) -> None:
    network = make_network(action_space, IMAGE)
    outputs = network(observations(IMAGE, 4), torch.ones(4))
    outputs = (outputs,) if isinstance(outputs, torch.Tensor) else outputs
    sum((output**2).sum() for output in outputs).backward()  # pyright: ignore[reportAttributeAccessIssue]
    assert all(parameter.grad is not None and parameter.grad.abs().sum() > 0 for parameter in network.parameters())


def test_coord_conv_is_a_convolution_over_appended_coordinates() -> None:
    layer = CoordConv(8, 16, size=8)
    maps = torch.randn(2, 8, 8, 8)
    axis = torch.linspace(-1.0, 1.0, 8)
    rows, columns = torch.meshgrid(axis, axis, indexing="ij")
    appended = torch.cat([maps, torch.stack([rows, columns]).expand(2, -1, -1, -1)], dim=1)
    expected = functional.max_pool2d(layer.convolution(appended), 2)
    torch.testing.assert_close(layer(maps), expected, rtol=1e-4, atol=1e-5)
