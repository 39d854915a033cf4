"""Outlines from camera contours: what people have, made into a simple polygon with few vertices."""

from __future__ import annotations

import functools
import math
import reprlib
import warnings
from typing import Any

import numpy as np
import shapely

from visualrhp.errors import SceneError
from visualrhp.types import FloatArray

MAX_VERTICES = 10_000
"""Largest number of vertices of an outline or a surface."""

MAX_CONTOUR_POINTS = 200_000
"""Largest number of points of a contour."""

PLAUSIBLE_SIZE = 1.0
"""Extent of an object [m] above which its contour is probably in millimetres or pixels."""

LEAST_SHARE = 0.75
"""Least share of the area that a contour encloses which its largest piece, without holes, must have."""

MAX_EXACT_VERTICES = 400
"""Largest number of vertices of an outline that is not convex and collides exactly as drawn."""

MAX_CONTACT_TOLERANCE = 2.5e-4
"""Largest deviation [m] of the outline that collides from one with more vertices: half the overlap that the solver
leaves."""

_REDUCED_VERTICES = 200
_LEAST_REDUCTION = 1e-6
_STRAIGHT = 2e-9  # vertices this close [m] to the line of their neighbours are left out
_RETRIES = 6
_NO_NUMBERS = (bool, str, bytes, complex, type(None))


def simplify_contour(points: Any, tolerance: float) -> FloatArray:
    """A simple polygon [V, 2], counter-clockwise, with few vertices, from a camera contour.

    The contour may have either orientation, end with its first point, repeat points and touch itself; of several pieces
    the largest is used, and holes are filled. No point of the border of that piece is farther than ``tolerance`` [m]
    from the border of the result.

    Args:
        points: an array or a list of points [N, 2], OpenCV's contour [N, 1, 2], or a shapely polygon or ring; metres.
        tolerance: [m].

    Raises:
        SceneError: ``points`` is no contour, spans no area, or consists of pieces or holes of which the result would
            leave out or fill more than a quarter of the area; the tolerance is not positive, or so small that more than
            :data:`MAX_VERTICES` vertices would remain.

    Warns:
        UserWarning: the contour is larger than :data:`PLAUSIBLE_SIZE`.
    """
    if not (is_number(tolerance) and tolerance > 0.0):
        raise SceneError(f"the tolerance of a contour must be positive [m], not {tolerance!r:.100}")
    given = _as_geometry(points)
    _warn_of_size(given)
    border = _largest_piece(given)
    wanted = float(tolerance)
    for _ in range(_RETRIES):
        outline = _simplified(border, wanted)
        if outline is not None and _deviation(border, outline) <= tolerance * (1.0 + 1e-9):
            break
        wanted *= 0.5  # it crosses itself, or GEOS left out the vertex where the ring begins without regard to it
    else:
        raise SceneError(
            f"a contour of {len(border)} points has no simple outline within a tolerance of {tolerance:g} m; smooth it "
            "or choose another tolerance"
        )
    if len(outline) > MAX_VERTICES:
        raise SceneError(
            f"a contour of {len(border)} points keeps {len(outline)} vertices with a tolerance of {tolerance:g} m; an "
            f"outline has at most {MAX_VERTICES}, so choose a larger tolerance, such as {_enough(border, wanted):.1g} m"
        )
    return outline


def _as_geometry(points: Any) -> shapely.Geometry:
    """A shapely polygon, valid or not, or several polygons."""
    if isinstance(points, shapely.Polygon | shapely.MultiPolygon):
        coordinates = shapely.get_coordinates(points)
        _check_points(coordinates)
        return points
    if isinstance(points, shapely.LinearRing | shapely.LineString):
        points = shapely.get_coordinates(points)
    if isinstance(points, shapely.Geometry):
        raise SceneError(f"a contour is a polygon or a ring of points, not a shapely {type(points).__name__}")
    contour = numbers(points, "a contour")
    if contour.ndim == 3 and contour.shape[1] == 1:  # OpenCV's
        contour = contour[:, 0]
    if contour.ndim == 3 and contour.shape[0] == 1:
        contour = contour[0]
    if contour.ndim != 2 or contour.shape[1] != 2 or len(contour) < 3:
        raise SceneError(
            f"a contour has at least three points (x, y), as an array [N, 2], a list, or OpenCV's [N, 1, 2], not the "
            f"shape {list(contour.shape)}"
        )
    _check_points(contour)
    return shapely.Polygon(contour)


