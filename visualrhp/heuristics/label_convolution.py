r"""The first layer of the image networks, made for label images: CoordConv, convolution 3 x 3 and max pooling 4 x 4.

It has the weights of ``nn.Conv2d(5, out, 3)``, and colours the labels, appends two coordinate channels, convolves and
pools. A GPU computes it step by step (:meth:`LabelConvolution.plain`). On a CPU, the same result and gradient, in
single precision, are nearly ten times faster, by exploiting three facts:

- **Coordinates are linear**, and so is their convolution: a plane :math:`a_f + b_f \cdot (row, column)` for each filter
  :math:`f`. It is the sum of its value at the centre of a pooling cell, added after pooling, and an offset for each of
  the 16 pixels of a cell, the same in all cells.
- **Two thirds of the cells are uniform**: they and their border of one pixel have a single label. Their pooled value
  depends only on the label, and comes from a table with one row per label.
- **A label is one of six**, so three neighbouring pixels have one of 216 codes, and a cell with its border (6 x 6
  pixels) has twelve codes. A cell is convolved by adding twelve rows of a table, which holds the contribution of each
  code at each of the twelve places to the 16 x out values to be pooled. In the backward pass, the gradient of a pooled
  value reaches one pixel, whose 3 x 3 patch has three codes: a histogram over (row of the kernel, filter, code) is
  sufficient for the gradient of the weights.

Outside the image, the label is that of the world beyond the surface (edge), and the coordinates continue.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import nn
from torch.nn import functional

from visualrhp.heuristics.architecture import (
    CELLS,
    NUM_CODES,
    NUM_LABELS,
    PATCH,
    POOLING,
    cell_centres,
    cell_offsets,
    cell_windows,
    code_colours,
    kernel_offsets,
    label_colours,
)
from visualrhp.observation.label_image import IMAGE_SIZE, Label

_SPACING = 2.0 / (IMAGE_SIZE - 1)
"""Of the coordinates of two neighbouring pixels."""

_PLACES = PATCH * PATCH // 3
_POSITIONS = POOLING * POOLING
_CHUNK = 500
"""Number of images convolved at a time, so that their data (about 60 kB each) stays in the processor cache."""

_MIXED = NUM_LABELS
"""Label of cells with several labels."""


class LabelConvolution(nn.Module):
    """CoordConv (three colours, two coordinates from -1 to 1), convolution 3 x 3 and max pooling 4 x 4 of label images.

    Args:
        out_channels: number of filters.
    """

    _colours: torch.Tensor
    _code_colours: torch.Tensor
    _centres: torch.Tensor
    _within: torch.Tensor
    _taps: torch.Tensor
    _coordinates: torch.Tensor
    _kernel_index: torch.Tensor
    _windows: torch.Tensor

    def __init__(self, out_channels: int) -> None:
        super().__init__()
        # Holds and initialises the parameters (colours, row, column).
        self.convolution = nn.Conv2d(5, out_channels, 3)
        self.out_channels = out_channels
        constants = {
            "colours": torch.from_numpy(label_colours()),
            "code_colours": torch.from_numpy(code_colours()),
            "centres": torch.from_numpy(cell_centres()),
            "within": torch.from_numpy(cell_offsets()),
            "taps": torch.from_numpy(kernel_offsets()),
            "kernel_index": _kernel_index(out_channels),
            "windows": torch.from_numpy(cell_windows()[1]),
        }
        axis = torch.linspace(-1.0 - _SPACING, 1.0 + _SPACING, IMAGE_SIZE + 2)
        constants["coordinates"] = torch.stack(torch.meshgrid(axis, axis, indexing="ij"))[None]
        for name, constant in constants.items():
            self.register_buffer(f"_{name}", constant, persistent=False)

    def forward(self, labels: torch.Tensor) -> torch.Tensor:
        """Labels [B, 64, 64] uint8 to pooled maps [B, out, 16, 16], channels last in memory."""
        if labels.device.type != "cpu":
            return self.plain(labels)
        if len(labels) > _CHUNK:
            return torch.cat([self(chunk) for chunk in labels.split(_CHUNK)])
        padded = functional.pad(labels, (1, 1, 1, 1), value=int(Label.EDGE))
        codes = padded[:, :, :-2] * NUM_LABELS**2 + padded[:, :, 1:-1] * NUM_LABELS + padded[:, :, 2:]  # [B, 66, 64]
        lowest, highest = _cell_range(padded)
        cell_labels = torch.where(lowest == highest, lowest, _MIXED)

        kernel, offsets, uniform, plane = self.parts()
        pooled = _PooledColourConvolution.apply(
            kernel, offsets, uniform, cell_labels, codes, self._code_colours, self._kernel_index, self._windows
        )
        maps = pooled.view(-1, CELLS * CELLS, self.out_channels) + plane
        return maps.view(-1, CELLS, CELLS, self.out_channels).permute(0, 3, 1, 2)

    def plain(self, labels: torch.Tensor) -> torch.Tensor:
        """:meth:`forward` step by step, as on a GPU."""
        padded = functional.pad(labels, (1, 1, 1, 1), value=int(Label.EDGE))
        colours = functional.embedding(padded.int(), self._colours)  # [B, 66, 66, 3]
        coordinates = self._coordinates.to(colours.dtype).expand(len(labels), -1, -1, -1)
        image = torch.cat([colours.permute(0, 3, 1, 2), coordinates], dim=1)
        pooled = functional.max_pool2d(self.convolution(image), POOLING)
        return pooled.contiguous(memory_format=torch.channels_last)

    def parts(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Constants that depend on the weights.

        Returns:
            The kernel of the colours [out, 3, 3, 3]; the contribution of the coordinates to the 16 pixels of a cell
            [16, out]; the pooled values of a cell with a single label [6, out]; the contribution of the coordinates to
            every cell [256, out].
        """
        kernel, coordinate_kernel = self.convolution.weight.split((3, 2), dim=1)
        slope = coordinate_kernel.sum(dim=(2, 3)).T  # [2, out]
        plane = self._centres @ slope + (coordinate_kernel * self._taps).sum(dim=(1, 2, 3))  # [256, out]
        if self.convolution.bias is not None:
            plane = plane + self.convolution.bias
        offsets = self._within @ slope  # [16, out]
        uniform = self._colours @ kernel.sum(dim=(2, 3)).T + offsets.amax(dim=0)  # [6, out]
        return kernel, offsets, uniform, plane


