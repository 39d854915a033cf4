"""Shapes of the outputs, first outputs, and the seed."""

from __future__ import annotations

import pytest
import torch

from visualrhp.embodiment.segmentation.classes import NUM_CLASSES
from visualrhp.embodiment.segmentation.configs import NetworkConfig
from visualrhp.embodiment.segmentation.network import SegmentationNetwork
from visualrhp.errors import ConfigError

TINY = NetworkConfig((4, 6, 8), (1, 1), 6, 4)


@pytest.mark.parametrize("size", [32, 120, 36])
def test_outputs_have_half_the_resolution(size: int) -> None:
    output = SegmentationNetwork(TINY)(torch.zeros((2, size, size, 3), dtype=torch.uint8))
    assert output.surfaces.shape == (2, 3, size // 2, size // 2)
    assert output.kinds.shape == (2, NUM_CLASSES - 2, size // 4, size // 4)
    probabilities = output.probabilities()
    assert probabilities.shape == (2, NUM_CLASSES, size // 2, size // 2)
    torch.testing.assert_close(probabilities.sum(dim=1), torch.ones(2, size // 2, size // 2))
    assert output.centres.shape == (2, size // 2, size // 2)
    assert output.offsets.shape == (2, 2, size // 2, size // 2)


def test_few_cells_are_centres_before_training() -> None:
    output = SegmentationNetwork(TINY)(torch.zeros((2, 32, 32, 3), dtype=torch.uint8))
    assert float(output.centres.detach().sigmoid().mean()) < 0.15


def test_first_weights_are_a_function_of_the_seed() -> None:
    before = torch.random.get_rng_state()
    one, same, other = (SegmentationNetwork(TINY, seed).state_dict() for seed in (1, 1, 2))
    assert torch.equal(before, torch.random.get_rng_state())
    assert all(torch.equal(one[name], same[name]) for name in one)
    assert not torch.equal(one["head.weight"], other["head.weight"])


def test_the_default_is_a_few_megabytes() -> None:
    assert 0.3e6 < sum(weight.numel() for weight in SegmentationNetwork().parameters()) < 1.2e6


@pytest.mark.parametrize("blocks", [(1,), (1, 1, 1)])
def test_blocks_and_widths_match(blocks: tuple[int, ...]) -> None:
    with pytest.raises(ConfigError, match="blocks="):
        NetworkConfig((4, 6, 8), blocks)
