"""Polygon integrals against closed forms and against quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visualrhp.scene import geometry

UNIT_SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def regular_polygon(num_vertices: int, radius: float) -> np.ndarray:
    angles = np.linspace(0.0, 2.0 * np.pi, num_vertices, endpoint=False)
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def test_unit_square_by_hand() -> None:
    assert geometry.signed_area(UNIT_SQUARE) == pytest.approx(1.0)
    assert geometry.signed_area(UNIT_SQUARE[::-1]) == pytest.approx(-1.0)
    assert geometry.centroid(UNIT_SQUARE + (3.0, 4.0)) == pytest.approx([3.0, 4.0])
    assert geometry.second_moment_of_area(UNIT_SQUARE) == pytest.approx(1.0 / 6.0)  # (a^2 + b^2) / 12
    # mean distance from the centre of a unit square: (sqrt 2 + asinh 1) / 6
    assert geometry.first_moment_of_distance(UNIT_SQUARE) == pytest.approx((np.sqrt(2.0) + np.arcsinh(1.0)) / 6.0)


def test_disc_limits() -> None:
    disc = regular_polygon(2000, 0.03)
    area = np.pi * 0.03**2
    assert geometry.second_moment_of_area(disc) == pytest.approx(area * 0.03**2 / 2.0, rel=1e-4)
    assert geometry.first_moment_of_distance(disc) == pytest.approx(area * 0.03 * 2.0 / 3.0, rel=1e-4)


def test_first_moment_of_distance_against_quadrature() -> None:
    triangle = np.array([[-0.02, -0.01], [0.05, -0.02], [-0.01, 0.04]])
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-0.06, 0.06, 1201)]), axis=-1).reshape(-1, 2)
    inside = np.ones(len(grid), dtype=bool)
    for start, end in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        edge = end - start
        inside &= edge[0] * (grid[:, 1] - start[1]) - edge[1] * (grid[:, 0] - start[0]) >= 0.0
    expected = np.hypot(*grid[inside].T).sum() * 1e-4**2
    assert geometry.first_moment_of_distance(triangle) == pytest.approx(expected, rel=2e-3)


@given(
    pose=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-7, 7)),
    point=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
)
def test_world_and_body_frames_are_inverse(pose: tuple[float, ...], point: tuple[float, float]) -> None:
    points = np.array([point])
    assert geometry.to_body(geometry.to_world(points, pose), pose) == pytest.approx(points, abs=1e-12)


def test_to_world_turns_counter_clockwise() -> None:
    assert geometry.to_world(np.array([[1.0, 0.0]]), (10.0, 20.0, np.pi / 2)) == pytest.approx(np.array([[10.0, 21.0]]))


def test_contains_in_a_polygon_that_is_not_convex() -> None:
    notch = np.array([[0, 0], [4, 0], [4, 4], [2, 1], [0, 4]], dtype=float)
    assert geometry.contains(notch, 0.5, 1.0)
    assert not geometry.contains(notch, 2.0, 2.0)
    assert not geometry.contains(notch, -0.1, 1.0)


def c_shape(count: int, outer: float = 0.009, inner: float = 0.0045, gap: float = 1.4) -> np.ndarray:
    """A C of 18 mm with round ends and ``count`` vertices at equal distances."""
    turn = np.linspace(gap / 2, 2 * np.pi - gap / 2, 4 * count)
    middle, half, round_end = (outer + inner) / 2, (outer - inner) / 2, np.linspace(0, np.pi, 2 * count)[1:-1]

    def end(angle: float, sign: float) -> np.ndarray:
        out, along = np.array([np.cos(angle), np.sin(angle)]), sign * np.array([-np.sin(angle), np.cos(angle)])
        return middle * out + half * (np.cos(round_end)[:, None] * out + np.sin(round_end)[:, None] * along)

    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    border = [outer * circle, end(2 * np.pi - gap / 2, 1.0), inner * circle[::-1], end(gap / 2, -1.0)[::-1]]
    points = np.concatenate(border)
    closed = np.concatenate([points, points[:1]])
    places = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    wanted = np.arange(count) / count * places[-1]
    return np.stack([np.interp(wanted, places, closed[:, axis]) for axis in (0, 1)], axis=1)


@pytest.mark.parametrize("count", [40, 150, 1000, 6000, 30_000])
@pytest.mark.parametrize("scale", [1.0, 10.0, 0.5])
def test_convexity_does_not_depend_on_the_number_of_vertices_or_the_size(count: int, scale: float) -> None:
    assert not geometry.is_convex(scale * c_shape(count))
    assert geometry.is_convex(scale * regular_polygon(count, 0.01))


def test_a_dent_within_rounding_is_convex() -> None:
    turned = UNIT_SQUARE[[0, 1, 1, 2, 3]] @ geometry.rotation_matrix(0.3).T
    turned[2] = 0.5 * (turned[1] + turned[3])
    for dent, is_convex in ((1e-17, True), (1e-11, True), (1e-8, False)):
        bent = turned.copy()
        bent[2] -= dent * (turned[2] - turned.mean(axis=0))
        assert geometry.is_convex(bent) is is_convex, dent


@pytest.mark.parametrize("count", [513, 1500, 4001])
def test_widths_of_many_vertices_are_those_of_few(count: int) -> None:
    """An ellipse: its least and its largest width are its axes."""
    ellipse = regular_polygon(count, 0.05) * (1.0, 0.4) @ geometry.rotation_matrix(0.7).T
    assert geometry.width_range(ellipse) == pytest.approx((0.04, 0.1), rel=1e-4)
    edges = np.roll(ellipse, -1, axis=0) - ellipse
    heights = np.stack([-edges[:, 1], edges[:, 0]], axis=1) @ ellipse.T
    exact = ((heights.max(axis=1) - heights.diagonal()) / np.hypot(*edges.T)).min()
    assert geometry.least_width(ellipse) == pytest.approx(exact, rel=1e-9)


def test_many_points_are_contained_as_one() -> None:
    notch = np.array([[0, 0], [4, 0], [4, 4], [2, 1], [0, 4]], dtype=float)
    points = np.concatenate([np.random.default_rng(0).uniform(-1, 5, (300, 2)), notch, [[2.0, 0.0], [0.0, 2.0]]])
    expected = [geometry.contains(notch, x, y) for x, y in points.tolist()]
    assert geometry.contains_each(notch, points).tolist() == expected and 50 < sum(expected) < 250
