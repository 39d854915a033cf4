"""Shapes, text and colours of frames and their overlays.

The world frame (x right, y up, metres) appears with y up. Colours follow the paper's labels (Sec. 5.1: desired object
light green, obstacles red, gripper blue, target region dark green) in softer tones.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from visualrhp.errors import ConfigError
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene
from visualrhp.types import FloatArray

Colour = tuple[int, int, int]

BACKGROUND: Colour = (233, 236, 241)
SURFACE: Colour = (253, 249, 240)
EDGE: Colour = (52, 58, 68)
GRID: Colour = (240, 233, 218)
PAPER: Colour = (253, 253, 254)
TARGET: Colour = (24, 108, 68)
DESIRED: Colour = (96, 200, 92)
OBSTACLE: Colour = (222, 92, 84)
GRIPPER: Colour = (56, 112, 196)
FINGER: Colour = (36, 78, 150)
INK: Colour = (33, 37, 44)
FAINT_INK: Colour = (108, 116, 128)

DEFAULT_SIZE_PX = 720
"""Height and width of the picture of a scene."""

MARGIN = 0.1
"""Width of the border around the surface that a frame shows [m]: the gripper often reaches beyond the edges."""

_SUPERSAMPLING = 2
_SHIFT = 5  # OpenCV's fixed-point coordinates: fractional bits
_GRID_STEP = 0.1
_MIN_SIZE = 64
_USUAL_EXTENT = 0.7  # of the paper's surface with its margins [m]; line widths refer to it


class Canvas:
    """Shapes in metres on a supersampled picture of a scene's surface."""

    def __init__(self, scene: Scene, size_px: int) -> None:
        if size_px < _MIN_SIZE:
            raise ConfigError(f"size_px={size_px}: a frame needs at least {_MIN_SIZE} pixels a side")
        size_px += size_px % 2
        self.scene = scene
        self.size_px = size_px
        low, high = scene.edges.min(axis=0), scene.edges.max(axis=0)
        extent = float((high - low).max()) + 2.0 * MARGIN
        self.pixels_per_metre = size_px * _SUPERSAMPLING / extent
        self._pixels_per_width = size_px * _SUPERSAMPLING / _USUAL_EXTENT
        self.bounds = (low + high - extent) / 2.0, (low + high + extent) / 2.0  # [2] each: the visible region [m]
        self._left_top = (low + high) / 2.0 + np.array([-extent, extent]) / 2.0
        side = size_px * _SUPERSAMPLING
        self.picture = np.full((side, side, 3), BACKGROUND, dtype=np.uint8)
        _draw_surface(self, scene)
        self._surface = self.picture.copy()

    def fixed_point(self, points: FloatArray) -> np.ndarray:
        """[N, 2] int32 pixel coordinates with fractional bits; the centre of pixel (0, 0) is (0, 0)."""
        pixels = (points - self._left_top) * (self.pixels_per_metre, -self.pixels_per_metre) - 0.5
        return np.round(pixels * (1 << _SHIFT)).astype(np.int32)

    def frame_pixels(self, points: FloatArray) -> FloatArray:
        """[N, 2] column and row of ``points`` [N, 2] in the finished frame."""
        return (points - self._left_top) * (self.pixels_per_metre, -self.pixels_per_metre) / _SUPERSAMPLING

    def thickness(self, width: float) -> int:
        """Width in pixels, at least 1, of a line of ``width`` [m] on the paper's surface; equally bold on any other."""
        return max(1, round(width * self._pixels_per_width))

    def size_of(self, width: float) -> float:
        """Length [m] on this surface that appears like ``width`` [m] on the paper's surface."""
        return width * self._pixels_per_width / self.pixels_per_metre

    def polygon(self, points: FloatArray, fill: Colour, outline: Colour | None = None, width: float = 0.0016) -> None:
        corners = self.fixed_point(points)
        cv2.fillPoly(self.picture, [corners], fill, cv2.LINE_AA, _SHIFT)
        if outline is not None:
            cv2.polylines(self.picture, [corners], True, outline, self.thickness(width), cv2.LINE_AA, _SHIFT)

    def line(self, points: FloatArray, colour: Colour, width: float) -> None:
        cv2.polylines(
            self.picture, [self.fixed_point(points)], False, colour, self.thickness(width), cv2.LINE_AA, _SHIFT
        )

    def disc(self, centre: FloatArray, radius: float, colour: Colour, width: float | None = None) -> None:
        """A filled disc, or a ring of ``width`` [m]."""
        self._circle(centre, radius * self.pixels_per_metre, colour, -1 if width is None else self.thickness(width))

    def dot(self, centre: FloatArray, radius: float, colour: Colour) -> None:
        """Draw a mark that appears as large on any surface as a disc of ``radius`` [m] on the paper's surface."""
        self._circle(centre, radius * self._pixels_per_width, colour, -1)

    def _circle(self, centre: FloatArray, radius_px: float, colour: Colour, thickness: int) -> None:
        x, y = self.fixed_point(np.asarray(centre, dtype=np.float64)[None])[0]
        pixels = round(radius_px * (1 << _SHIFT))
        cv2.circle(self.picture, (int(x), int(y)), pixels, colour, thickness, cv2.LINE_AA, _SHIFT)

    def clear(self) -> None:
        """Erase everything except the surface."""
        np.copyto(self.picture, self._surface)

    def veil(self, outlines: Sequence[tuple[FloatArray, Colour]], share: float) -> None:
        """Tint the interior of polygons (points [V, 2] and colour), convex or not."""
        before = self.picture.copy()
        for points, colour in outlines:
            cv2.fillPoly(self.picture, [self.fixed_point(points)], colour, cv2.LINE_AA, _SHIFT)
        cv2.addWeighted(before, 1.0 - share, self.picture, share, 0.0, self.picture)

    def shade(self, outlines: Sequence[FloatArray]) -> None:
        """Draw a soft shadow under everything on the surface."""
        mask = np.zeros(self.picture.shape[:2], dtype=np.uint8)
        for outline in outlines:
            cv2.fillPoly(mask, [self.fixed_point(outline + np.array([0.003, -0.005]))], 70, cv2.LINE_AA, _SHIFT)
        mask = cv2.blur(mask, (self.thickness(0.008),) * 2)
        shade = cv2.cvtColor(255 - mask, cv2.COLOR_GRAY2RGB)
        cv2.multiply(self.picture, shade, self.picture, 1.0 / 255.0)

    def finished(self) -> Frame:
        """The picture in its final size."""
        small = cv2.resize(self.picture, (self.size_px, self.size_px), interpolation=cv2.INTER_AREA)
        return np.asarray(small, dtype=np.uint8)


