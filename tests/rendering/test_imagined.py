import math

import numpy as np
import pytest

from visualrhp.rendering.drawing import MARGIN, Canvas
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.imagined import (
    DIVERGED,
    DROPPED,
    ImaginedPath,
    colour_at,
    colour_of,
    draw_returns,
    share_of,
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


def colour_in(frame, position):
    return tuple(int(channel) for channel in frame[pixel(position, frame.shape[1])])


def test_colours_rise_with_the_return_on_one_scale_from_the_rewards():
    """1 at the goal after one action (-1), 0 at a drop (-50), evenly in the logarithm between, and clipped."""
    shares = [share_of(value) for value in (-100.0, -50.0, -math.sqrt(50.0), -1.0, 0.0)]
    assert shares == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])
    colours = [colour_of(path(value)) for value in (-50.0, -20.0, -10.0, -5.0, -2.0, -1.0)]
    brightness = np.array([0.299 * red + 0.587 * green + 0.114 * blue for red, green, blue in colours])
    assert (np.diff(brightness) > 10.0).all()
    assert colours[0] == colour_at(0.0) and colours[-1] == colour_at(1.0)
    assert colour_of(path(-math.inf)) == DIVERGED


@pytest.mark.parametrize("size_px", [320, 480, 1080])
def test_a_path_has_the_colour_of_its_return_and_the_chosen_one_is_on_top(size_px):
    paths = [
        path(-5.0, (-0.05, -0.15), (0.05, -0.15), is_chosen=True),
        path(-9.0, (-0.05, -0.15), (-0.05, 0.05)),
        path(-30.0, (0.05, -0.15), (0.18, 0.0)),
    ]
    frame = render_frame(SCENE, START, size_px=size_px, imagined=paths)
    best, middle, worst = map(colour_of, paths)
    assert colour_in(frame, (0.0, -0.15)) == best  # three paths run here
    assert colour_in(frame, (-0.05, -0.07)) == middle
    assert colour_in(frame, (0.115, -0.075)) == worst
    plain = render_frame(SCENE, START, size_px=size_px)
    row, column = pixel((-0.2, 0.2), size_px)
    assert (frame[: row + 1, : column + 1] == plain[: row + 1, : column + 1]).all(), "nothing far from the paths"


def test_the_desired_object_leaves_a_dotted_path_and_its_outline_at_the_end():
    end = state([-0.15, -0.15, 0.0], desired=(0.0, 0.05, 0.0))
    frame = render_frame(SCENE, START, size_px=700, imagined=[ImaginedPath((START, end), -3.0, True)])
    colour = colour_of(path(-3.0))
    assert colour_in(frame, (0.0, 0.02)) == pytest.approx(colour, abs=12)  # lower side of the outline
    assert colour_in(frame, (0.03, 0.06)) == pytest.approx(colour, abs=12)
    along = [pixel((-0.1 + 0.1 * share, 0.15 - 0.1 * share), 700) for share in np.linspace(0.0, 1.0, 200)]
    on = np.array([(np.abs(frame[place].astype(int) - colour) < 12).all() for place in along])
    assert np.count_nonzero(np.diff(on.astype(int)) == 1) > 8, "dots with gaps between them"


def test_what_drops_or_diverges_is_crossed_out():
    dropping = ImaginedPath((START, state([0.1, 0.0, 0.0], obstacle=(0.3, -0.1, 0.0))), -51.0)
    diverging = path(-math.inf, (-0.05, 0.0))
    frame = render_frame(SCENE, START, size_px=480, imagined=[dropping, diverging])
    assert colour_in(frame, (0.3, -0.1)) == DROPPED
    assert colour_in(frame, (-0.05, 0.0)) == DIVERGED


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
    assert tuple(after[top + 4, left + 4]) == colour_of(one)


@pytest.mark.parametrize("size_px", [360, 720])
def test_of_many_paths_the_chosen_one_stands_out(size_px):
    """36 paths in the same region: it is on top of them, most of the picture is free, and few returns are written."""
    rng = np.random.default_rng(0)
    paths = [path(-4.0, (-0.15, -0.05), (-0.15, 0.05), is_chosen=True), *random_paths(rng, 36, 6)[1:]]
    frame, plain = (render_frame(SCENE, START, size_px=size_px, imagined=shown) for shown in (paths, None))
    frame = frame[:size_px]
    assert colour_in(frame, (-0.15, -0.1)) == colour_of(paths[0])
    surface = frame[round(0.15 * size_px) : round(0.85 * size_px), round(0.15 * size_px) : round(0.85 * size_px)]
    ink = (np.abs(frame.astype(int) - plain).max(axis=2) > 60).sum() / (surface.shape[0] * surface.shape[1])
    assert 0.02 < ink < 0.2
    canvas = Canvas(SCENE, size_px)
    boxes = draw_returns(canvas.finished(), canvas, paths)
    assert 3 <= len(boxes) <= 9
    ends = canvas.frame_pixels(paths[0].states[-1].gripper_pose[None, :2])[0]
    left, top, right, bottom = boxes[0]
    assert np.hypot(*(ends - ((left + right) / 2, (top + bottom) / 2))) < 0.1 * size_px, "that of the chosen one first"
    alike = [path(-4.0, *robots) for robots in np.split(rng.uniform(-0.2, 0.2, (36, 2)), 36)]
    assert len(draw_returns(canvas.finished(), canvas, alike)) == 1


def test_equal_roll_outs_get_one_label_and_small_pictures_none():
    twice = [path(-4.0, (0.0, 0.0)), path(-4.0, (0.0, 0.0))]
    assert len(draw_returns(Canvas(SCENE, 480).finished(), Canvas(SCENE, 480), twice)) == 1
    assert draw_returns(Canvas(SCENE, 120).finished(), Canvas(SCENE, 120), twice) == []
