"""Placement of objects on a surface by rejection sampling, apart from each other, from the gripper and the edges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import shapely

from visualrhp.scene import geometry
from visualrhp.types import FloatArray

if TYPE_CHECKING:
    from visualrhp.scene.sampling import Layout, SceneDistribution
    from visualrhp.scene.scene import TargetRegion

CORNER_DISTANCE = 0.09
"""Largest distance of the desired object's centre from a corner [m] in the layout ``object_in_corner``."""

_ATTEMPTS_PER_OBJECT = 100
_MARGIN = 1e-9  # within which circles do not decide [m]


class _Occupied:
    """The bodies that are in place, each with two circles around its centre: one within it, and one around it."""

    def __init__(self, obstacles: Sequence[FloatArray]) -> None:
        self._bodies: list[shapely.Polygon] = [shapely.Polygon(outline) for outline in obstacles]
        self._circles = [_circles(outline, outline.mean(axis=0)) for outline in obstacles]

    def add(self, body: shapely.Polygon, circles: tuple[float, float, float, float]) -> None:
        self._bodies.append(body)
        self._circles.append(circles)

    def is_close(self, x: float, y: float, inner: float, clearance: float) -> bool:
        """Whether a body with a circle of radius ``inner`` at (x, y) is certainly too close to another."""
        reach = inner + clearance - _MARGIN
        return any(math.hypot(x - a, y - b) < reach + within for a, b, within, _ in self._circles)

    def is_clear(self, body: shapely.Polygon, x: float, y: float, outer: float, clearance: float) -> bool:
        """Whether a body with a circle of radius ``outer`` around (x, y) is at ``clearance`` [m] from all others."""
        reach = outer + clearance + _MARGIN
        near = [
            other
            for other, (a, b, _, around) in zip(self._bodies, self._circles, strict=True)
            if math.hypot(x - a, y - b) <= reach + around
        ]
        if not near:
            return True
        distances = shapely.distance(body, near)  # 0 of bodies that overlap
        return bool(((distances >= clearance) & (distances > 0.0)).all())


def _circles(outline: FloatArray, centre: FloatArray) -> tuple[float, float, float, float]:
    """Of a convex outline: x and y of ``centre`` [m], the largest radius within it, and the least around it."""
    offsets = outline - centre
    edges = np.concatenate([offsets[1:], offsets[:1]]) - offsets
    heights = edges[:, 1] * offsets[:, 0] - edges[:, 0] * offsets[:, 1]
    inner = float((heights / np.hypot(edges[:, 0], edges[:, 1])).min())
    x, y = centre.tolist()
    return x, y, inner, float(np.hypot(offsets[:, 0], offsets[:, 1]).max())


def place_objects(
    distribution: SceneDistribution,
    outlines: Sequence[FloatArray],
    edges: FloatArray,
    target: TargetRegion,
    obstacles: Sequence[FloatArray],
    rng: np.random.Generator,
) -> FloatArray | None:
    """[m, 3] poses by rejection sampling, or None if there was no place for an object.

    Args:
        distribution: clearance and layout.
        outlines: of the convex objects, centred [V, 2]; the desired one first.
        edges: [4, 2] of the square surface.
        target: outside which the desired object starts.
        obstacles: convex outlines [V, 2] in the world frame.
        rng: source of the random numbers.
    """
    clearance = distribution.clearance
    low, high = float(edges.min()), float(edges.max())
    surface = shapely.Polygon(edges).buffer(-clearance if clearance > 1e-12 else 0.0)  # of -1e-320, it would be empty
    occupied = _Occupied(obstacles)
    poses = []
    for number, outline in enumerate(outlines):
        _, _, inner, outer = _circles(outline, np.zeros(2))
        margin = inner + clearance - _MARGIN  # an object whose centre is closer to an edge is not on the surface
        for _ in range(_ATTEMPTS_PER_OBJECT):
            x, y = sample_position(low, high, rng)
            angle = rng.uniform(-np.pi, np.pi)
            if not (low + margin <= min(x, y) and max(x, y) <= high - margin):
                continue
            if number == 0 and not _may_start(distribution.layout, np.array([x, y]), edges, target):
                continue
            if occupied.is_close(x, y, inner, clearance):
                continue
            pose = np.array([x, y, angle])
            body = shapely.Polygon(geometry.to_world(outline, pose))
            if surface.contains(body) and occupied.is_clear(body, x, y, outer, clearance):
                occupied.add(body, (x, y, inner, outer))
                poses.append(pose)
                break
        else:
            return None
    return np.array(poses)


def sample_position(low: float, high: float, rng: np.random.Generator) -> tuple[float, float]:
    """A point that is uniform over a square surface, whose coordinates [m] are between ``low`` and ``high``."""
    x = y = high
    for _ in range(_ATTEMPTS_PER_OBJECT):
        x, y = rng.uniform(low, high), rng.uniform(low, high)
        if x < high and y < high:  # rounding can reach the border, which does not belong to the surface
            break
    return x, y


def _may_start(layout: Layout, position: FloatArray, edges: FloatArray, target: TargetRegion) -> bool:
    """Whether the desired object may start with its centre at ``position`` [2]."""
    if np.hypot(*(position - target.position)) <= target.radius:
        return False
    return layout != "object_in_corner" or bool(np.linalg.norm(edges - position, axis=1).min() <= CORNER_DISTANCE)
