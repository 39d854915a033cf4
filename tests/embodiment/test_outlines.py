"""Outlines of bodies whose shape is known, seen by a camera to the side."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.embodiment.seen_bodies import (
    CIRCLE,
    box,
    cup,
    detection,
    fruit,
    lying_bottle,
    painted,
    standing_bottle,
    top_camera,
)
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.occlusion import HiddenRegion
from visualrhp.embodiment.outlines import (
    MAX_VERTICES,
    largest_piece,
    least_width,
    mask_contour,
    planner_outline,
    section_heights,
    silhouette,
)
from visualrhp.embodiment.segmentation import Detection
from visualrhp.errors import SceneError
from visualrhp.scene import geometry

CAMERA = top_camera(focal_length=900.0)
BODIES = {
    "fruit": fruit(),
    "box": box(),
    "cup": cup(),
    "standing bottle": standing_bottle(),
    "lying bottle": lying_bottle(),
}


def overlap(first, second) -> float:
    return shapely.intersection(first, second).area / shapely.union(first, second).area


@pytest.mark.parametrize("name", list(BODIES))
def test_outlines_are_those_seen_vertically_from_above(name: str) -> None:
    rng = np.random.default_rng(0)
    for _ in range(12):
        x, y = rng.uniform(-0.22, 0.22, 2)
        body = BODIES[name].at(x, y, rng.uniform(-3.0, 3.0))
        found = silhouette(CAMERA, detection(CAMERA, body))
        assert found is not None
        centre = shapely.get_coordinates(body.outline.centroid)[0]
        assert np.hypot(*(found.centroid - centre)) < (4e-3 if name == "lying bottle" else 1e-3)
        assert overlap(found.polygon, body.outline) > 0.94
        assert overlap(shapely.Polygon(planner_outline(found.polygon)), body.outline) > 0.92
        assert found.share_seen == 1.0 and found.is_seen.all()


def test_without_the_heights_the_outline_would_be_far_off() -> None:
    body = box().at(0.2, 0.1)
    on_table = CAMERA.back_project(mask_contour(detection(CAMERA, body).mask))
    centre = shapely.get_coordinates(body.outline.centroid)[0]
    assert np.hypot(*(on_table.mean(axis=0) - centre)) > 4e-3


@settings(max_examples=20, deadline=None)
@given(st.floats(100.0, 200.0), st.floats(100.0, 200.0), st.floats(8.0, 60.0))
def test_contours_are_precise_to_a_tenth_of_a_pixel(x: float, y: float, radius: float) -> None:
    """Of what the mask tells: on a grid, a disc has up to 0.2 pixels more or less of a radius."""
    mask = painted(CAMERA, shapely.Polygon((x, y) + radius * CIRCLE))
    contour = shapely.Polygon(mask_contour(mask))
    rows, columns = np.nonzero(mask)
    assert shapely.get_coordinates(contour.centroid)[0] == pytest.approx([columns.mean(), rows.mean()], abs=0.1)
    assert math.sqrt(contour.area / math.pi) == pytest.approx(math.sqrt(mask.sum() / math.pi), abs=0.1)
    assert math.sqrt(contour.area / math.pi) == pytest.approx(radius, abs=0.3)


def test_of_several_pieces_the_largest_counts() -> None:
    mask = np.zeros((50, 50), dtype=bool)
    mask[10:30, 10:30] = True
    mask[40:44, 40:44] = True
    assert mask_contour(mask).max() < 31.0
    assert mask_contour(np.zeros((5, 5), dtype=bool)).shape == (0, 2)


def test_the_height_of_a_round_body_is_its_radius() -> None:
    body = fruit(0.04).at(0.1, 0.1)
    on_table = shapely.Polygon(CAMERA.back_project(mask_contour(detection(CAMERA, body).mask)))
    low, high = section_heights(CAMERA, Detection(Kind.ORANGE, False, np.zeros((1, 1), dtype=bool)), on_table)
    assert low == high == pytest.approx(0.04, abs=1e-3)


def test_what_is_too_small_is_no_object() -> None:
    assert silhouette(CAMERA, detection(CAMERA, fruit(0.006))) is None
    empty = Detection(Kind.CUP, False, np.zeros((CAMERA.height, CAMERA.width), dtype=bool))
    assert silhouette(CAMERA, empty) is None


@pytest.mark.parametrize("name", ["fruit", "box"])
def test_where_something_hides_the_object_its_border_is_not_seen(name: str) -> None:
    body = BODIES[name].at(0.1, 0.05)
    arm = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    arm[:, : int(CAMERA.project([[0.09, 0.05, 0.03]])[0, 0])] = True
    found = silhouette(CAMERA, detection(CAMERA, body, arm), HiddenRegion(CAMERA, arm))
    assert found is not None
    assert 0.3 < found.share_seen < 0.9
    seen, rest = found.points[found.is_seen], found.points[~found.is_seen]
    assert seen[:, 0].min() > 0.088 and rest[:, 0].max() < 0.098
    border = shapely.LinearRing(shapely.get_coordinates(body.outline.exterior)[:-1])
    assert shapely.distance(border, shapely.points(seen)).max() < 3e-3
    assert found.hidden.contains(shapely.Point(0.05, 0.05))


def test_an_object_in_two_pieces_is_one() -> None:
    body = lying_bottle().at(0.02, 0.05)
    arm = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    column = int(CAMERA.project([[0.0, 0.05, 0.03]])[0, 0])
    arm[:, column - 20 : column + 20] = True
    found = silhouette(CAMERA, detection(CAMERA, body, arm), HiddenRegion(CAMERA, arm))
    assert found is not None
    assert overlap(found.polygon, body.outline) > 0.85
    seen = found.points[found.is_seen]
    assert len(seen) > 20 and not ((seen[:, 0] > -0.012) & (seen[:, 0] < 0.012)).any()
    # Without anything between them, the smaller piece is an error of the mask.
    alone = silhouette(CAMERA, detection(CAMERA, body, arm))
    assert alone is not None and alone.area < 0.7 * found.area


def test_planner_outlines_are_small_convex_and_of_the_same_area() -> None:
    blob = shapely.Polygon(0.04 * CIRCLE)
    outline = planner_outline(blob)
    assert len(outline) <= MAX_VERTICES
    assert geometry.is_convex(outline)
    assert geometry.signed_area(outline) == pytest.approx(blob.area)
    assert geometry.centroid(outline) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_a_notch_is_kept_if_it_is_large() -> None:
    square = shapely.box(0.0, 0.0, 0.1, 0.1)
    large = planner_outline(shapely.difference(square, shapely.box(0.03, 0.05, 0.07, 0.1)))
    small = planner_outline(shapely.difference(square, shapely.box(0.045, 0.095, 0.055, 0.1)))
    assert not geometry.is_convex(large) and geometry.is_convex(small)


def test_degenerate_outlines_are_refused() -> None:
    with pytest.raises(SceneError, match="too small"):
        planner_outline(shapely.box(0.0, 0.0, 0.01, 0.01))


def test_pieces_and_widths() -> None:
    pieces = shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(2, 0, 5, 2)])
    assert largest_piece(pieces).area == 6.0
    assert largest_piece(shapely.LineString([(0, 0), (1, 1)])).is_empty
    crossing = shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])
    assert largest_piece(crossing).is_valid
    assert least_width(shapely.box(0, 0, 5, 2)) == pytest.approx(2.0)
