"""What is behind the arm or another object."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from tests.embodiment.seen_bodies import top_camera
from visualrhp.embodiment.occlusion import GROWTH, HiddenRegion, all_hidden, hidden_around

CAMERA = top_camera(position=(0.0, 0.0, 1.4), focal_length=1000.0)


def block(top: int, left: int, size: int = 40) -> np.ndarray:
    mask = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    mask[top : top + size, left : left + size] = True
    return mask


NOTHING = block(0, 0, 0)


def test_pixels_that_are_hidden() -> None:
    region = HiddenRegion(CAMERA, block(100, 200)[90:200, 190:300], (190, 90))
    inside = np.array([[210.0, 110.0], [239.0, 139.0], [250.0, 110.0], [0.0, 200.0], [300.0, 479.0]])
    assert region.contains(inside).tolist() == [True, True, False, True, True]  # the last two leave the image


def test_the_region_at_a_height_by_hand() -> None:
    region = HiddenRegion(CAMERA, block(240, 320))
    # 39 px between the centres of the outer pixels: 1.4 mm each on the table, and half as much at half the height.
    assert region.at(0.0).area == pytest.approx((39 * 1.4e-3) ** 2, rel=1e-3)
    assert region.at(0.7).area == pytest.approx((39 * 0.7e-3) ** 2, rel=1e-3)
    both = region.at(0.0, 0.7)
    assert both.area == pytest.approx(shapely.union(region.at(0.0), region.at(0.7)).area)
    assert HiddenRegion(CAMERA, NOTHING).at(0.0).is_empty


def test_all_is_the_union_of_arm_and_objects() -> None:
    region = all_hidden(CAMERA, block(10, 10), [block(100, 100), block(200, 200)])
    middles = np.array([[30.0, 30.0], [120.0, 120.0], [220.0, 220.0], [120.0, 220.0]])
    assert region.contains(middles).tolist() == [True, True, True, False]
    assert region.contains(np.array([[100.0 - GROWTH, 120.0], [99.0 - GROWTH, 120.0]])).tolist() == [True, False]


def test_around_an_object_its_own_mask_is_left_out() -> None:
    masks = [block(100, 100), block(100, 140), block(400, 400)]
    region = hidden_around(CAMERA, block(60, 100), masks, 0)
    points = np.array([[120.0, 120.0], [150.0, 120.0], [120.0, 90.0], [420.0, 420.0]])
    # Beside it and behind the arm; the third object is too far to matter.
    assert region.contains(points).tolist() == [False, True, True, False]
    assert not hidden_around(CAMERA, NOTHING, [NOTHING], 0).mask.size