def numbers(values: Any, what: str) -> FloatArray:
    """``values`` as a float64 array; booleans, text, complex numbers and dates are no numbers.

    Raises:
        SceneError: they are not, or lists of different lengths; the message starts with ``what``.
    """
    try:
        array = np.asarray(values)
        is_numeric = array.dtype.kind in "iuf" or (
            array.dtype.kind == "O" and not any(isinstance(each, _NO_NUMBERS) for each in array.flat)
        )
        if is_numeric and not np.ma.is_masked(values):
            return array.astype(np.float64)
        reason = None
    except (TypeError, ValueError, OverflowError, AttributeError, RuntimeError) as error:
        reason = error
    start = f"{what}: " if what else ""
    raise SceneError(f"{start}an array of numbers is needed, not {reprlib.repr(values):.200}") from reason


def is_number(value: Any) -> bool:
    """Whether ``value`` is a finite real number, of Python or NumPy; a boolean is none."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _check_points(contour: FloatArray) -> None:
    if len(contour) > MAX_CONTOUR_POINTS:
        raise SceneError(f"a contour has {len(contour)} points; at most {MAX_CONTOUR_POINTS} can be simplified")
    if not np.isfinite(contour).all():
        raise SceneError("a contour has a point that is not finite")
    if np.abs(contour).max(initial=0.0) > 1e6:
        raise SceneError(
            f"a contour has the coordinate {np.abs(contour).max():g}; coordinates are in metres, at most 1e6"
        )


def _warn_of_size(given: shapely.Geometry) -> None:
    low_x, low_y, high_x, high_y = shapely.bounds(given).tolist()  # NaN if it is empty
    extent = max(high_x - low_x, high_y - low_y)
    if extent > PLAUSIBLE_SIZE:
        warnings.warn(
            f"a contour is {extent:.3g} m long; contours are in metres, and an object of this size is implausible "
            f"(divide millimetres by 1000, and multiply pixels by the size of a pixel)",
            UserWarning,
            stacklevel=4,
        )


def _largest_piece(given: shapely.Geometry) -> FloatArray:
    """[N, 2] the border of the largest polygon that a contour encloses, without its holes, from a corner on."""
    pieces = shapely.get_parts(shapely.make_valid(given, method="structure"))
    pieces = [piece for piece in shapely.get_parts(pieces) if isinstance(piece, shapely.Polygon) and piece.area > 0.0]
    if not pieces:
        raise SceneError(f"a contour of {len(shapely.get_coordinates(given))} points spans no area")
    largest = max(pieces, key=lambda piece: piece.area)
    filled = shapely.Polygon(largest.exterior)
    enclosed = sum(piece.area for piece in pieces)
    if largest.area < LEAST_SHARE * enclosed:
        raise SceneError(
            f"a contour crosses itself or has {len(pieces)} separate pieces, of which the largest has only "
            f"{100.0 * largest.area / enclosed:.0f}% of the area; an object is one piece, so give one contour for each"
        )
    if largest.area < LEAST_SHARE * filled.area:
        raise SceneError(
            f"a contour has holes that make up {100.0 - 100.0 * largest.area / filled.area:.0f}% of its area; objects "
            "have none, so cut it open or give the border alone"
        )
    ring = shapely.get_coordinates(filled.exterior)[:-1]
    # Simplification keeps the ring's first vertex, so it should be a corner.
    first = int(np.argmax(np.hypot(*(ring - ring.mean(axis=0)).T)))
    return np.roll(ring, -first, axis=0)


def _simplified(border: FloatArray, tolerance: float) -> FloatArray | None:
    """Fewer vertices of a polygon, counter-clockwise, none straight; None if the polygon would not be simple."""
    simple = shapely.simplify(shapely.Polygon(border), tolerance)
    outline = without_straight(shapely.get_coordinates(shapely.orient_polygons(simple))[:-1], _STRAIGHT)
    return outline if len(outline) >= 3 and shapely.Polygon(outline).is_valid else None


def without_straight(polygon: FloatArray, tolerance: float) -> FloatArray:
    """Leave out vertices within ``tolerance`` [m] of the line through their neighbours."""
    vertices = polygon.tolist()
    kept: list[list[float]] = []
    count = len(vertices)
    for number, (x, y) in enumerate(vertices):
        before = kept[-1] if kept else vertices[-1]
        after = vertices[number + 1] if number + 1 < count else (kept[0] if kept else vertices[0])
        if not _is_straight(before, (x, y), after, tolerance):
            kept.append([x, y])
    while len(kept) > 3 and _is_straight(kept[-1], kept[0], kept[1], tolerance):
        del kept[0]
    while len(kept) > 3 and _is_straight(kept[-2], kept[-1], kept[0], tolerance):
        del kept[-1]
    return polygon if len(kept) == count else np.array(kept).reshape(-1, 2)


def _is_straight(before: Any, at: Any, after: Any, tolerance: float) -> bool:
    chord_x, chord_y = after[0] - before[0], after[1] - before[1]
    turn = abs(chord_x * (at[1] - before[1]) - chord_y * (at[0] - before[0]))
    return turn <= tolerance * math.hypot(chord_x, chord_y)


def collision_outline(outline: FloatArray) -> tuple[FloatArray, float] | None:
    """The outline as it collides, and how far [m] it deviates at most; None if it is too rough to have one.

    It is the outline itself if that has at most :data:`MAX_EXACT_VERTICES`, and otherwise the closest of those with
    half as many vertices or fewer: the time to decompose an outline and to simulate its parts grows with its vertices.
    """
    if len(outline) <= MAX_EXACT_VERTICES:
        return outline, 0.0
    return _reduced(np.ascontiguousarray(outline).tobytes())


@functools.lru_cache(maxsize=16)  # an outline is checked, placed and decomposed
def _reduced(vertices: bytes) -> tuple[FloatArray, float] | None:
    border = np.frombuffer(vertices).reshape(-1, 2)
    polygon, tolerance = shapely.Polygon(border), _LEAST_REDUCTION
    while tolerance <= MAX_CONTACT_TOLERANCE:
        if shapely.get_num_coordinates(shapely.simplify(polygon, tolerance)) <= _REDUCED_VERTICES:
            reduced = _simplified(border, tolerance)
            # Where a ring begins, GEOS leaves out a vertex without regard to its tolerance.
            if reduced is not None and (deviation := _deviation(border, reduced)) <= MAX_CONTACT_TOLERANCE:
                reduced.setflags(write=False)
                return reduced, deviation
        tolerance *= 1.5
    return None


def _deviation(border: FloatArray, outline: FloatArray) -> float:
    """The largest distance [m] of a point of ``border`` from the border of ``outline``."""
    ring = shapely.LinearRing(outline)
    shapely.prepare(ring)
    return float(np.asarray(shapely.distance(ring, shapely.points(border))).max())


def _enough(border: FloatArray, tolerance: float) -> float:
    """A tolerance [m] that leaves a number of vertices that is allowed."""
    for _ in range(40):
        tolerance *= 2.0
        outline = _simplified(border, tolerance)
        if outline is not None and len(outline) <= MAX_VERTICES:
            break
    return tolerance


__all__ = [
    "LEAST_SHARE",
    "MAX_CONTACT_TOLERANCE",
    "MAX_CONTOUR_POINTS",
    "MAX_EXACT_VERTICES",
    "MAX_VERTICES",
    "PLAUSIBLE_SIZE",
    "collision_outline",
    "is_number",
    "numbers",
    "simplify_contour",
    "without_straight",
]
