"""The pose of a known outline: a body keeps its shape, and each view only tells where it is.

A planner wants shapes that do not change from view to view. The outline of a body's best view is its *reference*; a
later view is registered to it. If all of the outline is seen, the position is its centre of area, and the rotation is
found by the circular cross-correlation of the distances of the border from the centre. If a part is seen, the pose is
that for which the border that is seen and the border of the reference that should be seen agree.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt
import shapely
from scipy.spatial import KDTree

from visualrhp.embodiment.outlines import largest_piece, planner_outline
from visualrhp.errors import SceneError
from visualrhp.scene import geometry
from visualrhp.scene.scene import ObjectShape
from visualrhp.types import FloatArray, wrap_angle

NUM_ANGLES: Final = 180
"""Angles at which the distance of the border from the centre is compared."""

ROUND: Final = 0.02
"""Relative standard deviation of these distances below which an outline has no rotation that can be seen."""

_TURN_COST: Final = 0.1
"""By how much the correlation has to be better for a rotation by half a turn: outlines are often nearly symmetrical."""

_PRIOR: Final = np.array([5e-3, 5e-3, 5e-6])
"""Weight of staying at the start, in x, y [1] and theta [m^2], against that of the mean square distance of the border:
it decides where the border says nothing, such as the rotation of a circle."""

_OUTLIER: Final = 4e-3
"""Distance [m] from which on a point of the border counts less."""

_ITERATIONS: Final = 30

_POINT_ERROR: Final = 1e-3  # [m]

_THICKENED: Final = 4e-3
"""By which an outline that is too thin to be simulated is enlarged [m]."""

_BORDER: Final = 120  # points of a border that are compared
_LONGEST_STEP: Final = 0.05  # [m]


@dataclass(frozen=True)
class Reference:
    """An outline that later views are registered to.

    Attributes:
        border: [B, 2] fine outline [m], body frame: origin in the centre of area; counter-clockwise.
    """

    border: FloatArray

    @classmethod
    def located(cls, polygon: shapely.Polygon, theta: float = 0.0) -> tuple[Reference, FloatArray]:
        """The reference of an outline in the world frame, and its pose [3] with the given ``theta`` [rad]."""
        ring = shapely.get_coordinates(shapely.orient_polygons(polygon).exterior)[:-1]
        centre = shapely.get_coordinates(polygon.centroid)[0]
        pose = np.array([*centre, theta])
        return cls(geometry.to_body(ring, pose)), pose

    @cached_property
    def shape(self) -> ObjectShape:
        """As the planner uses it, in the same body frame; thickened if a part of it is too thin to be simulated.

        Raises:
            SceneError: the outline is degenerate.
        """
        outline = shapely.Polygon(self.border)
        hull = outline.convex_hull
        for candidate in (outline, hull, hull.buffer(_THICKENED)):
            with contextlib.suppress(SceneError):
                return ObjectShape.centred(planner_outline(largest_piece(candidate)))
        raise SceneError(
            f"an outline of {outline.area:.3g} m^2 at {outline.centroid} is no shape that can be simulated"
        )

    @cached_property
    def samples(self) -> FloatArray:
        """[N, 2] points of the border at equal distances, body frame."""
        return _resampled(self.border, _BORDER)

    @cached_property
    def normals(self) -> FloatArray:
        """[N, 2] of the border at :attr:`samples`, outwards, body frame."""
        along = np.roll(self.samples, -1, axis=0) - np.roll(self.samples, 1, axis=0)
        along /= np.maximum(np.hypot(*along.T), 1e-12)[:, None]
        return np.stack([along[:, 1], -along[:, 0]], axis=1)

    @cached_property
    def distances(self) -> FloatArray:
        """[NUM_ANGLES] of the border from the centre."""
        return radial_distances(self.border)

    @cached_property
    def is_round(self) -> bool:
        """Whether it has no rotation that can be seen."""
        return bool(self.distances.std() < ROUND * self.distances.mean())

    def at(self, pose: npt.ArrayLike) -> shapely.Polygon:
        """The outline in the world frame."""
        return shapely.Polygon(geometry.to_world(self.border, pose))


def radial_distances(border: FloatArray) -> FloatArray:
    """[NUM_ANGLES] distance of a border [N, 2] from the origin, which is inside, in the directions from -pi on [m]."""
    points = _resampled(border, 4 * NUM_ANGLES)
    angles = np.arctan2(points[:, 1], points[:, 0])
    order = np.argsort(angles)
    directions = -np.pi + 2.0 * np.pi * np.arange(NUM_ANGLES) / NUM_ANGLES
    return np.interp(directions, angles[order], np.hypot(*points[order].T), period=2.0 * np.pi)


def register_whole(reference: Reference, polygon: shapely.Polygon, theta: float) -> tuple[FloatArray, float]:
    """The pose of a reference whose whole outline is seen.

    Args:
        reference: of the body.
        polygon: the outline that is seen, world frame [m].
        theta: rotation that is expected [rad]; of several that fit alike, the closest is chosen.

    Returns:
        The pose [3], and the agreement: intersection over union.
    """
    centre = shapely.get_coordinates(polygon.centroid)[0]
    pose = np.array([*centre, theta])
    if not reference.is_round:
        border = shapely.get_coordinates(polygon.exterior)[:-1] - centre
        pose[2] = theta + _best_turn(radial_distances(border), reference.distances, theta)
    pose[2] = wrap_angle(float(pose[2]))
    return pose, overlap(reference.at(pose), polygon)


def _best_turn(seen: FloatArray, known: FloatArray, theta: float) -> float:
    """By how much more than ``theta`` the profile ``known`` has to be turned to fit ``seen`` [rad]."""
    spread = float(np.linalg.norm(seen - seen.mean()) * np.linalg.norm(known - known.mean()))
    if spread == 0.0:
        return 0.0
    product = np.fft.rfft(seen - seen.mean()) * np.conj(np.fft.rfft(known - known.mean()))
    correlation = np.fft.irfft(product, NUM_ANGLES) / spread
    step = 2.0 * np.pi / NUM_ANGLES
    turns = wrap_angle(step * np.arange(NUM_ANGLES, dtype=np.float64) - theta)
    best = int(np.argmax(correlation - _TURN_COST * (turns / np.pi) ** 2))
    # The cost moves the maximum a little: from there, the correlation alone decides.
    while True:
        neighbours = [(best - 1) % NUM_ANGLES, (best + 1) % NUM_ANGLES]
        higher = max(neighbours, key=lambda number: correlation[number])
        if correlation[higher] <= correlation[best]:
            break
        best = higher
    before, at, after = correlation[[best - 1, best, (best + 1) % NUM_ANGLES]].tolist()
    bend = before - 2.0 * at + after
    fraction = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(wrap_angle(turns[best] + step * fraction))


def register_part(
    reference: Reference,
    start: FloatArray,
    border: FloatArray,
    hidden: shapely.Geometry,
) -> tuple[FloatArray, float]:
    """The pose of a reference of which a part is seen: iterated closest points, point to line, robust.

    Args:
        reference: of the body.
        start: [3] pose that is expected.
        border: [N, 2] points of the body's border that are seen [m], world frame; not those at which something else
            hides it.
        hidden: where nothing of the body could be seen, world frame.

    Returns:
        The pose [3], and the mean distance of the borders [m]: of what is seen from the reference, and of the parts of
        the reference that should be seen from what is.
    """
    shapely.prepare(hidden)
    pose = np.array(start, dtype=np.float64)
    if not len(border):
        return pose, math.inf
    seen, known = KDTree(border), KDTree(reference.samples)
    # The body may have moved far: first, its border is moved to the one that is seen.
    pose[:2] += np.clip(_shift(reference, pose, border, hidden), -_LONGEST_STEP, _LONGEST_STEP)
    anchor, distance = pose.copy(), math.inf
    for _ in range(_ITERATIONS):
        samples = geometry.to_world(reference.samples, pose)
        is_visible = ~shapely.contains_xy(hidden, samples[:, 0], samples[:, 1])
        forth, nearest = known.query(geometry.to_body(border, pose))
        back, partner = seen.query(samples[is_visible])
        distance = 0.5 * float(forth.mean()) + 0.5 * float(back.mean() if len(back) else forth.mean())
        numbers = np.concatenate([nearest, np.flatnonzero(is_visible)])
        points = np.concatenate([border, border[partner]])
        weights = np.concatenate([np.full(len(border), 1.0 / len(border)), np.full(len(back), 1.0 / max(len(back), 1))])
        step = _step(reference, pose, points, numbers, weights, anchor)
        pose += step
        if np.abs(step[:2]).max() < 2e-5 and abs(step[2]) < 2e-4:
            break
    pose[2] = wrap_angle(float(pose[2]))
    return pose, distance


def _step(
    reference: Reference,
    pose: FloatArray,
    points: FloatArray,
    numbers: npt.NDArray[np.intp],
    weights: FloatArray,
    anchor: FloatArray,
) -> FloatArray:
    """[3] the change of pose that brings ``points`` closest to the border at the samples ``numbers`` (Gauss-Newton)."""
    normals = reference.normals[numbers]
    local = geometry.to_body(points, pose)
    errors = ((local - reference.samples[numbers]) * normals).sum(axis=1)
    weights = weights / (1.0 + (errors / _OUTLIER) ** 2)
    outwards = normals @ geometry.rotation_matrix(float(pose[2])).T
    slopes = np.column_stack([-outwards, normals[:, 0] * local[:, 1] - normals[:, 1] * local[:, 0]])
    if reference.is_round:
        slopes[:, 2] = 0.0
    system = slopes.T @ (weights[:, None] * slopes) + np.diag(_PRIOR)
    step = np.linalg.solve(system, -slopes.T @ (weights * errors) - _PRIOR * (pose - anchor))
    return step * min(1.0, _LONGEST_STEP / max(float(np.abs(step[:2]).max()), 1e-12), 0.5 / max(abs(step[2]), 1e-12))


def _shift(reference: Reference, pose: FloatArray, border: FloatArray, hidden: shapely.Geometry) -> FloatArray:
    """[2] the median offset of the border that is seen from that of the reference that should be seen."""
    samples = geometry.to_world(reference.samples, pose)
    visible = samples[~shapely.contains_xy(hidden, samples[:, 0], samples[:, 1])]
    if not len(border) or not len(visible):
        return np.zeros(2)
    return np.median(border, axis=0) - np.median(visible, axis=0)


def overlap(first: shapely.Geometry, second: shapely.Geometry) -> float:
    """Intersection over union of two areas."""
    shared = shapely.area(shapely.intersection(first, second))
    return float(shared / max(shapely.area(first) + shapely.area(second) - shared, 1e-12))


def fitted_circle(points: FloatArray, radius: float, spread: float) -> tuple[FloatArray, float]:
    """The circle through points of an arc, of about a known radius (Gauss-Newton).

    Args:
        points: [N, 2], at least three.
        radius: that is expected [m].
        spread: standard deviation of the radius, compared with one of a millimetre of the points [m].

    Returns:
        Centre [2] and radius [m].
    """
    outwards = points.mean(axis=0)
    # The centre lies on the inner side of the arc; a first guess from the circle through all, without a prior.
    offsets = points - outwards
    system = np.column_stack([2.0 * offsets, np.ones(len(points))])
    solution = np.linalg.lstsq(system, (offsets**2).sum(axis=1), rcond=None)[0]
    direction = solution[:2] / max(float(np.hypot(*solution[:2])), 1e-9)
    bulge = float((offsets @ direction).min())  # the farthest point of the arc from the centre
    estimate = np.array([*(outwards + direction * (radius + bulge)), radius])
    weight = (_POINT_ERROR / spread) ** 2
    for _ in range(20):
        away = points - estimate[:2]
        distance = np.maximum(np.hypot(*away.T), 1e-9)
        slopes = np.column_stack([-away / distance[:, None], -np.ones(len(points))])
        errors = distance - estimate[2]
        normal = slopes.T @ slopes + np.diag([1e-9, 1e-9, weight])
        step = np.linalg.solve(normal, -slopes.T @ errors - np.array([0.0, 0.0, weight * (estimate[2] - radius)]))
        estimate = estimate + np.clip(step, -0.02, 0.02)
    return estimate[:2], float(estimate[2])


def _resampled(border: FloatArray, count: int) -> FloatArray:
    """[count, 2] points at equal distances along a closed border [N, 2]."""
    closed = np.concatenate([border, border[:1]])
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    places = np.linspace(0.0, lengths[-1], count, endpoint=False)
    return np.stack([np.interp(places, lengths, closed[:, 0]), np.interp(places, lengths, closed[:, 1])], axis=1)
