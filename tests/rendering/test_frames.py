import numpy as np
import pytest

from visualrhp.errors import ConfigError
from visualrhp.rendering import PALETTE, label_image
from visualrhp.rendering.drawing import BACKGROUND, DESIRED, MARGIN, OBSTACLE, SURFACE
from visualrhp.rendering.frames import (
    OUTCOME_COLOURS,
    Caption,
    episode_frames,
    interpolate,
    render_frame,
)
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.types import State

SQUARE = np.array([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]])
SCENE = Scene(TargetRegion(np.array([0.12, 0.12])), (ObjectShape(SQUARE), ObjectShape(SQUARE)))
STATE = State.create([-0.15, -0.15, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])


def pixel(position, size_px):
    """(row, column) of a position [m] in a frame without caption: a square view, MARGIN around the 0.5 m surface."""
    extent = 0.5 + 2 * MARGIN
    return round((extent / 2 - position[1]) / extent * size_px), round((position[0] + extent / 2) / extent * size_px)


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


def test_caption_and_observation_are_added_around_the_same_picture():
    plain = render_frame(SCENE, STATE, size_px=240)
    full = render_frame(
        SCENE, STATE, size_px=240, caption=Caption("VisualRHP 3x3", 7, 49, "success"), show_observation=True
    )
    bar = full.shape[0] - 240
    assert bar > 0 and full.shape[0] % 2 == 0 and full.shape[1] % 2 == 0
    np.testing.assert_array_equal(full[bar:, :240], plain)
    assert (full[:bar] == OUTCOME_COLOURS["success"]).all(axis=2).sum() > 100
    observed = PALETTE[label_image(SCENE, STATE)]
    panel = full[bar:, 240:]
    places = [
        (row, column)
        for row in range(panel.shape[0] - 64)
        for column in range(panel.shape[1] - 64)
        if (panel[row, column : column + 64] == observed[0]).all()
        and (panel[row : row + 64, column : column + 64] == observed).all()
    ]
    assert len(places) == 1  # 240 px leave room for one pixel a label


def test_a_long_title_stays_clear_of_the_outcome():
    def bar(title):
        frame = render_frame(SCENE, STATE, size_px=160, caption=Caption(title, 12, 49, "out of actions"))
        return frame[: frame.shape[0] - 160]

    long = bar("a planner with a name that no bar is wide enough for")
    outcome = (bar("x") == OUTCOME_COLOURS["out of actions"]).all(axis=2)
    np.testing.assert_array_equal(outcome, (long == OUTCOME_COLOURS["out of actions"]).all(axis=2))


def test_a_surface_need_not_be_a_square():
    triangle = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25]])
    scene = Scene(TargetRegion(np.array([-0.15, 0.0])), (ObjectShape(SQUARE),), triangle)
    state = State.create([-0.1, -0.15, 0.0], 0.085, False, [[0.0, -0.15, 0.0]])
    frame = render_frame(scene, state, size_px=240)
    assert tuple(frame[pixel((0.15, 0.15), 240)]) == BACKGROUND
    assert tuple(frame[pixel((-0.22, -0.15), 240)]) == SURFACE


def test_interpolation_is_linear_and_turns_the_short_way():
    start = State.create([0.0, 0.0, 3.0], 0.08, False, [[0.0, 0.0, -3.0]])
    end = State.create([0.1, -0.2, -3.0], 0.0, True, [[0.2, 0.0, -2.0]])
    middle = interpolate(start, end, 0.5)
    np.testing.assert_allclose(middle.robot_pose, [0.05, -0.1, np.pi], atol=1e-12)
    np.testing.assert_allclose(middle.object_poses, [[0.1, 0.0, -2.5]])
    assert middle.gripper_opening == pytest.approx(0.04)
    assert not middle.gripper_closed
    assert interpolate(start, end, 0.0) == start
    assert interpolate(start, end, 1.0) == end


def test_an_episode_becomes_a_picture_a_fraction_of_an_action_and_a_held_end():
    states = [STATE, interpolate(STATE, STATE, 1.0), STATE]
    frames = list(
        episode_frames(
            SCENE, states, title="Greedy", outcome="dropped", max_steps=49, size_px=96, frames_per_action=3, hold=4
        )
    )
    assert len(frames) == 1 + 2 * 3 + 4
    assert len({frame.shape for frame in frames}) == 1
    badges = [(frame == OUTCOME_COLOURS["dropped"]).all(axis=2).any() for frame in frames]
    assert badges == [False] * 6 + [True] * 5


def test_bad_sizes_are_refused():
    with pytest.raises(ConfigError, match="size_px=10"):
        render_frame(SCENE, STATE, size_px=10)
    with pytest.raises(ConfigError, match="frames_per_action=0"):
        next(episode_frames(SCENE, [STATE], frames_per_action=0))
