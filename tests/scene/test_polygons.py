"""Polygons that can be simulated, and the first fault of those that cannot."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.errors import SceneError
from visualrhp.scene import geometry
from visualrhp.scene.polygons import (
    MAX_COORDINATE,
    MIN_OBJECT_AREA,
    MIN_OBJECT_THICKNESS,
    checked_polygon,
    polygon_fault,
    read_only,
)

BOX = [[-0.02, -0.01], [0.02, -0.01], [0.02, 0.01], [-0.02, 0.01]]
L_OF_2_MM = [[0, 0], [0.06, 0], [0.06, 0.02], [0.002, 0.02], [0.002, 0.06], [0, 0.06]]
BRIDGE_OF_2_MM = [
    *([0, 0], [0.02, 0], [0.02, 0.009], [0.024, 0.009], [0.024, 0], [0.044, 0]),
    *([0.044, 0.02], [0.024, 0.02], [0.024, 0.011], [0.02, 0.011], [0.02, 0.02], [0, 0.02]),
]


@pytest.mark.parametrize(
    ("outline", "message"),
    [
        ([[0, 0], [1, 0]], "at least three vertices"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], r"three vertices \(x, y\), not an array of shape \[3, 3\]"),
        ([[0, 0], [1, 0], [np.nan, 1]], "not finite.*vertex 2"),
        ([[0, 0], [1, 0], [np.inf, 1]], "not finite.*vertex 2"),
        ([[0, 0], [40, 0], [40, 500]], "metres.*vertex 2"),
        ([[0, 0], [1, 0], [1, 0, 0]], "array of numbers"),
        ([[-1, -1], [1, 1], [1, -1], [-1, 1]], r"crosses or touches itself at \(0, 0\)"),
        (BOX[::-1], "clockwise.*counter-clockwise"),
        ([*BOX[:2], BOX[1], *BOX[2:]], "duplicate vertex.*vertex 2"),
        ([*BOX, BOX[0]], "repeats its first vertex.*vertex 4"),
        ([[0, 0], [0.02, 0.02], [0.04, 0.04]], "collinear vertices only"),
        ([[-0.02, 0], [0.02, -1e-5], [0.02, 1e-5]], r"area 4e-07 m\^2; at least 1e-05"),
    ],
)
def test_what_is_neither_a_surface_nor_a_body(outline: list[list[float]], message: str) -> None:
    for solid in (False, True):
        with pytest.raises(SceneError, match=message):
            checked_polygon(outline, "the outline", solid)


@pytest.mark.parametrize(
    ("outline", "message"),
    [
        ([BOX[0], [0.0, -0.01], *BOX[1:]], r"collinear vertices: \[0.0, -0.01\].*vertex 1"),
        ([[-0.02, -0.0014], [0.02, -0.0014], [0.02, 0.0014], [-0.02, 0.0014]], "too thin: 2.8 mm wide; at least 3 mm"),
        (L_OF_2_MM, "too thin around .*vertex [45]"),
        (BRIDGE_OF_2_MM, r"neck around \[0.022"),
        ([[0, 0], [0.1, 0], [0.1, 0.002], [0.002, 0.002], [0.002, 0.1], [0, 0.1]], "too thin everywhere"),
    ],
)
def test_what_is_a_surface_and_no_body(outline: list[list[float]], message: str) -> None:
    assert checked_polygon(outline, "the surface", solid=False) == pytest.approx(np.array(outline))
    with pytest.raises(SceneError, match=message):
        checked_polygon(outline, "the outline", solid=True)


@pytest.mark.parametrize("outline", [L_OF_2_MM, BRIDGE_OF_2_MM, BOX[::-1], [*BOX, BOX[0]]])
@pytest.mark.parametrize("turn", [0.3, 1.9, -2.5])
def test_a_fault_turns_and_shifts_with_its_polygon(outline: list[list[float]], turn: float) -> None:
    moved = geometry.to_world(np.array(outline), (0.3, -0.2, turn))
    fault, again = polygon_fault(np.array(outline), solid=True), polygon_fault(moved, solid=True)
    assert fault is not None and again is not None
    assert fault.vertex == again.vertex
    assert fault.message.split("[")[0] == again.message.split("[")[0]  # coordinates follow


def test_a_body_of_the_least_thickness_is_thick_enough() -> None:
    """A bar, a bar across, a needle, and an L of such arms."""
    t = 1.001 * MIN_OBJECT_THICKNESS
    for outline in (
        np.array([[0, 0], [0.1, 0], [0.1, t], [0, t]]),
        np.array([[0, 0], [0.1, 0], [0.1, t], [0, t]]) @ geometry.rotation_matrix(0.7).T,
        np.array([[0, 0], [0.1, 0], [0, t * 1.001]]),
        np.array([[0, 0], [0.06, 0], [0.06, t], [t, t], [t, 0.06], [0, 0.06]]),
    ):
        assert polygon_fault(outline, solid=True) is None
        thinner = outline * (0.99 * MIN_OBJECT_THICKNESS / t)
        assert polygon_fault(thinner, solid=True) is not None


def test_the_pointed_end_of_an_arm_may_be_thin() -> None:
    """An arrow with a blunt notch: the tip is thinner than 3 mm only on its last millimetres."""
    arrow = np.array([[0, -0.02], [0.03, 0], [0, 0.02], [0.008, 0]])
    assert not geometry.is_convex(arrow)
    assert polygon_fault(arrow, solid=True) is None


@pytest.mark.parametrize(("scale", "is_valid"), [(1.01, True), (0.99, False)])
def test_the_smallest_area_by_hand(scale: float, is_valid: bool) -> None:
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * np.sqrt(scale * MIN_OBJECT_AREA)
    assert (polygon_fault(square, solid=True) is None) is is_valid


@pytest.mark.parametrize(("scale", "is_valid"), [(1.0, True), (1.01, False)])
def test_the_largest_coordinate_by_hand(scale: float, is_valid: bool) -> None:
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * scale * MAX_COORDINATE
    assert (polygon_fault(square, solid=True) is None) is is_valid


def test_a_polygon_may_begin_at_any_vertex() -> None:
    notch = np.array([[0, 0], [0.04, 0], [0.04, 0.04], [0.02, 0.01], [0, 0.04]])
    for shift in range(5):
        assert polygon_fault(np.roll(notch, shift, axis=0), solid=True) is None
        fault = polygon_fault(np.roll(np.insert(notch, 1, [0.02, 0], axis=0), shift, axis=0), solid=True)
        assert fault is not None and fault.vertex == (1 + shift) % 6


def test_a_polygon_that_touches_itself_is_not_simple() -> None:
    """Two triangles that meet in a point; the message names the place, and the vertex that is there."""
    with pytest.raises(SceneError, match=r"^the surface crosses or touches itself at \(0.1, 0.1\).*\(vertex [14]\)$"):
        checked_polygon([[0, 0], [0.1, 0.1], [0.2, 0], [0.2, 0.2], [0.1, 0.1], [0, 0.2]], "the surface", solid=False)


def test_a_checked_polygon_is_a_read_only_copy() -> None:
    given = np.array(BOX)
    polygon = checked_polygon(given, "the outline", solid=True)
    given[0] = 7.0
    assert polygon.tolist() == BOX
    with pytest.raises(ValueError, match="read-only"):
        polygon[0, 0] = 1.0


def test_numbers_become_floats_and_nothing_else_does() -> None:
    assert read_only([1, 2]).dtype == np.float64
    for values in ([[1], [1, 2]], ["a"], [None, {}], [1 + 2j]):
        with pytest.raises(SceneError, match="an array of numbers is needed, not"):
            read_only(values)
    with pytest.raises(SceneError) as caught:
        read_only(["long" * 1000])
    assert len(str(caught.value)) < 300
