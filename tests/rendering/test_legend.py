"""The bars below a picture: their words fit, and their colours are those of the picture."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.rendering.samples import SCENE, STATE
from visualrhp.rendering.drawing import DESIRED, GRIPPER, INK, OBSTACLE, PAPER, Colour
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.imagined import ImaginedPath, colour_of
from visualrhp.rendering.legend import meaning_bar, rollout_bar, scale_height
from visualrhp.rendering.video import Frame

SIZES = [(34, 64), (34, 120), (34, 320), (40, 480), (62, 720), (92, 1080), (40, 800)]


def path(value: float, *, is_chosen: bool = False, num_actions: int = 1) -> ImaginedPath:
    return ImaginedPath((STATE,) * (1 + num_actions), value, is_chosen)


def columns(bar: Frame, colour: Colour, top: float = 0.125, bottom: float = 1.0) -> np.ndarray:
    """Columns with a colour between two heights of a bar, as shares of it from above."""
    part = bar[round(top * bar.shape[0]) : round(bottom * bar.shape[0])]
    return np.flatnonzero((np.abs(part.astype(int) - colour) < 6).all(axis=2).any(axis=0))


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_the_scale_fits_and_marks_the_chosen_return(height: int, width: int) -> None:
    paths = [path(-50.0), path(-10.0, is_chosen=True), path(-35.0), path(-math.inf)]
    bar = rollout_bar(SCENE, paths, height, width, 0.0123)
    assert bar.shape == (height, width, 3)
    inked = (bar[height // 8 :].astype(int).sum(axis=2) < 700).any(axis=0)
    assert inked.any() and not inked[:2].any() and not inked[-2:].any(), "nothing is cut off"
    best, worst = (columns(bar, colour_of(one), 0.31, 0.4) for one in (paths[1], paths[0]))
    assert best.max() > worst.min()
    triangle = columns(bar, INK, bottom=0.28)
    assert triangle.mean() == pytest.approx(np.median(best), abs=0.02 * width)


def test_the_scale_is_the_same_whatever_the_returns() -> None:
    bars = [
        rollout_bar(SCENE, paths, 62, 720)[round(0.55 * 62) :, 320:]  # below the marks of the roll-outs: the ticks
        for paths in ([path(-4.0)], [path(-50.0), path(-1.0, is_chosen=True)])
    ]
    np.testing.assert_array_equal(*bars)
    assert (bars[0] != PAPER).any()


@pytest.mark.parametrize(("height", "width"), SIZES[1:])
def test_a_plan_is_described_by_its_length(height: int, width: int) -> None:
    bars = [rollout_bar(SCENE, [path(-23.4, is_chosen=True, num_actions=count)], height, width) for count in (3, 1)]
    assert (bars[0] != bars[1]).any()


def test_the_bar_of_nothing_is_empty() -> None:
    empty = rollout_bar(SCENE, [], 40, 480)
    assert (empty[4:] == PAPER).all()


@pytest.mark.parametrize("width", [200, 256, 360, 720, 1200])
@pytest.mark.parametrize("with_paths", [True, False])
def test_every_colour_has_a_meaning_and_every_word_fits(width: int, with_paths: bool) -> None:
    bar = meaning_bar(min(width, 720), width, with_paths=with_paths)
    assert bar.shape[1:] == (width, 3) and bar.shape[0] % 2 == 0
    for colour in (DESIRED, OBSTACLE, GRIPPER):
        assert len(columns(bar, colour)) >= 5
    inked = (bar[4:].astype(int).sum(axis=2) < 700).any(axis=0)
    assert not inked[:3].any() and not inked[-3:].any()


def test_the_legend_stands_below_the_picture_and_is_in_one_row_at_the_usual_sizes() -> None:
    for size_px in (360, 720):
        plain = render_frame(SCENE, STATE, size_px=size_px)
        frame = render_frame(SCENE, STATE, size_px=size_px, imagined=[path(-3.0)], show_legend=True)
        rows = meaning_bar(size_px, size_px, with_paths=True)
        assert rows.shape[0] < 0.06 * size_px
        np.testing.assert_array_equal(frame[-rows.shape[0] :], rows)
        assert frame.shape[0] == size_px + scale_height(size_px) + rows.shape[0]
        np.testing.assert_array_equal(frame[:size_px][-9:], plain[-9:])
    assert meaning_bar(96, 96, with_paths=True).shape == (0, 96, 3)
