"""The abstract colour-labelled, robot-centric image of a state (paper, Sec. 5.1).

The image turns and moves with the gripper: its forward axis points up, its left axis left, and the origin of the
gripper frame is always at the same pixel. It is kept as one byte of label a pixel and coloured only where a network or
a person reads it.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Final

import cv2
import numpy as np

from visualrhp.scene.scene import Scene
from visualrhp.types import FloatArray, LabelImage, State

IMAGE_SIZE: Final = 64
"""Pixels a side (Sec. 7.2)."""

VIEW_SIDE: Final = 0.72
"""Side of the square that the image shows [m]."""

VIEW_BEHIND: Final = 0.26
"""How far the image reaches behind the origin of the gripper frame [m]: the paper's constant offset."""

_PIXELS_PER_METRE = IMAGE_SIZE / VIEW_SIDE
_SUBPIXEL_BITS = 6
_SUBPIXELS = 1 << _SUBPIXEL_BITS
# Pixel centres are at whole coordinates in OpenCV: the left border of the image is at -0.5.
_ORIGIN_COLUMN = IMAGE_SIZE / 2 - 0.5
_ORIGIN_ROW = IMAGE_SIZE - VIEW_BEHIND * _PIXELS_PER_METRE - 0.5
_ANGLES: Final = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
_CIRCLE: Final = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


class Label(IntEnum):
    """What a pixel shows; the index of its colour in :data:`PALETTE`."""

    BACKGROUND = 0
    EDGE = 1
    TARGET = 2
    OBSTACLE = 3
    DESIRED_OBJECT = 4
    ROBOT = 5


PALETTE: Final = np.array(
    [
        [255, 255, 255],  # background: white
        [0, 0, 0],  # beyond the surface edges: black
        [0, 100, 0],  # target region: dark green
        [255, 0, 0],  # obstacle objects: red
        [144, 238, 144],  # desired object: light green
        [0, 0, 255],  # end-effector: blue
    ],
    dtype=np.uint8,
)
"""[6, 3] RGB colour of each label (Sec. 5.1)."""


def label_image(scene: Scene, state: State) -> LabelImage:
    """Draw the abstract image of ``state``.

    Returns:
        [64, 64] uint8 of :class:`Label`, row 0 ahead of the gripper, column 0 to its left.
    """
    x, y, theta, opening, _ = state.vector[:5].tolist()
    c, s = math.cos(theta), math.sin(theta)
    # World frame to subpixels: u to the right is -left, v down is -forward.
    scale = _PIXELS_PER_METRE * _SUBPIXELS
    world_to_pixel = np.array([[s, -c], [-c, -s]]) * scale  # rows: u, v
    offset = (_ORIGIN_COLUMN * _SUBPIXELS, _ORIGIN_ROW * _SUBPIXELS) - world_to_pixel @ (x, y)

    image = np.full((IMAGE_SIZE, IMAGE_SIZE), Label.EDGE, dtype=np.uint8)
    target = scene.target
    _fill(image, [_to_pixels(scene.edges, world_to_pixel, offset)], Label.BACKGROUND)
    _fill(image, [_to_pixels(target.position + target.radius * _CIRCLE, world_to_pixel, offset)], Label.TARGET)
    objects = _object_outlines(scene, state, world_to_pixel, offset)
    _fill(image, objects[1:], Label.OBSTACLE)
    _fill(image, objects[:1], Label.DESIRED_OBJECT)
    _fill(image, _gripper_outlines(scene, opening), Label.ROBOT)
    return image


def colour_image(labels: LabelImage) -> np.ndarray:
    """Labels [..., 64, 64] as RGB [..., 64, 64, 3] uint8."""
    return PALETTE[labels]


def mirror_image(labels: LabelImage) -> LabelImage:
    """The image [..., 64, 64] of the mirrored scene: left and right of the gripper exchanged."""
    return labels[..., ::-1]


def _to_pixels(points: FloatArray, matrix: FloatArray, offset: FloatArray) -> np.ndarray:
    return np.rint(points @ matrix.T + offset).astype(np.int32)


def _fill(image: LabelImage, outlines: list[np.ndarray], label: Label) -> None:
    if outlines:
        cv2.fillPoly(image, outlines, int(label), lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)


def _object_outlines(scene: Scene, state: State, matrix: FloatArray, offset: FloatArray) -> list[np.ndarray]:
    """Outline of every object in subpixels; all vertices are moved at once."""
    vertices, owner = scene.stacked_outlines
    poses = state.object_poses[owner]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    world = np.empty_like(vertices)
    world[:, 0] = c * vertices[:, 0] - s * vertices[:, 1] + poses[:, 0]
    world[:, 1] = s * vertices[:, 0] + c * vertices[:, 1] + poses[:, 1]
    pixels = _to_pixels(world, matrix, offset)
    ends = np.flatnonzero(np.diff(owner)) + 1
    return np.split(pixels, ends)


def _gripper_outlines(scene: Scene, opening: float) -> list[np.ndarray]:
    """Palm and fingers in subpixels: they only move with the opening."""
    matrix = np.array([[0.0, -1.0], [-1.0, 0.0]]) * (_PIXELS_PER_METRE * _SUBPIXELS)
    offset = np.array([_ORIGIN_COLUMN, _ORIGIN_ROW]) * _SUBPIXELS
    return [_to_pixels(outline, matrix, offset) for outline in scene.gripper.outlines((0.0, 0.0, 0.0), opening)]
