"""From the mask of an object to its outline on the table, without parallax (paper, Sec. 5.1).

A camera sees the silhouette of a body: the union of its cross-sections, each scaled about the point below the camera
(the nadir) by H / (H - z), where H is the height of the camera and z that of the section. Projected back to the height
z, the silhouette is the union of the sections scaled by (H - z) / (H - z').

*Upright bodies* (standing bottles, cups, boxes) have one widest section F between the heights low and high. Along every
ray from the nadir, F covers an interval [a, b]; the silhouette covers [a, k b], projected to low, and [a / k, b],
projected to high. The outline is therefore the intersection of the two.

*Round bodies* (fruit, lying bottles) are widest at the height of their radius w / 2. Projected to the table, the width
is w0 = w H / (H - w / 2), hence w = w0 / (1 + w0 / (2 H)). A sphere off the nadir is seen as a circle that is stretched
along the ray by 1 / cos(alpha), where alpha is the angle of the ray against the vertical; this is undone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt
import shapely
from scipy.spatial import KDTree

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.kinds import Kind, widest_section
from visualrhp.embodiment.occlusion import HiddenRegion
from visualrhp.embodiment.segmentation.detection import Detection, Mask
from visualrhp.errors import SceneError
from visualrhp.scene import geometry
from visualrhp.types import FloatArray

TOLERANCE: Final = 1.5e-3
"""How far the planner's outline deviates from the contour [m]; about a pixel."""

MAX_VERTICES: Final = 14
"""Largest number of vertices of the planner's outline: the time of a roll-out grows with it."""

CONVEX_SOLIDITY: Final = 0.93
"""Share of its convex hull from which on an outline counts as convex: notches are then errors of the mask."""

MIN_AREA: Final = 2e-4
"""Smallest area [m^2] of an object that is looked at; 14 x 14 mm."""

_SOFTENING: Final = 1.0  # standard deviation [px]
_MARGIN: Final = 4
_LEAST_CONTOUR: Final = 8
_MOST_POINTS: Final = 110
_SMALL_PIECE: Final = 0.04  # of the area of the largest one
_SPACING: Final = 2e-3  # [m] of points on an edge between two pieces
_CLOSE: Final = 3e-3  # [m] from a doubtful point