class _PooledColourConvolution(torch.autograd.Function):
    """Convolution of the colours, an offset for each pixel of a cell, and max pooling; gradient of the weights."""

    @staticmethod
    def forward(
        ctx: Any,
        kernel: torch.Tensor,
        offsets: torch.Tensor,
        uniform: torch.Tensor,
        cell_labels: torch.Tensor,
        codes: torch.Tensor,
        code_colours: torch.Tensor,
        kernel_index: torch.Tensor,
        windows: torch.Tensor,
    ) -> torch.Tensor:
        """Pooled values.

        Args:
            kernel: [out, 3, 3, 3] filter, colour, row, column.
            offsets: [16, out].
            uniform: [6, out] pooled values of a cell with a single label.
            cell_labels: [B, 16, 16] uint8, 6 for several labels.
            codes: [B, 66, 64] uint8 of three neighbouring pixels.
            code_colours: [216, 9] the colours of a code.
            kernel_index: see :func:`_kernel_index`.
            windows: [12] positions of the codes of a cell, relative to its first.

        Returns:
            [256 B, out].
        """
        out = len(kernel)
        image, row, column = (cell_labels == _MIXED).nonzero(as_tuple=True)  # [n] each: the cells to be convolved
        corners = (image * (IMAGE_SIZE + 2) + row * POOLING) * IMAGE_SIZE + column * POOLING  # their first code
        table = _table(kernel, offsets, code_colours, kernel_index)
        rows = codes.flatten().index_select(0, (corners[:, None] + windows).flatten()).view(-1, _PLACES) + (
            torch.arange(0, _PLACES * NUM_CODES, NUM_CODES, dtype=torch.int32, device=codes.device)
        )
        values = functional.embedding_bag(rows, table.flatten(0, 1), mode="sum")
        cells = values.view(-1, POOLING, POOLING, out).permute(0, 3, 1, 2)
        pooled, positions = functional.max_pool2d_with_indices(cells, [POOLING, POOLING])

        cell_labels = cell_labels.flatten().int()
        result = functional.embedding(cell_labels, functional.pad(uniform, (0, 0, 0, 1)))
        mixed = (image * CELLS + row) * CELLS + column
        result.index_copy_(0, mixed, pooled.view(-1, out))
        ctx.save_for_backward(cell_labels, codes, corners, mixed, positions.view(-1, out), code_colours)
        return result

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        (gradient,) = gradients
        cell_labels, codes, corners, mixed, positions, code_colours = ctx.saved_tensors
        out = gradient.shape[1]
        one_hot = cell_labels[:, None] == torch.arange(NUM_LABELS, device=gradient.device)
        uniform = one_hot.to(gradient.dtype).T @ gradient
        gradient = gradient.index_select(0, mixed).flatten()

        filters = torch.arange(out, device=gradient.device)
        offsets = gradient.new_zeros(_POSITIONS * out)
        offsets.scatter_add_(0, (positions * out + filters).flatten(), gradient)
        # First code of the patch of each pooled value; the other two are one and two lines below.
        patches = (corners[:, None] + (positions >> 2) * IMAGE_SIZE + (positions & 3)).flatten()
        histogram = gradient.new_zeros(3, out * NUM_CODES)
        for row in range(3):
            code = codes.flatten().index_select(0, patches + row * IMAGE_SIZE).view(-1, out)
            histogram[row].scatter_add_(0, (filters * NUM_CODES + code).flatten(), gradient)
        kernel = histogram.view(3, out, NUM_CODES) @ code_colours  # [row, filter, (column, colour)]
        kernel = kernel.view(3, out, 3, 3).permute(1, 3, 0, 2)
        return kernel, offsets.view(_POSITIONS, out), uniform, None, None, None, None, None


