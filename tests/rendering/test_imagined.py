import math

import numpy as np
import pytest

from visualrhp.rendering.drawing import MARGIN, Canvas
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.imagined import (
    DIVERGED,
    DROPPED,
    ImaginedPath,
    draw_returns,
    legend_bar,
    value_colours,
    value_range,
)
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.types import State

SQUARE = np.array([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]])
SCENE = Scene(TargetRegion(np.array([0.15, 0.15])), (ObjectShape(SQUARE), ObjectShape(SQUARE)))


def state(robot, desired=(-0.1, 0.15, 0.0), obstacle=(0.15, -0.1, 0.0)):
    return State.create(robot, 0.085, False, [desired, obstacle])


START = state([-0.15, -0.15, 0.0])


def path(value, *robots, is_chosen=False):
    return ImaginedPath((START, *(state([*robot, 0.0]) for robot in robots)), value, is_chosen)


def pixel(position, size_px):
    """(row, column) of a position [m] in a frame without caption."""
    extent = 0.5 + 2 * MARGIN
    return (
        math.floor((extent / 2 - position[1]) / extent * size_px),
        math.floor((position[0] + extent / 2) / extent * size_px),
    )


def colour_at(frame, position):
    return tuple(int(channel) for channel in frame[pixel(position, frame.shape[1])])


def test_colours_rise_evenly_with_the_return():
    paths = [path(value) for value in (-30.0, -20.0, -25.0, -math.inf, -10.0)]
    colours = value_colours(paths)
    assert colours[3] == DIVERGED
    assert value_range(paths) == (-30.0, -10.0)
    brightness = [0.299 * red + 0.587 * green + 0.114 * blue for red, green, blue in colours]
    assert brightness[0] < brightness[2] < brightness[1] < brightness[4]
    assert value_colours([path(-7.0)]) == [colours[4]]  # the only one is the best one
    assert value_colours([path(-math.inf)]) == [DIVERGED]
    assert value_range([path(-math.inf)]) == (0.0, 0.0)


@pytest.mark.parametrize("size_px", [320, 480, 1080])
def test_a_path_has_the_colour_of_its_return_and_the_chosen_one_is_on_top(size_px):
    paths = [
        path(-5.0, (-0.05, -0.15), (0.05, -0.15), is_chosen=True),
        path(-9.0, (-0.05, -0.15), (-0.05, 0.05)),
        path(-30.0, (0.05, -0.15), (0.18, 0.0)),
    ]
    frame = render_frame(SCENE, START, size_px=size_px, imagined=paths)
    best, middle, worst = value_colours(paths)
    assert colour_at(frame, (0.0, -0.15)) == best  # three paths run here
    assert colour_at(frame, (-0.05, -0.07)) == middle
    assert colour_at(frame, (0.115, -0.075)) == worst
    plain = render_frame(SCENE, START, size_px=size_px)
    row, column = pixel((-0.2, 0.2), size_px)
    assert (frame[: row + 1, : column + 1] == plain[: row + 1, : column + 1]).all(), "nothing far from the paths"


def test_the_desired_object_leaves_a_dotted_path_and_its_outline_at_the_end():
    end = state([-0.15, -0.15, 0.0], desired=(0.0, 0.05, 0.0))
    frame = render_frame(SCENE, START, size_px=700, imagined=[ImaginedPath((START, end), -3.0, True)])
    (colour,) = value_colours([path(-3.0)])
    assert colour_at(frame, (0.0, 0.02)) == pytest.approx(colour, abs=12)  # lower side of the outline
    assert colour_at(frame, (0.03, 0.06)) == pytest.approx(colour, abs=12)
    along = [pixel((-0.1 + 0.1 * share, 0.15 - 0.1 * share), 700) for share in np.linspace(0.0, 1.0, 200)]
    on = np.array([(np.abs(frame[place].astype(int) - colour) < 12).all() for place in along])
    assert np.count_nonzero(np.diff(on.astype(int)) == 1) > 8, "dots with gaps between them"


def test_what_drops_or_diverges_is_crossed_out():
    dropping = ImaginedPath((START, state([0.1, 0.0, 0.0], obstacle=(0.3, -0.1, 0.0))), -51.0)
    diverging = path(-math.inf, (-0.05, 0.0))
    frame = render_frame(SCENE, START, size_px=480, imagined=[dropping, diverging])
    assert colour_at(frame, (0.3, -0.1)) == DROPPED
    assert colour_at(frame, (-0.05, 0.0)) == DIVERGED


def random_paths(rng, count, depth):
    paths = []
    for number in range(count):
        robots = np.cumsum(np.vstack([START.gripper_pose[:2], rng.uniform(-0.1, 0.1, (depth, 2))]), axis=0)[1:]
        paths.append(path(float(rng.uniform(-60.0, -1.0)), *robots, is_chosen=number == 0))
    return paths


