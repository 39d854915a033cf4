"""Outlines that are not convex: their parts, their mass properties, and outlines from contours."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given
from hypothesis import strategies as st

from tests.calls import FEW_CALLS, counted_calls
from visualrhp.errors import SceneError
from visualrhp.scene import ObjectShape, SceneDistribution, geometry, sample_task_instance
from visualrhp.scene.decomposition import convex_parts
from visualrhp.scene.polygons import MIN_OBJECT_AREA, MIN_OBJECT_THICKNESS, polygon_fault
from visualrhp.streams import Split

L_SHAPE = [[0, 0], [0.06, 0], [0.06, 0.02], [0.02, 0.02], [0.02, 0.06], [0, 0.06]]
U_SHAPE = [[0, 0], [0.08, 0], [0.08, 0.06], [0.06, 0.06], [0.06, 0.02], [0.02, 0.02], [0.02, 0.06], [0, 0.06]]
PLUS = [[1, 0], [2, 0], [2, 1], [3, 1], [3, 2], [2, 2], [2, 3], [1, 3], [1, 2], [0, 2], [0, 1], [1, 1]]
ARROW = [[-0.04, -0.03], [0.05, 0.0], [-0.04, 0.03], [-0.02, 0.0]]
STAR = [[np.cos(a) * r, np.sin(a) * r] for a, r in zip(np.arange(10) * np.pi / 5, 5 * [0.05, 0.02], strict=True)]


def random_outline(seed: int) -> np.ndarray:
    """A polygon that is star-shaped about the origin, with corners of all kinds."""
    rng = np.random.default_rng(seed)
    num_vertices = int(rng.integers(4, 16))
    angles = (np.arange(num_vertices) + rng.uniform(-0.4, 0.4, num_vertices)) * 2.0 * np.pi / num_vertices
    return rng.uniform(0.015, 0.06, (num_vertices, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def random_shape(seed: int) -> ObjectShape:
    """A random outline that can be simulated, at a random angle."""
    outline = random_outline(seed) @ geometry.rotation_matrix(float(seed)).T
    assume(polygon_fault(outline, solid=True) is None)
    return ObjectShape.centred(outline, density=2.0)


def union(parts: tuple[np.ndarray, ...]) -> shapely.Geometry:
    return shapely.union_all([shapely.Polygon(part) for part in parts])


@pytest.mark.parametrize(
    ("outline", "most_parts"), [(L_SHAPE, 2), (U_SHAPE, 3), (0.02 * np.array(PLUS), 3), (ARROW, 2), (STAR, 5)]
)
def test_drawn_shapes(outline: list[list[float]], most_parts: int) -> None:
    shape = ObjectShape.centred(outline)
    assert 2 <= len(shape.convex_parts) <= most_parts
    check_parts(shape)


def check_parts(shape: ObjectShape) -> None:
    for part in shape.convex_parts:
        assert geometry.is_convex(part) and not part.flags.writeable
        assert geometry.signed_area(part) > MIN_OBJECT_AREA / 10.0
        assert geometry.least_width(part) > MIN_OBJECT_THICKNESS / 3.0
        chord = np.roll(part, -1, axis=0) - np.roll(part, 1, axis=0)
        edge = np.roll(part, -1, axis=0) - part
        turns = chord[:, 0] * edge[:, 1] - chord[:, 1] * edge[:, 0]
        assert (turns / np.hypot(*chord.T) > 1e-10).all(), "collinear"
    assert union(shape.convex_parts).symmetric_difference(shapely.Polygon(shape.outline)).area < 1e-12


@given(st.integers(0, 10_000))
def test_parts_are_convex_thick_and_make_up_the_outline(seed: int) -> None:
    shape = random_shape(seed)
    if geometry.is_convex(shape.outline):
        assert len(shape.convex_parts) == 1
    check_parts(shape)


def test_a_sliver_grows_into_its_neighbour() -> None:
    """A dent of half a millimetre in a side: cut straight across its corners, it would leave slivers."""
    outline = np.array([[0, 0], [0.06, 0], [0.06, 0.03], [0.03, 0.0295], [0, 0.03]])
    parts = convex_parts(outline)
    assert min(geometry.least_width(part) for part in parts) > 0.02
    assert union(parts).symmetric_difference(shapely.Polygon(outline)).area < 1e-12


def lobes(count: int, noise: float) -> np.ndarray:
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    radii = 0.045 + 0.012 * np.cos(3.0 * angles) + np.random.default_rng(0).normal(0.0, noise, count)
    return radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


@pytest.mark.parametrize(
    ("count", "noise"), [(400, 0.0), (400, 2e-4), (401, 0.0), (800, 1e-5), (3000, 1e-5), (9999, 1e-5)]
)
def test_dense_outlines_are_decomposed_in_bounded_time(count: int, noise: float) -> None:
    """Of 800 points, a minute; of 900 noisy ones, 29 s: now below a second, within the tolerance that is reported."""
    with counted_calls() as calls:
        shape = ObjectShape.centred(lobes(count, noise))
        parts = shape.convex_parts
    assert calls.count < FEW_CALLS
    assert len(parts) < 200 and all(geometry.is_convex(part) for part in parts)
    assert (shape.contact_tolerance == 0.0) == (count <= 400) and shape.contact_tolerance <= 2.5e-4
    outline = shapely.Polygon(shape.outline)
    difference = union(parts).symmetric_difference(outline)
    assert difference.buffer(-0.5 * shape.contact_tolerance - 1e-9).is_empty
    assert shape.area == pytest.approx(outline.area)


def test_a_dense_outline_that_is_rough_is_told_how_to_simplify() -> None:
    with pytest.raises(SceneError, match=r"has 900 vertices and is rough.*ObjectShape.from_contour"):
        ObjectShape.centred(lobes(900, 8e-4))
    assert len(ObjectShape.from_contour(lobes(900, 2e-4), 1e-3).convex_parts) < 20


def teeth(count: int) -> list[list[float]]:
    """A comb."""
    outline = [[0.0, 0.0], [0.005 * (2 * count - 1), 0.0]]
    for tooth in reversed(range(count)):
        outline += [[0.005 * (2 * tooth + 1), 0.05], [0.005 * 2 * tooth, 0.05]]
        outline += [[0.005 * 2 * tooth, 0.01], [0.005 * (2 * tooth - 1), 0.01]] if tooth else []
    return outline


def test_many_arms_are_decomposed_in_bounded_time() -> None:
    with counted_calls() as calls:
        shape = ObjectShape.centred(teeth(99))
        check_parts(shape)
    assert calls.count < FEW_CALLS and len(shape.convex_parts) <= 100


def test_a_c_of_any_number_of_vertices_keeps_what_lies_in_its_opening() -> None:
    angles = np.linspace(0.7, 2.0 * np.pi - 0.7, 3000)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for step in (60, 12, 1):
        shape = ObjectShape.centred(np.concatenate([0.009 * circle[::step], 0.0045 * circle[::-step]]))
        opening = shapely.Polygon(shape.outline).convex_hull.difference(shapely.Polygon(shape.outline))
        assert not geometry.is_convex(shape.outline)
        assert union(shape.convex_parts).intersection(opening).area < 1e-6 < opening.area


def test_a_convex_outline_is_its_own_part_bit_exactly() -> None:
    for index in range(20):
        for shape in sample_task_instance(SceneDistribution(), 0, Split.TUNING, index).scene.objects:
            (part,) = shape.convex_parts
            assert part is shape.outline


@given(st.integers(0, 10_000))
@example(3)
def test_mass_properties_are_those_of_the_parts(seed: int) -> None:
    """Integrals over the outline against those over its triangles (by quadrature in each)."""
    shape = random_shape(seed)
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.Polygon(shape.outline)))
    a, b, c = np.moveaxis(shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3], 1, 0)
    areas = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    n = 24  # midpoints of the n^2 small triangles of each triangle
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    up, down = u + v < n, u + v < n - 1
    weights = np.concatenate(
        [np.stack([u[up] + 1 / 3, v[up] + 1 / 3], axis=1), np.stack([u[down] + 2 / 3, v[down] + 2 / 3], axis=1)]
    )
    weights /= n
    points = a[:, None] + weights[:, :1] * (b - a)[:, None] + weights[:, 1:] * (c - a)[:, None]
    distances = np.hypot(points[..., 0], points[..., 1])
    assert shape.mass == pytest.approx(2.0 * areas.sum())
    assert shape.moment_of_inertia == pytest.approx(2.0 * (areas * (distances**2).mean(axis=1)).sum(), rel=2e-3)
    assert shape.friction_lever == pytest.approx((areas * distances.mean(axis=1)).sum() / areas.sum(), rel=2e-3)


def test_friction_lever_with_edges_that_face_away_from_the_centre() -> None:
    """A thin ring with a slit: its mass is at the radius, and the centre sees the inner side from behind."""
    angles = np.linspace(0.02, 2.0 * np.pi - 0.02, 400)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ring = np.concatenate([0.052 * circle, 0.048 * circle[::-1]])
    assert geometry.first_moment_of_distance(ring) / geometry.signed_area(ring) == pytest.approx(0.05, rel=2e-3)


def camera_contour(outline: object, rng: np.random.Generator, noise: float) -> np.ndarray:
    """Points every half millimetre along a polygon, with noise."""
    border = shapely.Polygon(outline).exterior
    points = shapely.line_interpolate_point(border, np.arange(0.0, border.length, 5e-4))
    return shapely.get_coordinates(points) + rng.normal(0.0, noise, (len(points), 2))


@pytest.mark.parametrize("outline", [L_SHAPE, U_SHAPE, ARROW, STAR])
@pytest.mark.parametrize("clockwise", [False, True])
def test_from_contour(outline: list[list[float]], clockwise: bool) -> None:
    points = camera_contour(outline, np.random.default_rng(0), 5e-5)
    points = np.concatenate([points, points[:1]])  # closed
    shape = ObjectShape.from_contour(points[::-1] if clockwise else points, 1e-3, density=3.0, friction=0.4)
    assert len(shape.outline) < 2 * len(outline) and (shape.density, shape.friction) == (3.0, 0.4)
    check_parts(shape)
    simple = geometry.simplify_contour(points, 1e-3)
    borders = [shapely.Polygon(vertices).exterior for vertices in (points, simple)]
    assert shapely.hausdorff_distance(*borders, densify=0.01) < 1.001e-3
    same, position = ObjectShape.located(simple)
    assert same.outline == pytest.approx(ObjectShape.centred(simple).outline)
    assert position == pytest.approx(geometry.centroid(np.array(outline)), abs=1e-3)


def test_a_contour_may_touch_itself_and_repeat_points() -> None:
    """A box with a whisker of no width, as cv2.findContours traces one, and a speck that it encloses."""
    box = [[0, 0], [0.04, 0], [0.04, 0.03], [0.04, 0.03], [0.02, 0.03], [0.02, 0.05], [0.02, 0.03], [0, 0.03], [0, 0]]
    assert ObjectShape.from_contour(box, 1e-3).area == pytest.approx(0.04 * 0.03)
    eight = [[0, 0], [0.04, 0.04], [0.08, 0], [0.08, 0.08], [0.04, 0.04], [0, 0.02]]
    assert ObjectShape.from_contour(eight, 1e-4).area == pytest.approx(0.04 * 0.08 / 2)


@pytest.mark.parametrize(
    ("points", "tolerance", "message"),
    [
        ([[0, 0], [0.04, 0]], 1e-3, "three points"),
        ([[0, 0], [0.04, 0], [0.02, 0]], 1e-3, "no area"),
        ([[0, 0], [0.04, 0], [0.02, np.nan]], 1e-3, "not finite"),
        (L_SHAPE, 0.0, "tolerance"),
        (L_SHAPE, np.nan, "tolerance"),
        ([[0, 0], [0.04, 0], [0.04, 0.002], [0, 0.002]], 1e-3, "too thin"),
    ],
)
def test_contours_that_are_no_objects(points: object, tolerance: float, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        ObjectShape.from_contour(points, tolerance)
