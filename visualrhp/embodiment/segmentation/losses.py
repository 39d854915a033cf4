"""Targets and losses of the segmentation network (torch)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch.nn import functional

from visualrhp.embodiment.segmentation.classes import FIRST_OBJECT_CLASS, NUM_CLASSES
from visualrhp.embodiment.segmentation.frames import FIRST_INSTANCE, MAX_OBJECTS, LabelledFrames
from visualrhp.embodiment.segmentation.network import CELL, OFFSET_UNIT, SegmentationOutput
from visualrhp.types import FloatArray

CENTRE_SPREAD: Final = 2.0
"""Standard deviation of the target around a centre [cells]: 1.9 cm where a cell is 4 x 4 pixels of 640 x 480."""

LEAST_CELLS: Final = 3.0
"""Visible area below which an object has no centre [cells]: it is hidden."""

_KIND_WEIGHT: Final = 0.5
_CENTRE_WEIGHT: Final = 0.5
_OFFSET_WEIGHT: Final = 0.5
_EDGE_WEIGHT: Final = 4.0
"""Further weight of cells that hold more than one label: outlines."""


@dataclass(frozen=True)
class Targets:
    """What the network should answer to a batch of B frames with G x G cells.

    Attributes:
        coverage: [B, C, G, G] share of each class in a cell.
        weight: [B, G, G] of the cells, in the loss of classes.
        centres: [B, G, G] 1 at centres, less around them.
        offsets: [B, 2, G, G] to the centre, (x, y) in units of :data:`OFFSET_UNIT` cells.
        is_object: [B, G, G] bool; whether the offset of a cell counts.
    """

    coverage: torch.Tensor
    weight: torch.Tensor
    centres: torch.Tensor
    offsets: torch.Tensor
    is_object: torch.Tensor


def targets_of(frames: LabelledFrames) -> Targets:
    """The targets for ``frames``."""
    count, side = len(frames), frames.instances.shape[1] // CELL
    labels = _by_cell(frames.labels(), side)
    instances = _by_cell(frames.instances, side)
    coverage = np.stack([(labels == index).sum(axis=-1, dtype=np.float32) for index in range(NUM_CLASSES)], axis=1)
    coverage /= CELL * CELL
    mixed = (instances != instances[..., :1]).any(axis=-1)
    centres = np.zeros((count, side, side), np.float32)
    offsets = np.zeros((count, 2, side, side), np.float32)
    is_object = np.zeros((count, side, side), bool)
    v, u = np.mgrid[:side, :side].astype(np.float32)
    for frame in range(count):
        centre_of = visible_centres(instances[frame])
        for number, (x, y) in centre_of.items():
            squared = (u - x) ** 2 + (v - y) ** 2
            np.maximum(centres[frame], np.exp(-squared / (2.0 * CENTRE_SPREAD**2)), out=centres[frame])
            mine = (instances[frame] == FIRST_INSTANCE + number).mean(axis=-1) >= 0.5
            is_object[frame] |= mine
            offsets[frame, 0][mine] = (x - u[mine]) / OFFSET_UNIT
            offsets[frame, 1][mine] = (y - v[mine]) / OFFSET_UNIT
        for x, y in centre_of.values():  # the cell of a centre is a peak, wherever in the cell the centre is
            centres[frame, round(y), round(x)] = 1.0
    return Targets(
        torch.from_numpy(coverage),
        torch.from_numpy(1.0 + _EDGE_WEIGHT * mixed.astype(np.float32)),
        torch.from_numpy(centres),
        torch.from_numpy(offsets),
        torch.from_numpy(is_object),
    )


def visible_centres(instances: np.ndarray) -> dict[int, tuple[float, float]]:
    """Centre (x, y) of the visible part of each object of a frame [cells], by its number.

    Args:
        instances: [G, G, 4] labels of the pixels of each cell.
    """
    side = instances.shape[0]
    v, u = np.mgrid[:side, :side]
    size = FIRST_INSTANCE + MAX_OBJECTS
    flat = instances.reshape(-1).astype(np.int64)
    per_cell = instances.shape[-1]

    def sums(values: FloatArray | None) -> FloatArray:
        weights = None if values is None else np.repeat(values.reshape(-1), per_cell)
        return np.bincount(flat, weights, minlength=size)[FIRST_INSTANCE:].astype(np.float64)

    area, x, y = sums(None), sums(u.astype(np.float64)), sums(v.astype(np.float64))
    numbers = np.flatnonzero(area >= LEAST_CELLS * per_cell)
    return {int(number): (float(x[number] / area[number]), float(y[number] / area[number])) for number in numbers}


def segmentation_loss(output: SegmentationOutput, targets: Targets) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """The loss, and its terms.

    Cross entropy of surfaces with their coverages, and of kinds where there are objects; the focal loss of CenterNet
    (Zhou et al., 2019) for the map of centres; the absolute error of offsets.
    """
    covered = targets.coverage[:, FIRST_OBJECT_CLASS:]
    surfaces = torch.cat([targets.coverage[:, :FIRST_OBJECT_CLASS], covered.sum(dim=1, keepdim=True)], dim=1)
    entropy = -(surfaces * functional.log_softmax(output.surfaces, dim=1)).sum(dim=1)
    surface_loss = (targets.weight * entropy).sum() / targets.weight.sum()
    kinds = functional.avg_pool2d(covered, 2)
    kind_loss = -(kinds * functional.log_softmax(output.kinds, dim=1)).sum() / kinds.sum().clamp(min=1.0)
    log_centre, log_other = functional.logsigmoid(output.centres), functional.logsigmoid(-output.centres)
    probability = log_centre.exp()
    is_centre = targets.centres == 1.0
    positive = ((1.0 - probability) ** 2 * log_centre)[is_centre].sum()
    negative = ((1.0 - targets.centres) ** 4 * probability**2 * log_other)[~is_centre].sum()
    centre_loss = -(positive + negative) / is_centre.sum().clamp(min=1)
    errors = (output.offsets - targets.offsets).abs().sum(dim=1)
    offset_loss = (errors * targets.is_object).sum() / targets.is_object.sum().clamp(min=1)
    loss = surface_loss + _KIND_WEIGHT * kind_loss + _CENTRE_WEIGHT * centre_loss + _OFFSET_WEIGHT * offset_loss
    terms = {"surfaces": surface_loss, "kinds": kind_loss, "centres": centre_loss, "offsets": offset_loss}
    return loss, {name: term.detach() for name, term in terms.items()}


def class_agreement(output: SegmentationOutput, targets: Targets) -> torch.Tensor:
    """Intersection over union of the objects' cells of one class, all classes and frames together."""
    found, right = output.probabilities().argmax(dim=1), targets.coverage.argmax(dim=1)
    objects_found, objects_right = found >= FIRST_OBJECT_CLASS, right >= FIRST_OBJECT_CLASS
    both = (objects_found & (found == right)).sum()
    return both / (objects_found | objects_right).sum().clamp(min=1)


def _by_cell(pixels: np.ndarray, side: int) -> np.ndarray:
    """[N, S, S] -> [N, G, G, CELL * CELL]: the pixels of each cell."""
    parts = pixels.reshape(len(pixels), side, CELL, side, CELL).transpose(0, 1, 3, 2, 4)
    return parts.reshape(len(pixels), side, side, CELL * CELL)
