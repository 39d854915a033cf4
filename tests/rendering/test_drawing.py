"""Shapes, text and colours: areas and places by hand, and the same in another size."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.rendering.samples import SCENE, SQUARE, pixel
from visualrhp.errors import ConfigError
from visualrhp.rendering.drawing import (
    BACKGROUND,
    EDGE,
    INK,
    MARGIN,
    PAPER,
    SURFACE,
    TARGET,
    Canvas,
    Colour,
    mix,
    rounded_box,
    shortened,
    text,
    text_width,
)
from visualrhp.scene import ObjectShape, Scene, TargetRegion

PINK: Colour = (255, 0, 255)
BAY = np.array([[-1.2, -0.4], [1.2, -0.4], [1.2, 0.4], [0.2, 0.4], [0.2, 0.0], [-0.2, 0.0], [-0.2, 0.4], [-1.2, 0.4]])


def scene_on(edges: np.ndarray, target: tuple[float, float]) -> Scene:
    return Scene(TargetRegion(np.array(target)), (ObjectShape(SQUARE),), edges)


def area(canvas: Canvas, colour: Colour = PINK) -> float:
    """Area [m^2] of what is drawn in ``colour``."""
    return np.count_nonzero((canvas.picture == colour).all(axis=2)) / canvas.pixels_per_metre**2


def place(canvas: Canvas, x: float, y: float) -> Colour:
    """The colour of the finished frame at a point [m]."""
    column, row = canvas.frame_pixels(np.array([[x, y]]))[0].astype(int)
    red, green, blue = canvas.finished()[row, column].tolist()
    return red, green, blue


def test_pixels_by_hand() -> None:
    """0.7 m on 350 pixels: 500 pixels a metre, x to the right and y up from the corner at (-0.35, -0.35)."""
    canvas = Canvas(SCENE, 350)
    points = np.array([[-0.35, 0.35], [0.35, -0.35], [0.0, 0.0], [0.1, 0.2]])
    assert canvas.frame_pixels(points) == pytest.approx(np.array([[0, 0], [350, 350], [175, 175], [225, 75]]), abs=1e-9)
    assert np.array(canvas.bounds) == pytest.approx(np.array([[-0.35, -0.35], [0.35, 0.35]]))
    assert canvas.finished().shape == (350, 350, 3)


def test_what_is_drawn_at_a_point_is_there_in_the_frame() -> None:
    canvas = Canvas(scene_on(BAY, (0.8, 0.2)), 300)
    frame_per_picture = canvas.size_px / canvas.picture.shape[0]
    low, high = canvas.bounds
    for point in np.random.default_rng(0).uniform(low + MARGIN, high - MARGIN, (20, 2)):
        canvas.clear()
        canvas.dot(point, 0.02, PINK)
        rows, columns = np.nonzero((canvas.picture == PINK).all(axis=2))
        drawn = (np.array([columns.mean(), rows.mean()]) + 0.5) * frame_per_picture
        assert drawn == pytest.approx(canvas.frame_pixels(point[None])[0], abs=0.2)


def test_sizes_are_even_and_not_too_small() -> None:
    assert Canvas(SCENE, 64).finished().shape == (64, 64, 3)
    assert Canvas(SCENE, 101).finished().shape == (102, 102, 3)
    for size_px in (10, 63):
        with pytest.raises(ConfigError, match=f"size_px={size_px}: a frame needs at least 64 pixels"):
            Canvas(SCENE, size_px)


def test_areas_by_hand() -> None:
    canvas = Canvas(SCENE, 480)
    canvas.polygon(np.array([[-0.1, -0.1], [0.1, -0.1], [-0.1, 0.05]]), PINK)
    assert area(canvas) == pytest.approx(0.015, rel=0.02)
    canvas.clear()
    canvas.disc(np.array([0.0, 0.0]), 0.1, PINK)
    assert area(canvas) == pytest.approx(math.pi * 0.01, rel=0.02)
    canvas.clear()
    canvas.disc(np.array([0.0, 0.0]), 0.1, PINK, width=0.02)
    assert area(canvas) == pytest.approx(2.0 * math.pi * 0.1 * 0.02, rel=0.1)
    assert place(canvas, 0.1, 0.0) == place(canvas, 0.0, -0.1) == PINK
    assert place(canvas, 0.03, 0.03) == SURFACE
    canvas.clear()
    canvas.line(np.array([[-0.2, 0.0], [0.2, 0.0]]), PINK, 0.02)
    assert area(canvas) == pytest.approx(0.4 * 0.02 + math.pi * 0.01**2, rel=0.1)


def test_an_outline_is_drawn_around_what_it_fills() -> None:
    canvas = Canvas(SCENE, 480)
    canvas.polygon(SQUARE, PINK, outline=INK, width=0.008)
    assert place(canvas, 0.0, 0.0) == PINK
    assert place(canvas, 0.03, 0.0) == place(canvas, 0.0, -0.03) == INK


def test_a_dot_and_a_line_are_as_large_on_any_surface() -> None:
    usual, large = Canvas(SCENE, 480), Canvas(scene_on(BAY, (0.8, 0.2)), 480)
    counts = []
    for canvas in (usual, large):
        canvas.dot(np.array([-0.05, -0.1]), 0.02, PINK)
        counts.append(np.count_nonzero((canvas.picture == PINK).all(axis=2)))
    assert counts[0] == pytest.approx(counts[1], rel=0.02)
    assert counts[0] == pytest.approx(math.pi * (0.02 * usual.pixels_per_metre) ** 2, rel=0.05)
    assert usual.thickness(0.01) == large.thickness(0.01) == pytest.approx(0.01 * usual.pixels_per_metre, abs=0.5)
    assert usual.size_of(0.01) == pytest.approx(0.01)
    assert large.size_of(0.01) == pytest.approx(0.01 * (2.4 + 2 * MARGIN) / (0.5 + 2 * MARGIN))
    assert usual.thickness(0.0) == 1


def test_clearing_leaves_the_surface() -> None:
    canvas, untouched = Canvas(SCENE, 200), Canvas(SCENE, 200)
    canvas.disc(np.array([0.0, 0.0]), 0.2, PINK)
    canvas.veil([(SQUARE, PINK)], 0.5)
    canvas.shade([SQUARE])
    canvas.clear()
    np.testing.assert_array_equal(canvas.picture, untouched.picture)


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_a_veil_is_a_mixture_of_the_colours_within_the_polygons(share: float) -> None:
    canvas = Canvas(SCENE, 480)
    before = canvas.picture.copy()
    canvas.veil([(SQUARE - 0.05, PINK), (SQUARE + (0.1, -0.1), PINK)], share)
    assert place(canvas, -0.03, -0.06) == pytest.approx(mix(SURFACE, PINK, share), abs=1)
    assert place(canvas, 0.12, -0.12) == pytest.approx(mix(SURFACE, PINK, share), abs=1)
    changed = (canvas.picture != before).any(axis=2)
    assert np.count_nonzero(changed) / canvas.pixels_per_metre**2 == pytest.approx(0.0072 * (share > 0.0), rel=0.1)


def test_a_shadow_darkens_around_below_and_brightens_nothing() -> None:
    canvas = Canvas(SCENE, 480)
    before = canvas.picture.copy()
    canvas.shade([SQUARE])
    assert (canvas.picture <= before).all()
    below, above = sum(place(canvas, 0.005, -0.033)), sum(place(canvas, 0.005, 0.033))
    assert below < above <= sum(SURFACE)
    assert place(canvas, -0.03, -0.15) == SURFACE


def test_the_surface_its_edge_and_its_target_region() -> None:
    canvas = Canvas(SCENE, 480)
    assert place(canvas, 0.25, 0.03) == place(canvas, -0.03, -0.25) == EDGE
    assert place(canvas, -0.33, 0.33) == BACKGROUND
    target, radius = SCENE.target.position, SCENE.target.radius
    assert place(canvas, *(target + (0.0, radius))) == place(canvas, *target) == TARGET
    inside = place(canvas, *(target + (0.03, 0.03)))
    assert inside == pytest.approx(mix(SURFACE, TARGET, 0.22), abs=2)


def test_the_grid_is_on_round_numbers_of_the_world() -> None:
    """A line every 10 cm, wherever the surface is."""
    for shift in (0.0, 0.04):
        canvas = Canvas(scene_on(SCENE.edges + shift, (0.15, 0.15)), 480)
        for x in (-0.1, 0.0, 0.1):
            assert place(canvas, x, -0.13) != SURFACE
            assert place(canvas, x + 0.05, -0.13) == SURFACE
            assert place(canvas, -0.13, x) != SURFACE


def test_a_surface_need_not_be_a_square() -> None:
    triangle = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25]])
    frame = Canvas(scene_on(triangle, (-0.15, 0.0)), 240).finished()
    assert tuple(frame[pixel((0.15, 0.15), 240)]) == BACKGROUND
    assert tuple(frame[pixel((-0.22, -0.15), 240)]) == SURFACE


@pytest.mark.parametrize("size_px", [240, 480])
def test_a_larger_surface_is_drawn_whole_with_lines_as_bold(size_px: int) -> None:
    canvas = Canvas(scene_on(BAY, (0.8, 0.2)), size_px)
    assert place(canvas, 0.02, 0.2) == BACKGROUND  # the bay
    assert place(canvas, -1.05, 0.25) == SURFACE

    def boldness(canvas: Canvas, x: float, y: float) -> int:
        column, row = canvas.frame_pixels(np.array([[x, y]]))[0].astype(int)
        return int((canvas.finished()[row - 6 : row + 7, column].astype(int).sum(axis=1) < 300).sum())

    usual = boldness(Canvas(SCENE, size_px), 0.05, 0.25)
    assert usual > 0
    assert boldness(canvas, 0.65, 0.4) == pytest.approx(usual, abs=1)


# ------------------------------------------------------------------------------------------------------ text and boxes
def paper(width: int, height: int) -> np.ndarray:
    return np.full((height, width, 3), PAPER, dtype=np.uint8)


def test_a_text_is_as_wide_as_announced() -> None:
    for words in ("VisualRHP 3x3", "49", "out of actions"):
        picture = paper(400, 40)
        text(picture, words, 10, 28, INK, 20, 500)
        columns = np.flatnonzero((picture != PAPER).any(axis=(0, 2)))
        assert columns.min() >= 9 and columns.max() <= 10 + text_width(words, 20, 500) + 1
        assert np.ptp(columns) == pytest.approx(text_width(words, 20, 500), abs=6)
        rows = np.flatnonzero((picture != PAPER).any(axis=(1, 2)))
        assert rows.max() <= 28 + 7  # below the baseline, only descenders


def test_a_larger_text_is_wider() -> None:
    assert text_width("Greedy", 40, 400) == pytest.approx(2 * text_width("Greedy", 20, 400), rel=0.1)
    assert text_width("", 20, 400) == 0


def test_a_text_is_shortened_as_little_as_necessary() -> None:
    words = "a planner with a long name"
    full = text_width(words, 18, 500)
    assert shortened(words, full, 18, 500) == words
    for width in range(0, full, 7):
        short = shortened(words, width, 18, 500)
        assert text_width(short, 18, 500) <= width
        if short:
            kept = short.removesuffix("...")
            assert short.endswith("...") and words.startswith(kept) and kept == kept.rstrip()
            next_letter = len(kept) + (words[len(kept)] == " ")
            assert text_width(words[: next_letter + 1] + "...", 18, 500) > width
    assert shortened(words, 1, 18, 500) == ""


def test_a_rounded_box_fills_its_place_and_spares_its_corners() -> None:
    picture = paper(120, 60)
    rounded_box(picture, 10, 15, 110, 45, PINK)
    rows, columns = np.nonzero((picture == PINK).all(axis=2))
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == pytest.approx((15, 45, 10, 110), abs=1)
    for row, column in ((15, 10), (15, 110), (45, 10), (45, 110)):
        assert tuple(picture[row, column]) == PAPER
    assert len(rows) == pytest.approx(70 * 30 + math.pi * 15**2, rel=0.06)


def test_mixtures_by_hand() -> None:
    assert mix((0, 100, 200), (100, 0, 201), 0.25) == (25, 75, 200)
    assert mix(PINK, INK, 0.0) == PINK and mix(PINK, INK, 1.0) == INK
    assert mix(PINK, INK, 0.3) == mix(INK, PINK, 0.7)