@pytest.mark.parametrize("size_px", [320, 480, 1080])
@pytest.mark.parametrize("size", [3, 6])
def test_returns_are_written_whole_and_apart(size_px, size):
    rng = np.random.default_rng(0)
    canvas = Canvas(SCENE, size_px)
    picture = canvas.finished()
    written = 0
    for _ in range(20):
        paths = random_paths(rng, size, size)
        taken = [(size_px - 90, 5, size_px - 5, 90)]
        boxes = draw_returns(picture.copy(), canvas, paths, taken)
        written += len(boxes)
        ends = [canvas.frame_pixels(one.states[-1].gripper_pose[None, :2])[0] for one in paths]
        for index, (left, top, right, bottom) in enumerate(boxes):
            assert 0 < left < right < size_px and 0 < top < bottom < size_px
            for x, y in ends:
                assert not (left <= x <= right and top <= y <= bottom)
            for other in [*boxes[:index], *taken]:
                assert right < other[0] or other[2] < left or bottom < other[1] or other[3] < top
    assert written > 0.75 * 20 * size


def test_a_return_is_written_within_its_box_only():
    canvas = Canvas(SCENE, 480)
    before = canvas.finished()
    after = before.copy()
    one = path(-12.3, (0.0, 0.0), is_chosen=True)
    ((left, top, right, bottom),) = draw_returns(after, canvas, [one])
    changed = (after != before).any(axis=2)
    x, y = np.round(canvas.frame_pixels(np.zeros((1, 2)))[0]).astype(int)
    changed[min(top, y) - 2 : max(bottom, y) + 2, min(left, x) - 2 : max(right, x) + 2] = False  # box and leader
    assert not changed.any()
    assert tuple(after[top + 4, left + 4]) == value_colours([one])[0]


def test_equal_roll_outs_get_one_label_and_small_pictures_none():
    twice = [path(-4.0, (0.0, 0.0)), path(-4.0, (0.0, 0.0))]
    assert len(draw_returns(Canvas(SCENE, 480).finished(), Canvas(SCENE, 480), twice)) == 1
    assert draw_returns(Canvas(SCENE, 120).finished(), Canvas(SCENE, 120), twice) == []


@pytest.mark.parametrize(("height", "width"), [(24, 64), (24, 120), (28, 320), (40, 480), (92, 1080), (40, 800)])
def test_the_legend_fits_and_marks_the_chosen_return(height, width):
    paths = [path(-60.0), path(-10.0, is_chosen=True), path(-35.0), path(-math.inf)]
    bar = legend_bar(SCENE, paths, height, width)
    assert bar.shape == (height, width, 3)
    inked = (bar[height // 8 :].astype(int).sum(axis=2) < 700).any(axis=0)
    assert inked.any()
    assert not inked[:3].any() and not inked[-3:].any(), "nothing is cut off"
    best, worst = value_colours(paths)[1], value_colours(paths)[0]
    columns = [
        np.flatnonzero((np.abs(bar.astype(int) - colour) < 6).all(axis=2).any(axis=0)) for colour in (best, worst)
    ]
    assert columns[0].max() > columns[1].min()


@pytest.mark.parametrize(("height", "width"), [(24, 64), (24, 120), (40, 480)])
def test_the_legend_of_a_plan_has_its_length_and_return_and_no_scale(height, width):
    steps = [(-0.1, -0.1), (-0.05, -0.1), (0.0, -0.1)]

    def bar_of(num_actions, value):
        return legend_bar(SCENE, [path(value, *steps[:num_actions], is_chosen=True)], height, width, 1e-5)

    bar = bar_of(3, -23.4)[height // 8 :].astype(int)
    inked = (bar.sum(axis=2) < 700).any(axis=0)
    assert inked[width // 2 :].any() and not inked[:3].any() and not inked[-3:].any()
    assert np.ptp(bar, axis=2).max() < 40, "grey: there is no colour scale"
    assert (bar_of(3, -23.4) != bar_of(3, -11.0)).any(), "the return is written"
    assert (bar_of(3, -23.4) != bar_of(1, -23.4)).any(), "the number of actions is written"


def test_the_legend_of_nothing_is_empty_and_of_failures_only_has_no_scale():
    empty = legend_bar(SCENE, [], 40, 480)
    assert (empty[4:] == empty[-1, -1]).all()
    failed = legend_bar(SCENE, [path(-math.inf)], 40, 800)
    assert (failed[4:, 500:] == failed[-1, -1]).all()
    assert (failed[4:, :500] != failed[-1, -1]).any()
