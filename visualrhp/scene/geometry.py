"""Plane geometry of rigid outlines. Lengths in metres, angles in radians, polygons [V, 2] counter-clockwise."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import shapely

from visualrhp.errors import SceneError
from visualrhp.types import FloatArray

CONVEXITY_TOLERANCE = -1e-12
"""Least cross product of two consecutive edges [m^2] in a polygon that counts as convex."""


def rotation_matrix(angle: float) -> FloatArray:
    """[2, 2] matrix that rotates a vector counter-clockwise by ``angle`` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def to_world(points: FloatArray, pose: npt.ArrayLike) -> FloatArray:
    """Transform points [..., 2] from the frame of a body at ``pose`` (x [m], y [m], theta [rad]) to the world."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    return points @ rotation_matrix(theta).T + (x, y)


def to_body(points: FloatArray, pose: npt.ArrayLike) -> FloatArray:
    """Transform points [..., 2] from the world frame to the frame of a body: the inverse of :func:`to_world`."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    return (points - (x, y)) @ rotation_matrix(theta)


def _following(polygon: FloatArray) -> FloatArray:
    """[V, 2] the vertex after each vertex (np.roll takes five times as long on a few vertices)."""
    return np.concatenate([polygon[1:], polygon[:1]])


def signed_area(polygon: FloatArray) -> float:
    """Area [m^2] of a simple polygon, positive for counter-clockwise vertices (shoelace formula)."""
    following = _following(polygon)
    return 0.5 * float(np.sum(polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]))


def centroid(polygon: FloatArray) -> FloatArray:
    """[2] centre of area of a simple polygon."""
    following = _following(polygon)
    cross = polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]
    return ((polygon + following) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())


def second_moment_of_area(polygon: FloatArray) -> float:
    """Polar second moment of area about the origin [m^4], the integral of r^2 over a simple polygon."""
    following = _following(polygon)
    cross = polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]
    squares = (polygon**2 + polygon * following + following**2).sum(axis=1)
    return float(np.sum(cross * squares)) / 12.0


def first_moment_of_distance(polygon: FloatArray) -> float:
    """The integral of r, the distance from the origin, over a simple polygon [m^3].

    Times friction, area density and gravity, it is the torque with which Coulomb friction under uniform pressure
    resists rotation about the origin. Each edge spans a triangle with the origin; with p its distance from the edge's
    line and phi the angle from the foot of the perpendicular, the integral over it is
    p^3 / 6 [sec tan + asinh(tan)] in phi. The triangle counts as negative when the origin lies to the right of the
    edge, as in non-convex polygons.
    """
    total = 0.0
    for start, end in zip(polygon, _following(polygon), strict=True):
        edge = end - start
        length = math.hypot(*edge)
        if length == 0.0:
            continue
        along = edge / length
        distance = abs(float(start[0] * along[1] - start[1] * along[0]))
        if distance < 1e-12:
            continue
        tangents = (float(end @ along) / distance, float(start @ along) / distance)
        high, low = (t * math.sqrt(1.0 + t * t) + math.asinh(t) for t in tangents)
        moment = distance**3 / 6.0 * (high - low)
        total += moment if start[0] * along[1] > start[1] * along[0] else -moment
    return total


def is_convex(polygon: FloatArray) -> bool:
    """Whether a simple, counter-clockwise polygon is convex, up to rounding (:data:`CONVEXITY_TOLERANCE`)."""
    edges = _following(polygon) - polygon
    following = _following(edges)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    return bool(turns.min() >= CONVEXITY_TOLERANCE)


def width_range(polygon: FloatArray) -> tuple[float, float]:
    """Smallest and largest width [m] of a polygon over all directions (rotating calipers on its convex hull).

    The smallest width is attained along an edge of the hull, the largest between two of its vertices.
    """
    hull = polygon if is_convex(polygon) else convex_hull(polygon)
    offsets = hull - hull[:, None]
    return least_width(hull), float(np.hypot(offsets[..., 0], offsets[..., 1]).max())


def least_width(polygon: FloatArray) -> float:
    """Smallest width [m] of a convex, counter-clockwise polygon without duplicate vertices."""
    edges = _following(polygon) - polygon
    heights = np.stack([-edges[:, 1], edges[:, 0]], axis=1) @ polygon.T  # [edges, V], times the length of the edge
    return float(((heights.max(axis=1) - heights.diagonal()) / np.hypot(edges[:, 0], edges[:, 1])).min())


def convex_hull(points: FloatArray) -> FloatArray:
    """Vertices [V, 2] of the convex hull, counter-clockwise."""
    hull = shapely.MultiPoint(points).convex_hull
    return shapely.get_coordinates(shapely.orient_polygons(hull))[:-1]


def simplify_contour(points: npt.ArrayLike, tolerance: float) -> FloatArray:
    """A simple polygon [V, 2], counter-clockwise, with few vertices, from a camera contour.

    The contour may have either orientation, end with its first point, repeat points and touch itself; of several pieces
    the largest is used, and holes are filled. No point of the contour's border is farther than ``tolerance`` [m] from
    the border of the result.

    Raises:
        SceneError: the points are not a finite array [N, 2] or span no area, or the tolerance is not positive.
    """
    contour = np.asarray(points, dtype=np.float64)
    if not (math.isfinite(tolerance) and tolerance > 0.0):
        raise SceneError(f"the tolerance of a contour must be positive [m], not {tolerance}")
    if contour.ndim != 2 or contour.shape[1] != 2 or len(contour) < 3:
        raise SceneError(f"a contour has at least three points (x, y), not the shape {list(contour.shape)}")
    if not np.isfinite(contour).all():
        raise SceneError("a contour has a point that is not finite")
    pieces = shapely.get_parts(shapely.make_valid(shapely.Polygon(contour), method="structure"))
    pieces = [piece for piece in pieces if isinstance(piece, shapely.Polygon) and piece.area > 0.0]
    if not pieces:
        raise SceneError(f"a contour of {len(contour)} points spans no area")
    ring = shapely.get_coordinates(max(pieces, key=lambda piece: piece.area).exterior)[:-1]
    # Simplification keeps the ring's first vertex, so it should be a corner.
    first = int(np.argmax(np.hypot(*(ring - ring.mean(axis=0)).T)))
    simple = shapely.simplify(shapely.Polygon(np.roll(ring, -first, axis=0)), tolerance)
    return shapely.get_coordinates(shapely.orient_polygons(simple))[:-1]


def contains(polygon: FloatArray | list[list[float]], x: float, y: float) -> bool:
    """Whether the point lies within a simple polygon (even-odd rule; the border counts by the half-open rule)."""
    inside = False
    vertices = polygon.tolist() if isinstance(polygon, np.ndarray) else polygon
    x0, y0 = vertices[-1]
    for x1, y1 in vertices:
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
        x0, y0 = x1, y1
    return inside
