"""What the first layer of the image networks is defined as, computed step by step."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from visualrhp.heuristics.label_convolution import POOLING, LabelConvolution, label_colours
from visualrhp.observation.label_image import IMAGE_SIZE, Label


class PlainLabelConvolution(nn.Module):
    """CoordConv on the coloured image with a border of edge pixels, and max pooling 4 x 4.

    Args:
        layer: whose weights it has.
    """

    colours: torch.Tensor
    coordinates: torch.Tensor

    def __init__(self, layer: LabelConvolution) -> None:
        super().__init__()
        self.convolution = layer.convolution
        dtype = layer.convolution.weight.dtype
        step = 2.0 / (IMAGE_SIZE - 1)
        axis = torch.linspace(-1.0 - step, 1.0 + step, IMAGE_SIZE + 2, dtype=dtype)
        self.register_buffer("coordinates", torch.stack(torch.meshgrid(axis, axis, indexing="ij")))
        self.register_buffer("colours", torch.from_numpy(label_colours()).to(dtype))

    def forward(self, labels: torch.Tensor) -> torch.Tensor:
        """Labels [B, 64, 64] to pooled maps [B, out, 16, 16]."""
        padded = functional.pad(labels.long(), (1, 1, 1, 1), value=int(Label.EDGE))
        colours = self.colours[padded].permute(0, 3, 1, 2)
        coordinates = self.coordinates.expand(len(labels), -1, -1, -1)
        return functional.max_pool2d(self.convolution(torch.cat([colours, coordinates], dim=1)), POOLING)
