"""Where an object can be that the camera does not see."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from tests.embodiment.seen_bodies import top_camera
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.occlusion import HiddenRegion
from visualrhp.embodiment.registration import Reference
from visualrhp.embodiment.robot_model import CELL_GRIPPER
from visualrhp.embodiment.track import (
    ON_EDGE,
    PUSHED,
    GripperView,
    Track,
    hidden_share,
    hiding_place,
    is_between_fingers,
    on_surface,
)
from visualrhp.scene.scene import square_edges
from visualrhp.types import FloatArray

CAMERA = top_camera(focal_length=1000.0)
SURFACE = shapely.Polygon(square_edges(0.5))


def disc(x: float, y: float) -> Track:
    outline = shapely.segmentize(shapely.Point(x, y).buffer(0.035), 2e-3)
    reference, pose = Reference.located(outline)
    return Track(0, reference, pose, (0.035, 0.035), {Kind.ORANGE: 1.0})


def hidden_box(low: FloatArray, high: FloatArray) -> HiddenRegion:
    """What is behind a box at the height of a disc's widest section."""
    mask = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    corners = CAMERA.project(np.array([[*low, 0.035], [*high, 0.035]]))
    (left, top), (right, bottom) = corners.min(axis=0).astype(int), corners.max(axis=0).astype(int)
    mask[max(top, 0) : bottom, max(left, 0) : right] = True
    return HiddenRegion(CAMERA, mask)


def test_the_share_that_is_hidden() -> None:
    arm = hidden_box(np.array([0.0, -0.1]), np.array([0.1, 0.1]))
    track = disc(0.0, 0.0)
    assert hidden_share(track, track.pose, arm) == pytest.approx(0.5, abs=0.03)
    assert hidden_share(track, np.array([0.05, 0.0, 0.0]), arm) == pytest.approx(1.0, abs=1e-6)
    assert hidden_share(track, np.array([-0.05, 0.0, 0.0]), arm) == 0.0


def test_what_is_missed_beside_the_arm_was_pushed_below_it() -> None:
    arm = hidden_box(np.array([0.0, -0.1]), np.array([0.1, 0.1]))
    track = disc(-0.04, 0.0)
    place = hiding_place(track, track.pose, arm, SURFACE)
    assert place is not None and hidden_share(track, place, arm) > 0.6
    assert np.hypot(*(place[:2] - track.pose[:2])) < 0.06  # the closest one
    far = disc(-0.05 - PUSHED, 0.0)
    assert hiding_place(far, far.pose, arm, SURFACE) is None


def test_a_place_beyond_the_edge_is_moved_onto_the_surface() -> None:
    assert on_surface(SURFACE, np.array([0.1, -0.2, 0.3])).tolist() == [0.1, -0.2, 0.3]
    assert on_surface(SURFACE, np.array([0.3, 0.1, 0.3])) == pytest.approx([0.25 - ON_EDGE, 0.1, 0.3])


def test_what_is_between_closed_fingers_is_held() -> None:
    track = disc(0.0, 0.0)
    assert is_between_fingers(track, GripperView(np.array([0.0, 0.0, 0.5]), 0.07, True), CELL_GRIPPER)
    assert not is_between_fingers(track, GripperView(np.array([0.0, 0.0, 0.5]), 0.07, False), CELL_GRIPPER)
    assert not is_between_fingers(track, GripperView(np.array([0.2, 0.0, 0.5]), 0.07, True), CELL_GRIPPER)
