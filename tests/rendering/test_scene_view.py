"""Bodies are drawn in their colours, where they are."""

import numpy as np
import pytest

from tests.rendering.samples import SCENE, STATE, pixel
from visualrhp.observation.label_image import PALETTE, label_image
from visualrhp.rendering.drawing import BACKGROUND, DESIRED, GRIPPER, MARGIN, OBSTACLE, SURFACE
from visualrhp.rendering.frames import render_frame
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.types import State


@pytest.mark.parametrize("size_px", [120, 333, 480])
def test_everything_is_drawn_in_its_colour_where_it_is(size_px):
    frame = render_frame(SCENE, STATE, size_px=size_px)
    side = size_px + size_px % 2
    assert frame.shape == (side, side, 3)
    assert frame.dtype == np.uint8

    def colour(x, y):
        return tuple(int(channel) for channel in frame[pixel((x, y), side)])

    assert colour(-0.1 + 0.015, 0.15) == DESIRED
    assert colour(0.15, -0.1) == OBSTACLE
    assert colour(-0.33, 0.33) == BACKGROUND
    assert colour(-0.12, 0.03) == SURFACE  # between the lines of the grid
    red, green, blue = colour(0.16, 0.15)  # the target region lets the surface shine through
    assert green > red and green > blue
    red, green, blue = colour(-0.19, -0.13)  # the gripper's palm
    assert blue > green > red


def test_an_object_moves_with_its_pose_with_y_up():
    moved = State.create([-0.15, -0.15, 0.0], 0.085, False, [[-0.1, 0.05, 0.3], [0.15, -0.1, 0.0]])
    frame, other = render_frame(SCENE, STATE, size_px=240), render_frame(SCENE, moved, size_px=240)
    rows, columns = np.nonzero((frame == DESIRED).all(axis=2))
    moved_rows, moved_columns = np.nonzero((other == DESIRED).all(axis=2))
    pixels_per_metre = 240 / (0.5 + 2 * MARGIN)
    assert moved_rows.mean() - rows.mean() == pytest.approx(0.1 * pixels_per_metre, abs=0.5)
    assert moved_columns.mean() == pytest.approx(columns.mean(), abs=0.5)


def test_the_trail_marks_where_gripper_and_desired_object_have_been():
    past = State.create([0.0, -0.2, 0.0], 0.085, False, [[-0.2, 0.0, 0.0], [0.15, -0.1, 0.0]])
    changed = (render_frame(SCENE, STATE, size_px=240, trail=[past]) != render_frame(SCENE, STATE, size_px=240)).any(
        axis=2
    )
    for point in ((-0.2, 0.0), (0.0, -0.2), (-0.15, 0.075)):  # both starts, and half of the object's way
        row, column = pixel(point, 240)
        assert changed[row - 2 : row + 3, column - 2 : column + 3].any()
    row, column = pixel((0.15, -0.1), 240)
    assert not changed[row - 2 : row + 3, column - 2 : column + 3].any()


def test_an_outline_need_not_be_convex():
    corner = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, -0.02], [-0.02, -0.02], [-0.02, 0.05], [-0.05, 0.05]])
    shape = ObjectShape.centred(corner)
    shift = shape.outline[0] - corner[0]
    state = State.create([-0.15, -0.15, 0.0], 0.085, False, [[0.0, 0.0, 0.0]])
    frame = render_frame(Scene(TargetRegion(np.array([0.15, 0.15])), (shape,)), state, size_px=480)
    for inside in ((0.03, -0.035), (-0.035, 0.03)):
        assert tuple(frame[pixel(inside + shift, 480)]) == DESIRED
    assert tuple(frame[pixel(np.array([0.03, 0.03]) + shift, 480)]) == SURFACE


def test_the_inset_shows_the_label_image_in_the_emptiest_corner():
    frame = render_frame(SCENE, STATE, size_px=480, show_inset=True)
    observed = PALETTE[label_image(SCENE, STATE)].repeat(2, axis=0).repeat(2, axis=1)
    plain = render_frame(SCENE, STATE, size_px=480)
    rows, columns = np.nonzero((frame != plain).any(axis=2))
    top, left = rows.min(), columns.min()
    border = 2
    assert left < 240 and top < 240  # the target is on the right above, the gripper on the left below
    np.testing.assert_array_equal(
        frame[top + border : top + border + 128, left + border : left + border + 128], observed
    )

    crowded = State.create([-0.25, 0.25, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])
    frame, plain = (render_frame(SCENE, crowded, size_px=480, show_inset=show) for show in (True, False))
    rows, columns = np.nonzero((frame != plain).any(axis=2))
    assert rows.min() > 240 and columns.min() > 240


def test_an_arrow_points_to_a_gripper_that_left_the_picture():
    away = State.create([0.7, 0.1, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])
    frame = render_frame(SCENE, away, size_px=240)
    rows, columns = np.nonzero((frame == GRIPPER).all(axis=2))
    assert columns.min() > 220
    assert rows.mean() == pytest.approx(pixel((0.0, 0.1), 240)[0], abs=2)
