"""Our segmentation network: a small encoder and decoder with outputs for every cell of a grid (torch).

The outputs are those of Panoptic-DeepLab (Cheng et al., 2020): the class of each cell, a map whose peaks are the
centres of the visible parts of objects, and the offset from each cell to the centre of its object. Objects that touch
are told apart by their centres. A cell is 2 x 2 pixels of the input; probabilities of classes are coverages of it, so
that outlines are found between cells by interpolation (:mod:`visualrhp.embodiment.segmentation.grouping`).

Where objects are is found at the finest resolution, and what they are at the next one, where the features have seen
more of the image: together, they learn faster than nine classes from the finest features.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import nn
from torch.nn import functional

from visualrhp.embodiment.segmentation.classes import FIRST_OBJECT_CLASS, NUM_CLASSES, NUM_SURFACES
from visualrhp.embodiment.segmentation.configs import NetworkConfig

CELL: Final = 2
"""Side of a cell of the outputs [pixels of the input]."""

OFFSET_UNIT: Final = 8.0
"""Cells that an output of one of the offset head stands for, so that the outputs are of the order of 1."""

_PRIOR_LOGIT: Final = -4.0
"""First logit of the map of centres, few of whose cells are centres."""


@dataclass(frozen=True)
class SegmentationOutput:
    """Outputs for a batch of B images of S x S pixels, on G x G cells (G = S / 2).

    Attributes:
        surfaces: [B, 3, G, G] logits of background, robot and any object.
        kinds: [B, C - 2, G / 2, G / 2] logits of the classes of objects.
        centres: [B, G, G] logits of the map of centres.
        offsets: [B, 2, G, G] from each cell to the centre of its object, (x, y) in units of :data:`OFFSET_UNIT` cells.
    """

    surfaces: torch.Tensor
    kinds: torch.Tensor
    centres: torch.Tensor
    offsets: torch.Tensor

    def probabilities(self) -> torch.Tensor:
        """[B, C, G, G] of all classes."""
        surfaces = self.surfaces.softmax(dim=1)
        kinds = _enlarged(self.kinds, surfaces).softmax(dim=1)
        return torch.cat([surfaces[:, :FIRST_OBJECT_CLASS], surfaces[:, FIRST_OBJECT_CLASS:] * kinds], dim=1)


def _convolution(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
    )


class _Block(nn.Module):
    """A residual block of two convolutions."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = _convolution(width, width)
        self.second = nn.Sequential(nn.Conv2d(width, width, 3, 1, 1, bias=False), nn.BatchNorm2d(width))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return functional.relu(features + self.second(self.first(features)))


class SegmentationNetwork(nn.Module):
    """The network.

    Args:
        config: its size.
        seed: of the first weights.
    """

    def __init__(self, config: NetworkConfig | None = None, seed: int = 0) -> None:
        super().__init__()
        config = config or NetworkConfig()
        self.config = config
        widths, width = config.widths, config.decoder_width
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.stem = _convolution(3, widths[0], CELL)
            self.stages = nn.ModuleList(
                nn.Sequential(_convolution(before, after, 2), *(_Block(after) for _ in range(count)))
                for before, after, count in zip(widths, widths[1:], config.blocks, strict=False)
            )
            self.lateral = nn.ModuleList(nn.Conv2d(stage, width, 1) for stage in widths[1:])
            self.decoder = nn.ModuleList(_convolution(width, width) for _ in widths[1:-1])
            self.lift = nn.Conv2d(width, config.fine_width, 1)
            self.detail = nn.Conv2d(widths[0], config.fine_width, 1)
            self.fine = _convolution(config.fine_width, config.fine_width)
            self.kinds = nn.Conv2d(width, NUM_CLASSES - FIRST_OBJECT_CLASS, 1)
            self.head = nn.Conv2d(config.fine_width, NUM_SURFACES + 3, 1)
            bias = self.head.bias
            assert bias is not None
            nn.init.zeros_(bias)
            bias.data[NUM_SURFACES] = _PRIOR_LOGIT

    def forward(self, images: torch.Tensor) -> SegmentationOutput:
        """Args: images: [B, S, S, 3] uint8, RGB; S divisible by 4."""
        pixels = images.permute(0, 3, 1, 2).to(torch.float32) * (1.0 / 255.0) - 0.5
        stem = self.stem(pixels)
        features = [stem]
        for stage in self.stages:
            features.append(stage(features[-1]))
        decoded = self.lateral[-1](features[-1])
        for number in reversed(range(len(self.decoder))):
            skipped = features[number + 1]
            decoded = self.decoder[number](_enlarged(decoded, skipped) + self.lateral[number](skipped))
        fine = functional.relu(_enlarged(self.lift(decoded), stem) + self.detail(stem))
        output = self.head(self.fine(fine))
        surfaces, centres, offsets = output.split([NUM_SURFACES, 1, 2], dim=1)
        return SegmentationOutput(surfaces, self.kinds(decoded), centres[:, 0], offsets)


def _enlarged(coarse: torch.Tensor, fine: torch.Tensor) -> torch.Tensor:
    """``coarse``, interpolated to the resolution of ``fine``."""
    return functional.interpolate(coarse, size=fine.shape[-2:], mode="bilinear", align_corners=False)
