"""What the camera cannot see: behind the arm, behind other objects, and outside of the image.

Where the mask of an object ends at the mask of something else, it is not known whether the object ends there. Such a
part of its border is *doubtful*; the rest is *seen*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
import shapely

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.segmentation.detection import Mask
from visualrhp.types import FloatArray

GROWTH: Final = 3
"""Pixels by which masks are enlarged: two masks that touch are seldom exactly side by side."""

_AROUND: Final = 64  # [px] looked at around a mask: about an object farther
_FINEST: Final = 1.0  # [px] of the borders of hidden regions


@dataclass(frozen=True, eq=False)
class HiddenRegion:
    """Pixels in which something hides what is behind.

    Attributes:
        camera: that took the image.
        mask: [h, w] a part of the image.
        offset: (column, row) of its first pixel in the image.
    """

    camera: Camera
    mask: Mask
    offset: tuple[int, int] = (0, 0)
    _known: dict[tuple[float, ...], shapely.Geometry] = field(default_factory=dict, init=False, repr=False)

    def contains(self, pixels: FloatArray) -> Mask:
        """[N] whether pixels [N, 2] are hidden, or outside of the camera's image."""
        column, row = np.round(pixels).astype(int).T
        outside = (column <= 0) | (row <= 0) | (column >= self.camera.width - 1) | (row >= self.camera.height - 1)
        column, row = column - self.offset[0], row - self.offset[1]
        height, width = self.mask.shape
        is_inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        hidden = np.zeros(len(pixels), dtype=bool)
        hidden[is_inside] = self.mask[row[is_inside], column[is_inside]]
        return hidden | outside

    def at(self, *heights: float) -> shapely.Geometry:
        """The region on horizontal planes at ``heights`` above the table [m], world frame: the union over them."""
        if heights not in self._known:
            self._known[heights] = self._union(heights)
        return self._known[heights]

    def _union(self, heights: tuple[float, ...]) -> shapely.Geometry:
        found = cv2.findContours(self.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
        pieces = []
        for contour in found:
            pixels = cv2.approxPolyDP(contour, _FINEST, closed=True)[:, 0] + np.array(self.offset)
            if len(pixels) < 3:
                continue
            on_table = self.camera.back_project(pixels)
            for height in sorted(set(heights)):
                shrink = (self.camera.position[2] - height) / self.camera.position[2]
                pieces.append(shapely.Polygon(self.camera.nadir + shrink * (on_table - self.camera.nadir)))
        return shapely.union_all(shapely.make_valid(np.array(pieces))) if pieces else shapely.Polygon()


def all_hidden(camera: Camera, arm: Mask, masks: Sequence[Mask]) -> HiddenRegion:
    """What is behind the arm or an object.

    Args:
        camera: that took the image.
        arm: [H, W] pixels of the arm.
        masks: [H, W] pixels of each object.
    """
    union = arm.copy()
    for mask in masks:
        union |= mask
    return HiddenRegion(camera, _grown(union))


def hidden_around(camera: Camera, arm: Mask, masks: Sequence[Mask], index: int) -> HiddenRegion:
    """What is behind the arm or another object than ``index``, close to it; arguments as :func:`all_hidden`."""
    mask = masks[index]
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return HiddenRegion(camera, np.zeros((0, 0), dtype=bool))
    top, left = max(int(rows[0]) - _AROUND, 0), max(int(columns[0]) - _AROUND, 0)
    part = np.s_[top : int(rows[-1]) + _AROUND + 1, left : int(columns[-1]) + _AROUND + 1]
    others = arm[part].copy()
    for number, other in enumerate(masks):
        if number != index:
            others |= other[part]
    return HiddenRegion(camera, _grown(others), (left, top))


def _grown(mask: Mask) -> Mask:
    size = 2 * GROWTH + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.dilate(mask.astype(np.uint8), kernel).astype(bool)
