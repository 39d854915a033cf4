"""A body that was moved is found where it is, from all or from a part of its outline."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from visualrhp.embodiment.registration import (
    NUM_ANGLES,
    Reference,
    fitted_circle,
    overlap,
    radial_distances,
    register_part,
    register_whole,
)
from visualrhp.scene import geometry
from visualrhp.types import wrap_angle

SHAPES = {
    "box": shapely.box(-0.05, -0.03, 0.05, 0.03),
    "bottle": shapely.union(shapely.box(-0.08, -0.03, 0.03, 0.03), shapely.box(0.0, -0.012, 0.09, 0.012)),
    "triangle": shapely.Polygon([(0.0, 0.0), (0.08, 0.01), (0.02, 0.06)]),
}
CIRCLE = shapely.Point(0.1, 0.1).buffer(0.035, quad_segs=32)


def moved(reference: Reference, pose) -> shapely.Polygon:
    """The outline at another pose, as fine as a camera gives it."""
    return shapely.segmentize(reference.at(pose), 2e-3)


@pytest.mark.parametrize("name", list(SHAPES))
@settings(max_examples=25, deadline=None)
@given(x=st.floats(-0.2, 0.2), y=st.floats(-0.2, 0.2), theta=st.floats(-3.1, 3.1), turn=st.floats(-1.0, 1.0))
def test_a_whole_outline_gives_the_pose(name: str, x: float, y: float, theta: float, turn: float) -> None:
    reference, pose = Reference.located(SHAPES[name], theta)
    assert reference.at(pose).symmetric_difference(SHAPES[name]).area < 1e-9
    wanted = (x, y, theta + turn)
    found, agreement = register_whole(reference, moved(reference, wanted), theta)
    assert found[:2] == pytest.approx([x, y], abs=1e-4)
    assert abs(wrap_angle(float(found[2] - theta - turn))) < math.radians(0.7)
    assert agreement > 0.97


def test_the_rotation_of_a_circle_stays() -> None:
    reference, _ = Reference.located(CIRCLE)
    assert reference.is_round
    found, agreement = register_whole(reference, moved(reference, (0.0, 0.1, 2.0)), 0.4)
    assert found == pytest.approx([0.0, 0.1, 0.4], abs=1e-4) and agreement > 0.99


def test_another_shape_does_not_agree() -> None:
    reference, _ = Reference.located(SHAPES["bottle"])
    assert register_whole(reference, CIRCLE, 0.0)[1] < 0.6


@pytest.mark.parametrize("name", list(SHAPES))
@pytest.mark.parametrize("side", [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
def test_a_part_gives_the_pose(name: str, side: float) -> None:
    reference, _ = Reference.located(SHAPES[name])
    wanted = np.array([0.02, -0.03, 0.6])
    outline = moved(reference, wanted)
    direction, along = np.array([math.cos(side), math.sin(side)]), np.array([-math.sin(side), math.cos(side)])
    start = wanted[:2] + 0.01 * direction
    hidden = shapely.Polygon([start - along, start + along, start + along + direction, start - along + direction])
    ring = shapely.get_coordinates(outline.exterior)[:-1]
    border = ring[~shapely.contains_xy(hidden.buffer(2e-3), ring[:, 0], ring[:, 1])]
    found, distance = register_part(reference, wanted + (0.015, -0.01, 0.15), border, hidden)
    assert found[:2] == pytest.approx(wanted[:2], abs=2e-3)
    assert found[2] == pytest.approx(wanted[2], abs=0.05)
    assert distance < 1.5e-3


def test_a_part_of_another_shape_has_a_large_distance() -> None:
    reference, _ = Reference.located(SHAPES["bottle"])
    ring = shapely.get_coordinates(CIRCLE.exterior)[:-1]
    assert register_part(reference, np.array([0.1, 0.1, 0.0]), ring, shapely.Polygon())[1] > 4e-3


def test_nothing_seen_changes_nothing() -> None:
    reference, pose = Reference.located(SHAPES["box"])
    found, distance = register_part(reference, pose, np.zeros((0, 2)), shapely.Polygon())
    assert np.array_equal(found, pose) and math.isinf(distance)


def test_distances_of_a_square_by_hand() -> None:
    square = shapely.get_coordinates(shapely.box(-1.0, -1.0, 1.0, 1.0).exterior)[:-1]
    distances = radial_distances(square)
    quarter = NUM_ANGLES // 4
    assert distances[[0, quarter, 2 * quarter]] == pytest.approx(1.0, abs=1e-3)
    assert distances.max() == pytest.approx(1.0 / math.cos(math.radians(44.0)), abs=1e-3)


def test_shapes_for_the_planner() -> None:
    reference, _ = Reference.located(shapely.Polygon(SHAPES["bottle"].exterior))
    assert geometry.signed_area(reference.shape.outline) == pytest.approx(SHAPES["bottle"].area, rel=0.02)
    sliver = shapely.Polygon([(0.0, 0.0), (0.2, 0.0), (0.2, 0.0022), (0.0, 0.0022)])
    assert geometry.least_width(Reference.located(sliver)[0].shape.outline) > 3e-3


def test_circles_through_arcs() -> None:
    angles = np.linspace(0.3, 2.0, 30)
    arc = np.array([0.1, -0.2]) + 0.04 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    centre, radius = fitted_circle(arc, 0.036, 4e-3)
    assert centre == pytest.approx([0.1, -0.2], abs=5e-4) and radius == pytest.approx(0.04, abs=5e-4)
    # A short arc says little: the usual radius does.
    centre, radius = fitted_circle(arc[:4], 0.036, 1e-4)
    assert radius == pytest.approx(0.036, abs=2e-4)


def test_overlap_by_hand() -> None:
    assert overlap(shapely.box(0, 0, 2, 1), shapely.box(1, 0, 3, 1)) == pytest.approx(1.0 / 3.0)
    assert overlap(shapely.box(0, 0, 1, 1), shapely.box(2, 0, 3, 1)) == 0.0
