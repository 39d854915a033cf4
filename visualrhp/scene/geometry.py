"""Plane geometry of rigid outlines. Lengths in metres, angles in radians, polygons [V, 2] counter-clockwise."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from visualrhp.types import FloatArray


def rotation_matrix(angle: float) -> FloatArray:
    """[2, 2] matrix that turns a vector counter-clockwise by ``angle`` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def to_world(points: FloatArray, pose: npt.ArrayLike) -> FloatArray:
    """Points [..., 2] of a body frame in the world frame, for the body's ``pose`` (x [m], y [m], theta [rad])."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    return points @ rotation_matrix(theta).T + (x, y)


def to_body(points: FloatArray, pose: npt.ArrayLike) -> FloatArray:
    """Points [..., 2] of the world frame in the frame of a body with ``pose``: the inverse of :func:`to_world`."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    return (points - (x, y)) @ rotation_matrix(theta)


def signed_area(polygon: FloatArray) -> float:
    """Area [m^2] of a simple polygon, positive when its vertices run counter-clockwise (shoelace formula)."""
    following = np.roll(polygon, -1, axis=0)
    return 0.5 * float(np.sum(polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]))


def centroid(polygon: FloatArray) -> FloatArray:
    """[2] centre of area of a simple polygon."""
    following = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]
    return ((polygon + following) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())


def second_moment_of_area(polygon: FloatArray) -> float:
    """Polar second moment of area about the origin [m^4], the integral of r^2 over a simple polygon."""
    following = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]
    squares = (polygon**2 + polygon * following + following**2).sum(axis=1)
    return float(np.sum(cross * squares)) / 12.0


def first_moment_of_distance(polygon: FloatArray) -> float:
    """The integral of r, the distance from the origin, over a simple polygon [m^3].

    Times friction, area density and gravity, it is the torque with which Coulomb friction under uniform pressure
    resists a turn about the origin. Each edge spans a triangle with the origin; with p its distance from the edge's
    line and phi the angle from the foot of the perpendicular, the integral over it is
    p^3 / 6 [sec tan + asinh(tan)] in phi.
    """
    total = 0.0
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        edge = end - start
        length = math.hypot(*edge)
        if length == 0.0:
            continue
        along = edge / length
        distance = float(start[0] * along[1] - start[1] * along[0])
        if abs(distance) < 1e-12:
            continue
        tangents = (float(end @ along) / distance, float(start @ along) / distance)
        high, low = (t * math.sqrt(1.0 + t * t) + math.asinh(t) for t in tangents)
        total += distance**3 / 6.0 * (high - low)
    return total


def contains(polygon: FloatArray, x: float, y: float) -> bool:
    """Whether the point lies within a simple polygon (even-odd rule; the border counts by the half-open rule)."""
    inside = False
    vertices = polygon.tolist()
    x0, y0 = vertices[-1]
    for x1, y1 in vertices:
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
        x0, y0 = x1, y1
    return inside
