"""The outline of the gripper by hand, and in the world."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.errors import SceneError
from visualrhp.scene import Gripper, geometry
from visualrhp.scene.gripper import MAX_STROKE
from visualrhp.scene.polygons import polygon_fault

GRIPPER = Gripper()
OTHER = Gripper(0.06, 0.03, 0.07, 0.01, 0.05, 0.09, 0.04)


@pytest.mark.parametrize("name", Gripper.__slots__)
def test_every_length_must_be_positive_and_finite(name: str) -> None:
    for value in (0.0, -0.01, np.nan, np.inf):
        with pytest.raises(SceneError, match=f"the gripper's {name} is {value}; it must be positive"):
            Gripper(**{name: value})


def test_the_stroke_has_a_limit() -> None:
    assert Gripper(stroke=MAX_STROKE).stroke == 0.1
    with pytest.raises(SceneError, match=r"stroke is 0.1001 m; it can be at most 0.1 m"):
        Gripper(stroke=0.1001)


def test_the_palm_by_hand() -> None:
    """Fingers from -4 cm to 3 cm; behind them a palm of 5 cm, 9 cm wide in front and 4 cm behind."""
    assert OTHER.palm == pytest.approx(np.array([[-0.09, -0.02], [-0.04, -0.045], [-0.04, 0.045], [-0.09, 0.02]]))


def test_the_fingers_by_hand() -> None:
    assert OTHER.finger(1) == pytest.approx(np.array([[-0.04, 0.0], [0.03, 0.0], [0.03, 0.01], [-0.04, 0.01]]))
    assert OTHER.finger(-1) == pytest.approx(np.array([[-0.04, -0.01], [0.03, -0.01], [0.03, 0.0], [-0.04, 0.0]]))


@pytest.mark.parametrize("gripper", [GRIPPER, OTHER])
def test_all_parts_are_convex_bodies(gripper: Gripper) -> None:
    for outline in (gripper.palm, gripper.finger(1), gripper.finger(-1)):
        assert polygon_fault(outline, solid=True) is None
        assert geometry.is_convex(outline)
    area = (gripper.palm_front_width + gripper.palm_back_width) / 2.0 * gripper.palm_length
    assert geometry.signed_area(gripper.palm) == pytest.approx(area)
    area = gripper.finger_length * gripper.finger_thickness
    assert geometry.signed_area(gripper.finger(1)) == pytest.approx(area)


@pytest.mark.parametrize("opening", [0.0, 0.03, 0.085])
def test_the_inner_faces_are_an_opening_apart(opening: float) -> None:
    pose = (0.3, -0.2, 2.2)
    _, left, right = (geometry.to_body(outline, pose) for outline in GRIPPER.outlines(pose, opening))
    assert left[:, 1].min() - right[:, 1].max() == pytest.approx(opening, abs=1e-15)
    assert left[:, 1].min() == pytest.approx(-right[:, 1].max(), abs=1e-15)


def test_left_and_right_are_mirror_images() -> None:
    palm, left, right = GRIPPER.outlines((0.0, 0.0, 0.0), 0.05)
    for outline, image in ((palm, palm), (left, right)):
        mirrored = sorted((outline * (1.0, -1.0)).tolist())
        assert np.array(mirrored) == pytest.approx(np.array(sorted(image.tolist())))


def test_a_gripper_that_heads_up_has_its_left_finger_on_the_left() -> None:
    """At (1, 2), heading along y: the fingertips are 2 cm above, the left finger at smaller x."""
    palm, left, right = GRIPPER.outlines((1.0, 2.0, np.pi / 2), 0.04)
    assert left[:, 1].max() == pytest.approx(2.02) and right[:, 1].max() == pytest.approx(2.02)
    assert (left[:, 0].min(), left[:, 0].max()) == pytest.approx((0.968, 0.98))
    assert (right[:, 0].min(), right[:, 0].max()) == pytest.approx((1.02, 1.032))
    assert palm[:, 1].max() == pytest.approx(1.97) and palm[:, 1].min() == pytest.approx(1.91)


@pytest.mark.parametrize("gripper", [GRIPPER, OTHER])
def test_the_fingers_slide_on_the_front_of_the_palm(gripper: Gripper) -> None:
    """They begin where the palm ends: the parts touch without overlapping."""
    assert gripper.palm[:, 0].max() == pytest.approx(gripper.finger(1)[:, 0].min())
