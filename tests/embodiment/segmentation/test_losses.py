"""Targets by hand, and losses of a network that is right."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn import functional

from tests.embodiment.segmentation.painter import painted_frames
from visualrhp.embodiment.segmentation.frames import MAX_OBJECTS, LabelledFrames
from visualrhp.embodiment.segmentation.losses import class_agreement, segmentation_loss, targets_of
from visualrhp.embodiment.segmentation.network import OFFSET_UNIT, SegmentationOutput


def frame(instances: np.ndarray, classes: list[int]) -> LabelledFrames:
    row = np.zeros((1, MAX_OBJECTS), np.uint8)
    row[0, : len(classes)] = classes
    side = len(instances)
    return LabelledFrames(np.zeros((1, side, side, 3), np.uint8), instances[None].astype(np.uint8), row)


def test_targets_by_hand() -> None:
    """A box of 8 x 6 pixels, 4 x 3 cells, whose centre lies between cells."""
    instances = np.zeros((24, 24))
    instances[4:10, 8:16] = 2
    instances[12:, 20:] = 1
    targets = targets_of(frame(instances, [8]))
    assert float(targets.coverage[0, 8].sum()) == 12 and float(targets.coverage[0, 1].sum()) == 12
    assert torch.equal(targets.coverage.sum(dim=1), torch.ones((1, 12, 12)))
    assert int(targets.is_object.sum()) == 12
    # Cells 4 to 7 in x and 2 to 4 in y: the centre is (5.5, 3).
    assert targets.offsets[0, :, 3, 4].tolist() == pytest.approx([1.5 / OFFSET_UNIT, 0.0])
    assert targets.offsets[0, :, 4, 7].tolist() == pytest.approx([-1.5 / OFFSET_UNIT, -1.0 / OFFSET_UNIT])
    assert (targets.centres == 1.0).nonzero().tolist() == [[0, 3, 6]]
    assert float(targets.centres[0, 3, 5]) == pytest.approx(np.exp(-0.25 / 8.0))
    assert float(targets.weight.max()) == 1.0  # every cell has one label


def test_a_cell_at_the_edge_is_covered_in_part_and_weighs_more() -> None:
    instances = np.zeros((24, 24))
    instances[4:10, 9:16] = 2
    targets = targets_of(frame(instances, [4]))
    assert targets.coverage[0, 4, 2:5, 4].tolist() == [0.5, 0.5, 0.5]
    assert (targets.weight[0, 2:5, 4] > 1.0).all() and float(targets.weight[0, 3, 5]) == 1.0


def test_what_is_hidden_has_no_centre() -> None:
    instances = np.zeros((24, 24))
    instances[4:6, 4:6] = 2
    targets = targets_of(frame(instances, [4]))
    assert float(targets.centres.max()) == 0.0 and not targets.is_object.any()
    loss, terms = segmentation_loss(SegmentationOutput(*blank(12)), targets)
    assert torch.isfinite(loss) and float(terms["offsets"]) == 0.0


def blank(side: int) -> tuple[torch.Tensor, ...]:
    kinds = torch.zeros((1, 7, side // 2, side // 2))
    return torch.zeros((1, 3, side, side)), kinds, torch.full((1, side, side), -4.0), torch.zeros((1, 2, side, side))


def test_the_right_answer_has_the_smallest_loss() -> None:
    targets = targets_of(painted_frames(0, 3))
    covered = targets.coverage[:, 2:]
    surfaces = torch.cat([targets.coverage[:, :2], covered.sum(dim=1, keepdim=True)], dim=1)
    right = SegmentationOutput(
        (surfaces + 1e-6).log(),
        (functional.avg_pool2d(covered, 2) + 1e-6).log(),
        torch.where(targets.centres == 1.0, 9.0, -9.0),
        targets.offsets,
    )
    loss, terms = segmentation_loss(right, targets)
    assert float(terms["offsets"]) == 0.0 and float(terms["centres"]) < 1e-3
    assert float(terms["kinds"]) < 0.1
    assert float(class_agreement(right, targets)) > 0.99  # painted objects do not touch, but come close
    generator = torch.Generator().manual_seed(0)
    for _ in range(10):
        wrong = SegmentationOutput(
            right.surfaces + torch.randn(right.surfaces.shape, generator=generator),
            right.kinds + torch.randn(right.kinds.shape, generator=generator),
            right.centres + torch.randn(right.centres.shape, generator=generator),
            right.offsets + 0.1 * torch.randn(right.offsets.shape, generator=generator),
        )
        assert float(segmentation_loss(wrong, targets)[0]) > float(loss)
        assert float(class_agreement(wrong, targets)) <= 1.0
