"""Convex bodies as a camera sees them, and a segmenter that knows them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import shapely

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation import Detection
from visualrhp.scene import geometry
from visualrhp.types import FloatArray

_ANGLES = 2.0 * np.pi * np.arange(72) / 72
CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


def top_camera(**changes) -> Camera:
    """640 x 480 pixels over 0.75 x 0.56 m."""
    return Camera.above(**({"position": (0.01, -0.02, 1.4), "focal_length": 1200.0} | changes))


@dataclass(frozen=True)
class Body:
    """A convex body on the table: horizontal sections [V, 2] in its own frame, each with its height [m]."""

    kind: Kind
    sections: tuple[tuple[FloatArray, float], ...]
    pose: tuple[float, float, float]
    is_lying: bool = False

    def at(self, x: float, y: float, theta: float = 0.0) -> Body:
        return replace(self, pose=(x, y, theta))

    @property
    def outline(self) -> shapely.Polygon:
        """What an orthographic view from above shows."""
        points = np.concatenate([geometry.to_world(section, self.pose) for section, _ in self.sections])
        return shapely.Polygon(geometry.convex_hull(points))

    def silhouette(self, camera: Camera) -> shapely.Polygon:
        """In pixels."""
        points = [
            np.column_stack([geometry.to_world(section, self.pose), np.full(len(section), height)])
            for section, height in self.sections
        ]
        return shapely.Polygon(geometry.convex_hull(camera.project(np.concatenate(points))))


def fruit(radius: float = 0.038, kind: Kind = Kind.ORANGE) -> Body:
    heights = radius * (1.0 - np.cos(np.linspace(0.1, np.pi - 0.1, 15)))
    sections = tuple((CIRCLE * math.sqrt(radius**2 - (radius - z) ** 2), z) for z in heights)
    return Body(kind, sections, (0.0, 0.0, 0.0))


def upright(outline: FloatArray, height: float, kind: Kind = Kind.BOX) -> Body:
    return Body(kind, ((outline, 0.0), (outline, height)), (0.0, 0.0, 0.0))


def box(length: float = 0.10, width: float = 0.06, height: float = 0.07) -> Body:
    corners = 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])
    return upright(corners, height)


def cup(radius: float = 0.04, height: float = 0.09) -> Body:
    return Body(Kind.CUP, ((0.7 * radius * CIRCLE, 0.0), (radius * CIRCLE, height)), (0.0, 0.0, 0.0))


def standing_bottle(radius: float = 0.033) -> Body:
    sections = ((radius * CIRCLE, 0.0), (radius * CIRCLE, 0.11), (0.4 * radius * CIRCLE, 0.2))
    return Body(Kind.BOTTLE, sections, (0.0, 0.0, 0.0))


def lying_bottle(radius: float = 0.033, length: float = 0.2) -> Body:
    sections = []
    for z in radius * (1.0 - np.cos(np.linspace(0.0, np.pi, 15))):
        half = max(math.sqrt(max(radius**2 - (radius - z) ** 2, 0.0)), 1e-6)
        neck = max(half - 0.6 * radius, 1e-6)
        body = [[-0.5 * length, -half], [0.1 * length, -half], [0.1 * length, half], [-0.5 * length, half]]
        sections.append((np.array([*body, [0.5 * length, -neck], [0.5 * length, neck]]), float(z)))
    return Body(Kind.BOTTLE, tuple(sections), (0.0, 0.0, 0.0), is_lying=True)


def painted(camera: Camera, polygon: shapely.Geometry) -> np.ndarray:
    """[H, W] bool: the pixels more than half of which a polygon (in pixels) covers."""
    mask = np.zeros((camera.height, camera.width), dtype=bool)
    for piece in shapely.get_parts(polygon):
        if not isinstance(piece, shapely.Polygon) or piece.is_empty:
            continue
        left, top, right, bottom = piece.bounds
        column, row = max(int(left) - 1, 0), max(int(top) - 1, 0)
        width, height = min(int(right) + 2, camera.width) - column, min(int(bottom) + 2, camera.height) - row
        if width <= 0 or height <= 0:
            continue
        scale = 4
        image = np.zeros((height * scale, width * scale), dtype=np.uint8)
        points = (shapely.get_coordinates(piece.exterior) - (column, row) + 0.5) * scale - 0.5
        cv2.fillPoly(image, [np.round(points * 16).astype(np.int32)], 1, shift=4)
        small = cv2.resize(image.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        mask[row : row + height, column : column + width] |= small > 0.5
    return mask


def detection(camera: Camera, body: Body, hidden: np.ndarray | None = None) -> Detection:
    mask = painted(camera, body.silhouette(camera))
    return Detection(body.kind, body.is_lying, mask if hidden is None else mask & ~hidden)
