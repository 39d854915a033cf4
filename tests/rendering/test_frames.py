import numpy as np
import pytest

from visualrhp.errors import ConfigError
from visualrhp.rendering import PALETTE, label_image
from visualrhp.rendering.drawing import BACKGROUND, DESIRED, MARGIN, OBSTACLE, ROBOT, SURFACE
from visualrhp.rendering.frames import (
    OUTCOME_COLOURS,
    Caption,
    EpisodeRenderer,
    episode_frames,
    interpolate,
    render_frame,
)
from visualrhp.rendering.imagined import ImaginedPath
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


def test_an_outline_need_not_be_convex():
    corner = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, -0.02], [-0.02, -0.02], [-0.02, 0.05], [-0.05, 0.05]])
    shape = ObjectShape.centred(corner)
    shift = shape.outline[0] - corner[0]
    state = State.create([-0.15, -0.15, 0.0], 0.085, False, [[0.0, 0.0, 0.0]])
    frame = render_frame(Scene(TargetRegion(np.array([0.15, 0.15])), (shape,)), state, size_px=480)
    for inside in ((0.03, -0.035), (-0.035, 0.03)):
        assert tuple(frame[pixel(inside + shift, 480)]) == DESIRED
    assert tuple(frame[pixel(np.array([0.03, 0.03]) + shift, 480)]) == SURFACE


@pytest.mark.parametrize("size_px", [240, 480])
def test_a_larger_surface_is_drawn_whole_with_lines_as_bold(size_px):
    edges = np.array(
        [[-1.2, -0.4], [1.2, -0.4], [1.2, 0.4], [0.2, 0.4], [0.2, 0.0], [-0.2, 0.0], [-0.2, 0.4], [-1.2, 0.4]]
    )
    scene = Scene(TargetRegion(np.array([0.8, 0.2])), (ObjectShape(SQUARE),), edges)
    state = State.create([-0.8, 0.0, 0.0], 0.085, False, [[0.5, -0.2, 0.0]])
    frame = render_frame(scene, state, size_px=size_px)

    def place(x, y):
        extent = 2.4 + 2 * MARGIN
        return round((extent / 2 - y) / extent * size_px), round((x + extent / 2) / extent * size_px)

    assert tuple(frame[place(0.02, 0.2)]) == BACKGROUND  # the bay
    assert tuple(frame[place(-1.05, 0.25)]) == SURFACE
    row, column = place(0.65, 0.4)
    dark = (frame[row - 6 : row + 7, column].astype(int).sum(axis=1) < 300).sum()
    usual = render_frame(SCENE, STATE, size_px=size_px)
    row, column = pixel((0.05, 0.25), size_px)
    assert dark == pytest.approx((usual[row - 6 : row + 7, column].astype(int).sum(axis=1) < 300).sum(), abs=1)


@pytest.mark.parametrize("size_px", [64, 96, 120, 200, 321])
@pytest.mark.parametrize("outcome", [None, "success", "out of actions"])
def test_everything_at_once_fits_at_any_size(size_px, outcome):
    imagined = [ImaginedPath((STATE, STATE), -12.3, True), ImaginedPath((STATE,), -np.inf)]
    frame = render_frame(
        SCENE,
        STATE,
        size_px=size_px,
        trail=[STATE],
        imagined=imagined,
        caption=Caption("CraftedHeuristicRHP 8x4", 48, 49, outcome),
        show_observation=True,
        show_inset=True,
    )
    assert frame.shape[0] % 2 == 0 and frame.shape[1] % 2 == 0
    caption = frame[:20].astype(int).sum(axis=2)
    assert (caption[2:, :2] > 700).all() and (caption[2:, -2:] > 700).all(), "no word is cut off"


def test_the_words_of_a_small_caption_do_not_touch():
    """Outcome first, then the step, then what fits of the title: each apart from the next by columns of paper."""
    for size_px in (96, 128, 160, 240):
        frame = render_frame(SCENE, STATE, size_px=size_px, caption=Caption("Crafted", 48, 49, "out of actions"))
        bar = frame[2:20]
        badge = np.flatnonzero((bar == OUTCOME_COLOURS["out of actions"]).all(axis=2).any(axis=0))
        assert badge.max() < size_px - 4
        left = badge.min()
        assert left < 4 or (bar[:, left - 4 : left - 1].astype(int).sum(axis=2) > 700).all()


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


def test_the_label_image_is_that_of_the_state_at_rest_and_of_the_planners_model():
    wide = Scene(SCENE.target, (ObjectShape(1.5 * SQUARE), ObjectShape(SQUARE)))
    moved = State.create([-0.05, -0.15, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])
    renderer = EpisodeRenderer(
        SCENE, STATE, size_px=128, show_observation=True, frames_per_action=3, believed_scene=wide
    )

    def observed(frame):
        (top,) = {frame.shape[0] - 128}
        panel = frame[top:, 128:]
        return [
            (panel[row : row + 64, column : column + 64] == expected).all()
            for expected in (PALETTE[label_image(wide, STATE)], PALETTE[label_image(wide, moved)])
            for row, column in [np.argwhere((panel == PALETTE[1]).all(axis=2)).min(axis=0)]
        ]

    first = observed(renderer.still())
    frames = [observed(frame) for frame in renderer.move(moved)]
    assert first == [True, False]
    assert frames == [[True, False], [True, False], [False, True]]


def test_an_arrow_points_to_a_gripper_that_left_the_picture():
    away = State.create([0.7, 0.1, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])
    frame = render_frame(SCENE, away, size_px=240)
    rows, columns = np.nonzero((frame == ROBOT).all(axis=2))
    assert columns.min() > 220
    assert rows.mean() == pytest.approx(pixel((0.0, 0.1), 240)[0], abs=2)


def test_what_is_imagined_is_shown_before_each_action():
    """One picture of the start, then for each action 2 of the roll-outs and 3 of the motion, then 4 of the end."""
    moved = State.create([-0.05, -0.15, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])
    imagined = [[ImaginedPath((STATE, moved), -3.0, True)], []]
    frames = list(
        episode_frames(
            SCENE, [STATE, moved, moved], imagined=imagined, size_px=96, frames_per_action=3, imagined_frames=2, hold=4
        )
    )
    assert len(frames) == 1 + (2 + 3) + 3 + 4
    assert len({frame.shape for frame in frames}) == 1
    pictures = [frame[:96] for frame in frames]
    np.testing.assert_array_equal(pictures[1], render_frame(SCENE, STATE, size_px=96, imagined=imagined[0])[:96])
    np.testing.assert_array_equal(pictures[1], pictures[2])
    assert (pictures[0] == render_frame(SCENE, STATE, size_px=96)).all()
    assert (pictures[5] == render_frame(SCENE, moved, size_px=96, trail=[STATE])).all()
    assert (frames[3][96:] == frames[1][96:]).all(), "the legend stays"


def test_bad_sizes_are_refused():
    with pytest.raises(ConfigError, match="size_px=10"):
        render_frame(SCENE, STATE, size_px=10)
    with pytest.raises(ConfigError, match="frames_per_action=0"):
        next(episode_frames(SCENE, [STATE], frames_per_action=0))
