"""The abstract colour-labelled, gripper-centric image of a state (paper, Sec. 5.1).

The image moves and rotates with the gripper: the forward axis points up, the left axis left, and the origin of the
gripper frame is always at the same pixel. It is stored as one byte (the label) per pixel, and coloured only where a
network or a person reads it.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterable
from enum import IntEnum
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.observation.observation import Observation, ObservationStore
from visualrhp.scene.scene import Scene
from visualrhp.types import LabelImage, State

IMAGE_SIZE: Final = 64
"""Pixels per side (Sec. 7.2)."""

VIEW_SIDE: Final = 0.72
"""Side of the square that the image shows [m]."""

VIEW_BEHIND: Final = 0.26
"""Extent of the image behind the origin of the gripper frame [m]: the constant offset of the paper."""

_PIXELS_PER_METRE = IMAGE_SIZE / VIEW_SIDE
_SUBPIXEL_BITS = 6
_SUBPIXELS = 1 << _SUBPIXEL_BITS
# Pixel centres are at whole coordinates in OpenCV: the left border of the image is at -0.5.
_ORIGIN_COLUMN = IMAGE_SIZE / 2 - 0.5
_ORIGIN_ROW = IMAGE_SIZE - VIEW_BEHIND * _PIXELS_PER_METRE - 0.5
_SCALE = _PIXELS_PER_METRE * _SUBPIXELS
_ORIGIN = (_ORIGIN_COLUMN + 1j * _ORIGIN_ROW) * _SUBPIXELS
_FORWARD = -1j * _SCALE


class Label(IntEnum):
    """Label of a pixel; the index of its colour in :data:`PALETTE`."""

    BACKGROUND = 0
    EDGE = 1
    TARGET = 2
    OBSTACLE = 3
    DESIRED_OBJECT = 4
    GRIPPER = 5


PALETTE: Final = np.array(
    [
        [255, 255, 255],  # background: white
        [0, 0, 0],  # beyond the surface edges: black
        [0, 100, 0],  # target region: dark green
        [255, 0, 0],  # obstacle objects: red
        [144, 238, 144],  # desired object: light green
        [0, 0, 255],  # end effector: blue
    ],
    dtype=np.uint8,
)
"""[6, 3] RGB colour of each label (Sec. 5.1)."""

_NOTHING: Final = np.full((IMAGE_SIZE, IMAGE_SIZE), Label.EDGE, dtype=np.uint8)


def label_image(scene: Scene, state: State) -> LabelImage:
    """Draw the abstract image of ``state``.

    Returns:
        [64, 64] uint8 of :class:`Label`, row 0 ahead of the gripper, column 0 to its left.
    """
    pixels = _subpixels(scene, state)
    _, _, places = scene.stacked_outlines
    surface, target, palm, left, right, desired, *obstacles = [pixels[place] for place in places]
    image = _NOTHING.copy()
    _fill(image, [surface], Label.BACKGROUND)
    _fill(image, [target], Label.TARGET)
    if obstacles:
        _fill(image, obstacles, Label.OBSTACLE)
    _fill(image, [desired], Label.DESIRED_OBJECT)
    _fill(image, [palm, left, right], Label.GRIPPER)
    return image


def _subpixels(scene: Scene, state: State) -> np.ndarray:
    """Column and row of all outlines, stacked as in the scene: [sum of V, 2] int32.

    In complex numbers, a point z of a body with pose (p, theta) is w = (p + z e^{i theta} - p_r) e^{-i theta_r} in the
    gripper frame, with columns to the right (minus left) and rows down (minus forward): column + i row =
    origin - i scale conj(w).
    """
    vertices, owner, _ = scene.stacked_outlines
    x, y, theta, opening, _, *poses = state.vector.tolist()
    turn = -1j * _SCALE * cmath.exp(1j * theta)
    world = _ORIGIN - turn * complex(x, -y)
    aside = 0.5 * opening * _SCALE
    factors = [turn, turn, _FORWARD, _FORWARD, _FORWARD]
    offsets = [world, world, _ORIGIN, _ORIGIN - aside, _ORIGIN + aside]
    for x, y, theta in zip(*[iter(poses)] * 3, strict=True):
        factors.append(turn * cmath.exp(-1j * theta))
        offsets.append(world + turn * complex(x, -y))
    points = vertices.conj() * np.array(factors)[owner] + np.array(offsets)[owner]
    return np.rint(points.view(np.float64)).astype(np.int32).reshape(-1, 2)


def colour_image(labels: LabelImage) -> np.ndarray:
    """Convert labels [..., 64, 64] to RGB [..., 64, 64, 3] uint8."""
    return PALETTE[labels]


def mirror_image(labels: LabelImage) -> LabelImage:
    """The image [..., 64, 64] of the mirrored scene: left and right of the gripper exchanged."""
    return labels[..., ::-1]


def _fill(image: LabelImage, outlines: list[np.ndarray], label: Label) -> None:
    cv2.fillPoly(image, outlines, int(label), lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)


class LabelImageObservation(Observation):
    """The label image of Sec. 5.1: [64, 64] uint8, for any number of objects."""

    name = "image"
    dtype = np.uint8
    low = 0
    high = len(Label) - 1
    encoder = "label_image"

    @property
    def shape(self) -> tuple[int, ...]:
        return (IMAGE_SIZE, IMAGE_SIZE)

    def __call__(self, scene: Scene, state: State) -> LabelImage:
        return label_image(scene, state)

    def mirror(self, observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return mirror_image(observations)

    def store(self, observations: Iterable[npt.NDArray[Any]]) -> ObservationStore:
        from visualrhp.observation.packed_images import PackedImages  # it imports the size of an image from here

        return PackedImages.pack(observations)
