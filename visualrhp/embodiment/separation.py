"""Move what is seen apart until a planner can start from it.

Outlines are seen with an error of a few millimetres, so that bodies which touch may overlap, which no state of a
simulator does. The smallest motions that separate them are found by repeated projection: of two convex parts that
overlap, the direction in which they overlap least is known, and along it they are moved apart. The gripper's pose is
known much better and stays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from visualrhp.scene import geometry
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.scene import ObjectShape
from visualrhp.types import FloatArray

MAX_OVERLAP: Final = 5e-4
"""Overlap that is left [m]; a planner's start may have four times as much (:mod:`visualrhp.scene.start`)."""

MAX_MOTION: Final = 0.015
"""By which an object is moved at most [m]."""

_ROUNDS: Final = 60
_RELAXED: Final = 30
"""Rounds after which motions are made larger, for bodies that are pushed from both sides."""


def penetration(first: FloatArray, second: FloatArray) -> tuple[float, FloatArray]:
    """How deep two convex polygons overlap, and in which direction the first has to move to end it.

    Args:
        first: [V, 2] counter-clockwise [m].
        second: [W, 2] counter-clockwise [m].

    Returns:
        The depth [m], negative if they are apart, and a unit vector [2].
    """
    normals = np.concatenate([_normals(first), -_normals(second)])
    of_first, of_second = first @ normals.T, second @ normals.T
    # The first lies behind its own edges, and moves back along their normals; the second has the opposite ones.
    depths = of_first.max(axis=0) - of_second.min(axis=0)
    least = int(np.argmin(depths))
    return float(depths[least]), -normals[least]


def separated(
    shapes: Sequence[ObjectShape],
    poses: FloatArray,
    gripper: Gripper,
    gripper_pose: npt.ArrayLike,
    opening: float,
    held: Sequence[int] = (),
    limit: float = MAX_MOTION,
) -> tuple[FloatArray, float]:
    """Poses and an opening with which bodies overlap by less than :data:`MAX_OVERLAP`, close to those given.

    Args:
        shapes: of the objects.
        poses: [m, 3] of the objects.
        gripper: its geometry.
        gripper_pose: [3].
        opening: that is measured [m].
        held: indices of objects between the fingers: the fingers are as far apart as these are wide.
        limit: distance [m] by which an object is moved at most. An overlap that needs more is left in part: it comes
            from outlines that are larger than the bodies, and the simulator pushes such bodies apart by itself.

    Returns:
        Poses [m, 3], and the opening [m].
    """
    moved = np.array(poses, dtype=np.float64)
    pose = np.asarray(gripper_pose, dtype=np.float64)
    for index in held:
        opening = _between_fingers(shapes[index], moved[index], gripper, pose, opening)
    fixed = list(gripper.outlines(pose, opening))
    radii = np.array([np.hypot(*shape.outline.T).max() for shape in shapes])
    for number in range(_ROUNDS):
        gain = 1.0 if number < _RELAXED else 1.3
        parts = [
            [geometry.to_world(part, at) for part in shape.convex_parts]
            for shape, at in zip(shapes, moved, strict=True)
        ]
        shifts = np.zeros((len(shapes), 2))
        for index, other in _close_pairs(moved[:, :2], radii):
            shift = _deepest(parts[index], parts[other])
            shifts[index] += 0.5 * gain * shift
            shifts[other] -= 0.5 * gain * shift
        for index in range(len(shapes)):
            for outline in fixed:
                shifts[index] += gain * _deepest(parts[index], [outline])
        if not shifts.any():
            break
        moved[:, :2] += shifts
    ways = moved[:, :2] - np.asarray(poses, dtype=np.float64)[:, :2]
    lengths = np.hypot(*ways.T)
    moved[:, :2] -= ways * np.maximum(0.0, 1.0 - limit / np.maximum(lengths, 1e-12))[:, None]
    return moved, opening


def _between_fingers(shape: ObjectShape, at: FloatArray, gripper: Gripper, pose: FloatArray, opening: float) -> float:
    """Centre a held object between the fingers, if it is as wide as their opening; return an opening that holds it.

    ``at`` is changed."""
    local = geometry.to_body(geometry.to_world(shape.outline, at), pose)
    back, front = gripper.finger_reach - gripper.finger_length, gripper.finger_reach
    within = _clipped(local, back, front)
    if not len(within):
        return opening
    right, left = float(within[:, 1].min()), float(within[:, 1].max())
    widened = min(max(opening, left - right), gripper.stroke)
    shift = 0.0
    if left - right >= opening - 2.0 * MAX_OVERLAP:
        shift = -0.5 * (left + right)
    elif left > 0.5 * opening:
        shift = 0.5 * opening - left
    elif right < -0.5 * opening:
        shift = -0.5 * opening - right
    at[:2] += geometry.rotation_matrix(float(pose[2])) @ (0.0, shift)
    return widened


def _clipped(outline: FloatArray, low: float, high: float) -> FloatArray:
    """[N, 2] vertices of an outline with low <= x <= high, and where its edges cross these lines."""
    points = [vertex for vertex in outline if low <= vertex[0] <= high]
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        for border in (low, high):
            if (start[0] - border) * (end[0] - border) < 0.0:
                points.append(start + (border - start[0]) / (end[0] - start[0]) * (end - start))
    return np.array(points).reshape(-1, 2)


def _close_pairs(positions: FloatArray, radii: FloatArray) -> Iterator[tuple[int, int]]:
    for index in range(len(positions)):
        for other in range(index):
            if np.hypot(*(positions[index] - positions[other])) < radii[index] + radii[other]:
                yield index, other


def _deepest(first: Sequence[FloatArray], second: Sequence[FloatArray]) -> FloatArray:
    """[2] the motion of the first body that ends the deepest overlap of a pair of parts; zero if none is too deep."""
    depth, direction = max(
        (penetration(part, other) for part in first for other in second), key=lambda overlap: overlap[0]
    )
    return (depth - 0.5 * MAX_OVERLAP) * direction if depth > MAX_OVERLAP else np.zeros(2)


def _normals(polygon: FloatArray) -> FloatArray:
    """[V, 2] outward unit normals of the edges of a counter-clockwise polygon."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    edges /= np.hypot(*edges.T)[:, None]
    return np.stack([edges[:, 1], -edges[:, 0]], axis=1)