def _draw_surface(canvas: Canvas, scene: Scene) -> None:
    canvas.polygon(scene.edges + np.array([0.004, -0.006]), mix(BACKGROUND, INK, 0.14))
    canvas.polygon(scene.edges, SURFACE)
    low, high = scene.edges.min(axis=0), scene.edges.max(axis=0)
    surface = canvas.picture.copy()
    for axis in range(2):
        for offset in np.arange(np.ceil(low[axis] / _GRID_STEP) * _GRID_STEP, high[axis], _GRID_STEP):
            ends = np.array([low, high])
            ends[:, axis] = offset
            canvas.line(ends, GRID, 0.0012)
    outside = np.full(surface.shape[:2], 255, dtype=np.uint8)
    cv2.fillPoly(outside, [canvas.fixed_point(scene.edges)], 0, cv2.LINE_8, _SHIFT)
    cv2.copyTo(surface, outside, canvas.picture)  # the surface may be any polygon
    with_target = canvas.picture.copy()
    target = scene.target
    canvas.disc(target.position, target.radius, TARGET)
    cv2.addWeighted(with_target, 0.78, canvas.picture, 0.22, 0.0, canvas.picture)
    canvas.disc(target.position, target.radius, TARGET, width=0.003)
    arm = np.array([[-0.009, 0.0], [0.009, 0.0]])
    for cross in (arm, arm[:, ::-1]):
        canvas.line(target.position + cross, TARGET, 0.0022)
    canvas.line(np.vstack([scene.edges, scene.edges[:1]]), EDGE, 0.004)


_FONT = cv2.FontFace("sans")


def text(picture: Frame, text: str, x: int, baseline: int, colour: Colour, height_px: int, weight: int) -> None:
    cv2.putText(picture, text, (x, baseline), colour, _FONT, height_px, weight)


def text_width(text: str, height_px: int, weight: int) -> int:
    _, _, width, _ = cv2.getTextSize((10_000, 1_000), text, (0, 0), _FONT, height_px, weight)
    return int(width)


def shortened(text: str, width: int, height_px: int, weight: int) -> str:
    """Truncate ``text`` to ``width`` [px]."""
    if text_width(text, height_px, weight) <= width:
        return text
    while text and text_width(text + "...", height_px, weight) > width:
        text = text[:-1]
    return text.rstrip() + "..." if text else ""


def rounded_box(picture: Frame, left: int, top: int, right: int, bottom: int, colour: Colour) -> None:
    radius = (bottom - top) // 2
    middle = top + radius
    cv2.rectangle(picture, (left + radius, top), (right - radius, top + 2 * radius), colour, -1)
    for x in (left + radius, right - radius):
        cv2.circle(picture, (x, middle), radius, colour, -1, cv2.LINE_AA)


def mix(colour: Colour, other: Colour, share: float) -> Colour:
    """``colour`` with a ``share`` in [0, 1] of ``other``."""
    red, green, blue = (round((1.0 - share) * a + share * b) for a, b in zip(colour, other, strict=True))
    return red, green, blue
