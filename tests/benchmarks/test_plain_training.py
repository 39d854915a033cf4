"""The plain networks of the benchmark are ours: the comparison is of the same computation."""

from __future__ import annotations

import torch

from tests.benchmarks.plain_training import PlainCoordConv, plain
from tests.heuristics.plain_convolution import PlainLabelConvolution
from visualrhp.heuristics.networks import ActorCritic
from visualrhp.observation import make_observation


def test_plain_networks_have_the_same_outputs_and_gradients() -> None:
    torch.manual_seed(0)
    network = ActorCritic(make_observation("image", None))
    slow = plain(network)
    kinds = [type(layer) for layer in slow.encoder.layers]  # pyright: ignore[reportGeneralTypeIssues, reportArgumentType]
    assert kinds.count(PlainLabelConvolution) == 1 and kinds.count(PlainCoordConv) == 2
    images = torch.randint(0, 6, (5, 64, 64), dtype=torch.uint8)
    closed = torch.tensor([0.0, 1.0, 0.0, 1.0, 0.0])
    gradients = []
    outputs = [network(images, closed), slow(images, closed)]
    for each, (mean, std, value) in zip((network, slow), outputs, strict=True):
        (mean.sum() + std.sum() + value.sum()).backward()
        gradients.append([parameter.grad for parameter in each.parameters()])
    for ours, theirs in zip(*outputs, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-4)
    for ours, theirs in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=1e-3)
