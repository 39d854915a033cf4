"""Outlines from what people have, within their tolerance and never half of them in silence."""

from __future__ import annotations

import warnings
from typing import Any

import cv2
import numpy as np
import pytest
import shapely

from visualrhp.errors import SceneError
from visualrhp.scene import ObjectShape
from visualrhp.scene.contours import (
    MAX_CONTACT_TOLERANCE,
    MAX_EXACT_VERTICES,
    MAX_VERTICES,
    collision_outline,
    is_number,
    numbers,
    simplify_contour,
    without_straight,
)

BOX = np.array([[0, 0], [0.05, 0], [0.05, 0.03], [0, 0.03]])


def lobes(count: int, noise: float = 0.0, depth: float = 0.012, seed: int = 0) -> np.ndarray:
    """A shape of three lobes with ``count`` vertices."""
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    radii = 0.045 + depth * np.cos(3.0 * angles) + np.random.default_rng(seed).normal(0.0, noise, count)
    return radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def deviation(points: np.ndarray, outline: np.ndarray) -> float:
    return float(shapely.distance(shapely.LinearRing(outline), shapely.points(points)).max())


@pytest.mark.parametrize("radius", range(30, 70, 3))
@pytest.mark.parametrize("tolerance", [2e-4, 5e-4, 1e-3])
def test_pixel_contours(radius: int, tolerance: float) -> None:
    """A disc with a bar, half a millimetre a pixel: no vertex that the simplification leaves is refused afterwards."""
    image = np.zeros((300, 300), np.uint8)
    cv2.circle(image, (150, 150), radius, 255, -1)
    cv2.rectangle(image, (200, 140), (240, 155), 255, -1)
    contours = cv2.findContours(image, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    pixels = max(contours, key=len)  # [N, 1, 2]
    shape = ObjectShape.from_contour(pixels * 5e-4, tolerance)
    assert deviation(pixels[:, 0] * 5e-4, simplify_contour(pixels * 5e-4, tolerance)) <= tolerance * (1 + 1e-9)
    assert shape.area == pytest.approx(shapely.Polygon(pixels[:, 0] * 5e-4).area, rel=0.05)


@pytest.mark.parametrize(
    "given",
    [
        BOX,
        BOX[:, None],
        BOX[None],
        BOX.tolist(),
        tuple(map(tuple, BOX)),
        np.concatenate([BOX, BOX[:1]]),
        BOX[::-1],
        BOX.astype(np.float32),
        BOX.astype(object),
        shapely.box(0, 0, 0.05, 0.03),
        shapely.LinearRing(BOX),
        shapely.MultiPolygon([shapely.box(0, 0, 0.05, 0.03), shapely.box(0.1, 0, 0.11, 0.01)]),
    ],
    ids=range(12),
)
def test_what_people_have(given: Any) -> None:
    assert ObjectShape.from_contour(given).area == pytest.approx(0.05 * 0.03)


def test_a_torch_tensor_is_an_array() -> None:
    torch = pytest.importorskip("torch")
    assert ObjectShape.from_contour(torch.tensor(BOX, requires_grad=False)).area == pytest.approx(0.05 * 0.03)
    with pytest.raises(SceneError, match="array of numbers"):
        ObjectShape.from_contour(torch.tensor(BOX, requires_grad=True))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([[0, 0], [1], [2, 3]], "a contour: an array of numbers is needed, not"),
        ([["0", "a"], ["1", "2"], ["3", "4"]], "an array of numbers"),
        ([["0", "0"], ["1", "2"], ["3", "4"]], "an array of numbers"),
        (shapely.box(0, 0, 0.05, 0.05).wkt, "an array of numbers"),
        ({"points": [[0, 0], [1, 0], [1, 1]]}, "an array of numbers"),
        (None, "an array of numbers"),
        (BOX + 0j, "an array of numbers"),
        (BOX > 0, "an array of numbers"),
        ([[None, 0], [1, 0], [1, 1]], "an array of numbers"),
        (BOX.astype("datetime64[s]"), "an array of numbers"),
        ([[10**400, 0], [1, 0], [1, 1]], "an array of numbers"),
        (np.ma.masked_equal(BOX, 0.05), "an array of numbers"),
        (iter(BOX), "an array of numbers"),
        (3.0, r"at least three points \(x, y\)"),
        ([], "three points"),
        (np.zeros((5, 3)), r"not the shape \[5, 3\]"),
        (np.zeros((2, 5, 2)), "three points"),
        (shapely.Point(0, 0), "not a shapely Point"),
        (shapely.GeometryCollection([shapely.Point(0, 0)]), "not a shapely GeometryCollection"),
        (shapely.Polygon(), "spans no area"),
        (BOX * 1e300, "metres"),
        (np.zeros((300_000, 2)), "at most 200000"),
    ],
    ids=range(22),
)
def test_what_is_no_contour(given: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        ObjectShape.from_contour(given)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("tolerance", [None, "1e-3", True, -1e-3, np.inf, [1e-3], 10**400])
def test_what_is_no_tolerance(tolerance: Any) -> None:
    with pytest.raises(SceneError, match="tolerance"):
        ObjectShape.from_contour(BOX, tolerance)


def test_half_of_a_contour_is_never_dropped() -> None:
    bow_tie = [[0, 0], [0.04, 0.04], [0.04, 0], [0, 0.04]]
    with pytest.raises(SceneError, match="largest has only 50% of the area"):
        ObjectShape.from_contour(bow_tie, 1e-4)
    two = shapely.MultiPolygon([shapely.box(0, 0, 0.05, 0.03), shapely.box(0.1, 0, 0.14, 0.03)])
    with pytest.raises(SceneError, match="2 separate pieces"):
        ObjectShape.from_contour(two)
    with pytest.raises(SceneError, match="holes that make up 64%"):
        ObjectShape.from_contour(shapely.Point(0, 0).buffer(0.05).difference(shapely.Point(0, 0).buffer(0.04)))


@pytest.mark.parametrize("scale", [1000.0, 100.0, 2000.0])
def test_millimetres_and_pixels_are_warned_of(scale: float) -> None:
    with pytest.warns(UserWarning, match=r"is \d+ m long; contours are in metres, .*divide millimetres by 1000"):
        assert ObjectShape.from_contour(BOX * scale, 1e-3 * scale).area == pytest.approx(0.0015 * scale**2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ObjectShape.from_contour(BOX * 10.0)


def test_a_tolerance_that_keeps_too_many_vertices_is_told_a_better_one() -> None:
    with pytest.raises(SceneError, match=rf"an outline has at most {MAX_VERTICES}, so choose .* such as \d+e-\d+ m"):
        simplify_contour(lobes(30_000, 1e-6), 1e-8)
    assert len(simplify_contour(lobes(30_000, 1e-6), 1e-4)) < 100


@pytest.mark.parametrize("seed", range(12))
def test_the_result_is_within_the_tolerance_and_simple(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = lobes(int(rng.integers(50, 1500)), float(rng.choice([0.0, 1e-5, 2e-4, 5e-4])), seed=seed)
    for tolerance in (5e-5, 2e-4, 1e-3):
        contour = shapely.make_valid(shapely.Polygon(points), method="structure")
        if contour.geom_type != "Polygon":
            continue
        ring = shapely.get_coordinates(contour.exterior)
        outline = simplify_contour(points, tolerance)
        assert deviation(ring, outline) <= tolerance * (1 + 1e-9)
        assert shapely.Polygon(outline).is_valid and without_straight(outline, 1e-9) is outline


def test_straight_vertices_are_left_out_at_any_place() -> None:
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    dense = np.array([[0, 0], [0.5, 0], [1, 0], [1, 0.3], [1, 0.7], [1, 1], [0, 1], [0, 0.5]])
    for shift in range(len(dense)):
        left = without_straight(np.roll(dense, shift, axis=0), 1e-9)
        assert sorted(left.tolist()) == sorted(square.tolist())
    assert without_straight(square, 1e-9) is square


def test_few_vertices_collide_exactly_and_many_within_a_tolerance() -> None:
    few = lobes(MAX_EXACT_VERTICES, 1e-5)
    found = collision_outline(few)
    assert found is not None and found[0] is few and found[1] == 0.0
    for count, noise in ((MAX_EXACT_VERTICES + 1, 0.0), (800, 1e-5), (6000, 1e-6), (9000, 1e-5)):
        many = lobes(count, noise)
        found = collision_outline(many)
        assert found is not None
        outline, tolerance = found
        assert len(outline) <= MAX_EXACT_VERTICES // 2 and 0.0 < tolerance <= MAX_CONTACT_TOLERANCE
        assert deviation(many, outline) <= tolerance * 1.001
    assert collision_outline(lobes(900, 1e-3)) is None


def test_numbers_and_is_number() -> None:
    assert numbers([1, 2], "").dtype == np.float64
    assert all(is_number(value) for value in (0, 1.5, np.float32(2), np.int64(3), -1))
    assert not any(is_number(value) for value in (True, np.True_, None, "1", np.nan, np.inf, 1j, [1], 10**400))
