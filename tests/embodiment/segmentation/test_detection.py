"""Lying and standing bottles have different silhouettes."""

from __future__ import annotations

import numpy as np
import pytest

from tests.embodiment.seen_bodies import box, cup, detection, fruit, lying_bottle, standing_bottle, top_camera
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation import Detection
from visualrhp.embodiment.segmentation.detection import seems_lying

CAMERA = top_camera(position=(0.0, 0.0, 1.4), focal_length=1000.0)


def lies(body) -> bool:
    return seems_lying(body.kind, detection(CAMERA, body).mask)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.2, 0.0), (-0.18, 0.18), (0.05, -0.2)])
def test_bottles_and_cups(x: float, y: float) -> None:
    assert not lies(standing_bottle().at(x, y))
    assert not lies(cup().at(x, y))
    for theta in (0.0, 0.8, 1.6, 2.4):
        assert lies(lying_bottle().at(x, y, theta))


def test_other_kinds_do_not_lie() -> None:
    assert not lies(box(0.2, 0.04)) and not lies(fruit())


def test_an_empty_mask_does_not_lie() -> None:
    assert not seems_lying(Kind.BOTTLE, np.zeros((10, 10), dtype=bool))


def test_the_point_below_the_camera_may_be_elsewhere() -> None:
    mask = np.zeros((100, 100), dtype=bool)
    mask[50:60, 20:36] = True  # a little long along the rows
    assert not seems_lying(Kind.BOTTLE, mask, (90.0, 55.0))
    assert seems_lying(Kind.BOTTLE, mask, (28.0, 95.0))


def test_a_detection_has_a_score() -> None:
    assert Detection(Kind.CUP, False, np.ones((2, 2), dtype=bool)).score == 1.0
