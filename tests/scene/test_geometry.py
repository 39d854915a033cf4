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