def mask_contours(mask: Mask) -> list[FloatArray]:
    """The borders of the pieces of a mask, with a precision below a pixel.

    The mask is softened, and the points of its contours are moved to where it is one half.

    Args:
        mask: [H, W].

    Returns:
        Of each piece [N, 2] pixels (column, row), the largest first; those much smaller than it are left out.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return []
    top, left = int(rows[0]), int(columns[0])
    crop = mask[top : rows[-1] + 1, left : columns[-1] + 1].astype(np.float32)
    soft = cv2.GaussianBlur(np.pad(crop, _MARGIN), (0, 0), _SOFTENING)
    found = cv2.findContours((soft > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    areas = [cv2.contourArea(contour) for contour in found]
    slope_x = 0.5 * (np.roll(soft, -1, axis=1) - np.roll(soft, 1, axis=1))
    slope_y = 0.5 * (np.roll(soft, -1, axis=0) - np.roll(soft, 1, axis=0))
    contours = []
    for number in np.argsort(areas)[::-1]:
        points = found[int(number)][:, 0]
        if len(points) < _LEAST_CONTOUR or areas[int(number)] < _SMALL_PIECE * max(areas):
            break
        column, row = points.T
        slope = np.stack([slope_x[row, column], slope_y[row, column]], axis=1)
        steepness = np.maximum((slope**2).sum(axis=1), 1e-3)
        step = ((0.5 - soft[row, column]) / steepness)[:, None] * slope
        step *= np.minimum(1.0, 1.0 / np.maximum(np.hypot(*step.T)[:, None], 1e-9))  # at most a pixel
        contours.append(points + step + (left - _MARGIN, top - _MARGIN))
    return contours


def mask_contour(mask: Mask) -> FloatArray:
    """[N, 2] the border of the largest piece of a mask, see :func:`mask_contours`; [0, 2] if it is empty."""
    return next(iter(mask_contours(mask)), np.zeros((0, 2)))


@dataclass(frozen=True)
class Silhouette:
    """The outline of a detected object on the table.

    Attributes:
        detection: what was detected.
        points: [N, 2] border of the outline, at the height of the object's widest section [m], world frame; an open
            ring, counter-clockwise.
        heights: between which the section is widest [m].
        is_seen: [N] whether a point is the object's own border, not where something else hides it.
        share_seen: of the border.
        hidden: what is behind other things close to the object, at ``heights``, world frame.
    """

    detection: Detection
    points: FloatArray
    heights: tuple[float, float]
    is_seen: npt.NDArray[np.bool_]
    share_seen: float
    hidden: shapely.Geometry

    @cached_property
    def polygon(self) -> shapely.Polygon:
        """The outline as a polygon."""
        return largest_piece(shapely.Polygon(self.points))

    @cached_property
    def centroid(self) -> FloatArray:
        """[2] centre of area [m], world frame."""
        return shapely.get_coordinates(self.polygon.centroid)[0]

    @property
    def area(self) -> float:
        """[m^2]."""
        return float(self.polygon.area)


def silhouette(camera: Camera, detection: Detection, hidden: HiddenRegion | None = None) -> Silhouette | None:
    """The outline of a detection on the table; None if it is too small to be an object, or not on the ground.

    Args:
        camera: that took the image.
        detection: with a mask of the size of the camera's image.
        hidden: what is behind the arm and other objects; None for nothing.
    """
    hidden = hidden or HiddenRegion(camera, np.zeros((0, 0), dtype=bool))
    pieces = mask_contours(detection.mask)
    if not pieces:
        return None
    if len(pieces) > 1 and not all(hidden.contains(piece).any() for piece in pieces):
        pieces = pieces[:1]  # nothing hides what would join them
    pixels = np.concatenate([piece[:: -(-len(piece) // _MOST_POINTS)] for piece in pieces])
    seen = camera.back_project(pixels)
    if not np.isfinite(seen).all():
        return None
    is_split = len(pieces) > 1
    on_table = _enclosed(seen, is_split)
    if on_table.area < MIN_AREA:
        return None
    doubtful = hidden.contains(pixels)
    low, high = section_heights(camera, detection, on_table)
    if low == high and not is_split:
        points, is_seen = _at_height(camera, seen, low), ~doubtful
    else:
        points = _intersection(camera, seen, low, high, is_split)
        if points is None:
            return None
        is_seen = np.ones(len(points), dtype=bool)
        if doubtful.any():
            places = np.concatenate([_at_height(camera, seen[doubtful], height) for height in (low, high)])
            is_seen = KDTree(places).query(points)[0] > _CLOSE
        if is_split and not doubtful.all():  # no point of an edge between two pieces is seen
            places = np.concatenate([_at_height(camera, seen[~doubtful], height) for height in (low, high)])
            is_seen &= KDTree(places).query(points)[0] < _CLOSE
    if _is_round(detection):
        points = _unstretched(camera, points, low)
    if geometry.signed_area(points) < 0.0:
        points, is_seen = points[::-1], is_seen[::-1]
    share = 1.0 - float(doubtful.mean())
    region = hidden.at(low, high) if share < 1.0 else shapely.Polygon()
    found = Silhouette(detection, points, (low, high), is_seen, share, region)
    return found if found.area >= MIN_AREA else None


def section_heights(camera: Camera, detection: Detection, on_table: shapely.Polygon) -> tuple[float, float]:
    """Heights [m] between which the body of a detection is widest, from its silhouette projected to the table."""
    camera_height = float(camera.position[2])
    width = least_width(on_table)
    section = widest_section(detection.kind, detection.is_lying, width / (1.0 + width / (2.0 * camera_height)))
    return section.low, section.high


def least_width(polygon: shapely.Polygon) -> float:
    """Smallest width [m] over all directions."""
    return geometry.least_width(geometry.convex_hull(shapely.get_coordinates(polygon)))


def planner_outline(polygon: shapely.Polygon) -> FloatArray:
    """The outline that the planner uses: few vertices, the same area, and convex if the notches are small.

    Args:
        polygon: the outline [m].

    Returns:
        [V, 2] vertices [m], V <= :data:`MAX_VERTICES`, counter-clockwise.

    Raises:
        SceneError: it is degenerate.
    """
    hull = polygon.convex_hull
    if not isinstance(hull, shapely.Polygon) or polygon.area < MIN_AREA:
        raise SceneError(f"an outline of {polygon.area:.3g} m^2 is too small for an object ({MIN_AREA:g} m^2)")
    is_convex = polygon.area >= CONVEX_SOLIDITY * hull.area
    # The hull of a mask's border is a little larger than what the mask shows, and a simplified one is smaller.
    border, tolerance = (hull if is_convex else polygon), TOLERANCE
    outline = geometry.simplify_contour(border, tolerance)
    while len(outline) > MAX_VERTICES:
        tolerance *= 1.25
        outline = geometry.simplify_contour(border, tolerance)
    scale = math.sqrt(polygon.area / geometry.signed_area(outline))
    centre = shapely.get_coordinates(polygon.centroid)[0]
    return centre + scale * (outline - geometry.centroid(outline))


def largest_piece(shape: shapely.Geometry) -> shapely.Polygon:
    """The largest polygon of a geometry, without holes; an empty polygon if it has none."""
    if not shapely.is_valid(shape):
        shape = shapely.make_valid(shape, method="structure", keep_collapsed=False)
    pieces = [piece for piece in shapely.get_parts(shape) if isinstance(piece, shapely.Polygon)]
    return shapely.Polygon(max(pieces, key=lambda piece: piece.area).exterior) if pieces else shapely.Polygon()


def _is_round(detection: Detection) -> bool:
    return detection.kind in (Kind.APPLE, Kind.ORANGE) or detection.is_lying


def _at_height(camera: Camera, on_table: FloatArray, height: float) -> FloatArray:
    """Points [N, 2] of the table, moved along their lines of sight to ``height`` [m]."""
    shrink = (camera.position[2] - height) / camera.position[2]
    return camera.nadir + shrink * (on_table - camera.nadir)


def _enclosed(points: FloatArray, is_split: bool) -> shapely.Polygon:
    """What a border encloses; the convex hull of one that is split, since what hides the middle hides no notch."""
    if is_split:
        hull = shapely.MultiPoint(points).convex_hull
        return hull if isinstance(hull, shapely.Polygon) else shapely.Polygon()
    return largest_piece(shapely.Polygon(points))


def _intersection(camera: Camera, on_table: FloatArray, low: float, high: float, is_split: bool) -> FloatArray | None:
    """[M, 2] border of the silhouette projected to ``low`` and to ``high``."""
    lower, upper = (_enclosed(_at_height(camera, on_table, height), is_split) for height in (low, high))
    both = largest_piece(shapely.intersection(lower, upper))
    if is_split:
        both = shapely.segmentize(both, _SPACING)
    return None if both.is_empty else shapely.get_coordinates(both.exterior)[:-1]


def _unstretched(camera: Camera, points: FloatArray, height: float) -> FloatArray:
    """Shrink the outline of a round body along the ray from the nadir, by the cosine of the ray's angle."""
    centre = shapely.get_coordinates(shapely.Polygon(points).centroid)[0]
    ray = centre - camera.nadir
    distance = float(np.hypot(*ray))
    if distance < 1e-6:
        return points
    outwards = ray / distance
    below = float(camera.position[2]) - height
    cosine = below / math.hypot(below, distance)
    offsets = points - centre
    return centre + offsets - (1.0 - cosine) * (offsets @ outwards)[:, None] * outwards
