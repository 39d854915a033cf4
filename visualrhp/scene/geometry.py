"""Plane geometry of rigid outlines. Lengths in metres, angles in radians, polygons [V, 2] counter-clockwise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from visualrhp.scene.contours import simplify_contour as simplify_contour
from visualrhp.types import FloatArray

CONVEXITY_TOLERANCE = 1e-9
"""Largest turn to the right [rad] at a vertex of a polygon that counts as convex.

An angle, so that it means the same for long and for short edges: a bend of 10 degrees is one whether 5 or 5,000
vertices make it.
"""

_ROUNDING = 4.0 * np.finfo(np.float64).eps
_MANY_VERTICES = 512  # from here on, comparing every edge with every vertex takes longer than sorting them


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
    if turns.min() >= 0.0:
        return True
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    return bool((turns >= -turn_tolerance(lengths, _following(lengths), float(np.abs(polygon).max()))).all())


def turn_tolerance(first: Any, second: Any, extent: float) -> Any:
    """The cross product [m^2] of two consecutive edges of these lengths [m] that still counts as straight on.

    It allows for a turn of :data:`CONVEXITY_TOLERANCE`, and for the rounding of coordinates as large as ``extent`` [m].
    """
    return CONVEXITY_TOLERANCE * first * second + _ROUNDING * extent * (first + second)


def width_range(polygon: FloatArray) -> tuple[float, float]:
    """Smallest and largest width [m] of a polygon over all directions (rotating calipers on its convex hull).

    The smallest width is attained along an edge of the hull, the largest between two of its vertices.
    """
    hull = polygon if is_convex(polygon) else convex_hull(polygon)
    if len(hull) > _MANY_VERTICES:
        farthest = _farthest(hull)  # of each edge, so that its ends and these are the antipodal pairs
        offsets = np.concatenate([hull[farthest] - hull[:, None], hull[farthest] - _following(hull)[:, None]])
    else:
        offsets = hull - hull[:, None]
    return least_width(hull), float(np.hypot(offsets[..., 0], offsets[..., 1]).max())


def least_width(polygon: FloatArray) -> float:
    """Smallest width [m] of a convex, counter-clockwise polygon without duplicate vertices."""
    edges = _following(polygon) - polygon
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    if len(polygon) > _MANY_VERTICES:
        offsets = polygon[_farthest(polygon)] - polygon[:, None]
        heights = edges[:, :1] * offsets[..., 1] - edges[:, 1:] * offsets[..., 0]
        return float((heights.max(axis=1) / lengths).min())
    heights = np.stack([-edges[:, 1], edges[:, 0]], axis=1) @ polygon.T  # [edges, V], times the length of the edge
    return float(((heights.max(axis=1) - heights.diagonal()) / lengths).min())


def _farthest(polygon: FloatArray) -> npt.NDArray[np.intp]:
    """[V, 3] the vertices of a convex polygon of which one is farthest from the line of each edge.

    Edges turn counter-clockwise, so the distance from an edge's line grows up to the first edge that points backwards.
    """
    edges = _following(polygon) - polygon
    angles = np.maximum.accumulate(np.unwrap(np.arctan2(edges[:, 1], edges[:, 0])))
    turned = np.concatenate([angles, angles + 2.0 * np.pi])
    peak = np.searchsorted(turned, angles + np.pi)
    return (peak[:, None] + (-1, 0, 1)) % len(polygon)


def convex_hull(points: FloatArray) -> FloatArray:
    """Vertices [V, 2] of the convex hull, counter-clockwise."""
    hull = shapely.MultiPoint(points).convex_hull
    return shapely.get_coordinates(shapely.orient_polygons(hull))[:-1]


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


def contains_each(polygon: FloatArray, points: FloatArray) -> npt.NDArray[np.bool_]:
    """[N] whether each of the points [N, 2] lies within a simple polygon, by the rule of :func:`contains`."""
    x1, y1 = polygon.T
    x0, y0 = np.roll(polygon, 1, axis=0).T
    inside = np.zeros(len(points), dtype=bool)
    for number, (x, y) in enumerate(points.tolist()):
        crossed = (y0 > y) != (y1 > y)
        at = x0[crossed] + (y - y0[crossed]) * (x1[crossed] - x0[crossed]) / (y1[crossed] - y0[crossed])
        inside[number] = np.count_nonzero(x < at) % 2 == 1
    return inside