def _table(
    kernel: torch.Tensor, offsets: torch.Tensor, code_colours: torch.Tensor, kernel_index: torch.Tensor
) -> torch.Tensor:
    """[12, 216, 16 out] contribution of a code at each of the twelve places to the values to be pooled."""
    shares = functional.pad(kernel.flatten(), (0, 1))[kernel_index]  # [12, 9, 16 out]
    table = code_colours @ shares
    table[0] += offsets.flatten()  # every cell has one code at the first place
    return table


def _cell_range(padded: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Least and greatest label [B, 16, 16] of each cell and its border, from the padded image [B, 66, 66]."""
    lowest = highest = padded
    for axis in (1, 2):  # rows first, since they are contiguous in memory
        lines = [slice(start, start + IMAGE_SIZE - POOLING + 1, POOLING) for start in range(PATCH)]
        index = [(slice(None), line) if axis == 1 else (slice(None), slice(None), line) for line in lines]
        low, high = lowest[index[0]], highest[index[0]]
        for entry in index[1:]:
            low, high = torch.minimum(low, lowest[entry]), torch.maximum(high, highest[entry])
        lowest, highest = low, high
    return lowest, highest


def _kernel_index(out: int) -> torch.Tensor:
    """[12, 9, 16 out] the entry of the flat kernel [out, 3, 3, 3] for a colour of a pixel (its length for none).

    The axes: place of the code, (pixel of the code, colour), (position within the cell, filter).
    """
    row = torch.arange(PATCH).view(-1, 1, 1, 1, 1, 1, 1)
    column = torch.arange(PATCH).view(1, 2, 3, 1, 1, 1, 1)
    colour = torch.arange(3).view(1, 1, 1, 3, 1, 1, 1)
    kernel_row = row - torch.arange(POOLING).view(1, 1, 1, 1, -1, 1, 1)
    kernel_column = column - torch.arange(POOLING).view(1, 1, 1, 1, 1, -1, 1)
    filters = torch.arange(out)
    reached = (kernel_row >= 0) & (kernel_row < 3) & (kernel_column >= 0) & (kernel_column < 3)
    index = torch.where(reached, ((filters * 3 + colour) * 3 + kernel_row) * 3 + kernel_column, out * 27)
    return index.reshape(_PLACES, 9, _POSITIONS * out)
