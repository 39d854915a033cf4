"""A pass of the image network against a matrix product of as many operations."""

from __future__ import annotations

import torch
from torch.utils.flop_counter import FlopCounterMode

from tests.benchmarks.timing import Effort, compare, show_title, timed
from visualrhp.heuristics.networks import ActorCritic
from visualrhp.observation import make_observation

_SIDE = 512


def run(effort: Effort) -> None:
    show_title("Image network, one thread")
    network = ActorCritic(make_observation("image", None))
    repetitions = max(1, effort.repetitions // 3)
    size = 500 if effort.repetitions > 1 else 10
    images = torch.randint(0, 6, (size, 64, 64), dtype=torch.uint8)
    closed = torch.zeros(size)

    def step() -> None:
        mean, std, value = network(images, closed)
        (mean.sum() + std.sum() + value.sum()).backward()

    counter = FlopCounterMode(display=False)
    with counter:
        step()
    products = max(1, round(counter.get_total_flops() / (2 * _SIDE**3)))
    matrix = torch.randn(_SIDE, _SIDE)
    compare(
        f"forward and backward pass of {size} samples",
        timed(step),
        timed(lambda: [matrix @ matrix for _ in range(products)]),
        f"{counter.get_total_flops() / size / 1e6:.1f} MFLOP a sample as matrix products",
        repetitions,
    )
