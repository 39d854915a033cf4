"""One object over time, and where it can be while the camera does not see it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import shapely

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.occlusion import HiddenRegion
from visualrhp.embodiment.outlines import Silhouette
from visualrhp.embodiment.registration import Reference, fitted_circle
from visualrhp.embodiment.segmentation.detection import Detection
from visualrhp.scene import geometry
from visualrhp.scene.gripper import Gripper
from visualrhp.types import FloatArray

WHOLE: Final = 0.97
"""Share of a border that is seen from which on all of it counts as seen."""

_RADII: Final = {Kind.APPLE: 0.037, Kind.ORANGE: 0.036, Kind.CUP: 0.038, Kind.BOTTLE: 0.033}
_RADIUS_SPREAD: Final = 4e-3
"""Usual radii of round outlines [m], and their standard deviation, for those of which a part is hidden at first."""

PUSHED: Final = 0.1
"""Distance [m] by which the arm may have pushed an object that is missed."""

_BEHIND: Final = 0.6
"""Share of such an object that is then behind the arm."""

ON_EDGE: Final = 2e-3
"""Distance from the edge [m] of an object that is on it."""


@dataclass(eq=False)
class Track:
    """An object over time.

    Attributes:
        id: never reused, in the order of appearance.
        reference: its outline.
        pose: [3] x [m], y [m], theta [rad] of its outline, world frame.
        heights: between which it is widest [m].
        votes: for each kind.
        is_lying: as last seen.
        quality: share of its border that was seen when the outline was taken.
        detection: of it in the last view; None if it was not detected.
        num_seen: views in which it was detected.
        num_missed: last views in a row in which it was neither detected nor hidden.
        num_disagreeing: last views in a row that did not agree with the outline.
        is_late: it appeared when all that was there had been seen before: the shadow of the arm, maybe.
        last_seen_s: time of the last view in which it was detected [s].
        is_hidden: something hides it in the last view.
        is_held: it is between the closed fingers.
        is_dropped: it has fallen off the surface.
    """

    id: int
    reference: Reference
    pose: FloatArray
    heights: tuple[float, float]
    votes: dict[Kind, float] = field(default_factory=dict)
    is_lying: bool = False
    quality: float = 1.0
    detection: Detection | None = None
    num_seen: int = 1
    num_missed: int = 0
    num_disagreeing: int = 0
    is_late: bool = False
    last_seen_s: float = 0.0
    is_hidden: bool = False
    is_held: bool = False
    is_dropped: bool = False

    @property
    def kind(self) -> Kind:
        """What most views, the last ones first, say that it is."""
        return max(self.votes, key=lambda kind: self.votes[kind])

    @property
    def polygon(self) -> shapely.Polygon:
        """Its outline in the world frame."""
        return self.reference.at(self.pose)


@dataclass(frozen=True)
class GripperView:
    """The gripper in a view.

    Attributes:
        pose: [3] x [m], y [m], theta [rad] of its frame, world frame.
        opening: between the fingers [m].
        closed: whether it was commanded to close.
    """

    pose: FloatArray
    opening: float
    closed: bool


def vote(track: Track, silhouette: Silhouette) -> None:
    """Count the kind of a detection: what was seen last counts most."""
    for kind in track.votes:
        track.votes[kind] *= 0.8
    track.votes[silhouette.detection.kind] = (
        track.votes.get(silhouette.detection.kind, 0.0) + silhouette.detection.score
    )


def reference_of(silhouette: Silhouette, theta: float) -> tuple[Reference, FloatArray]:
    """The outline of a silhouette, and its pose [3]; of a round one that is seen in part, the circle through the border
    that is seen."""
    polygon = silhouette.polygon
    detection, border = silhouette.detection, silhouette.points[silhouette.is_seen]
    if silhouette.share_seen < WHOLE and not detection.is_lying and detection.kind in _RADII and len(border) > 8:
        centre, radius = fitted_circle(border, _RADII[detection.kind], _RADIUS_SPREAD)
        circle = shapely.Point(centre).buffer(radius, quad_segs=16)
        # It should hold what is seen, and be behind something elsewhere.
        beyond = shapely.difference(circle, shapely.union(polygon.buffer(2e-3), silhouette.hidden))
        if beyond.area < 0.1 * circle.area and shapely.intersection(polygon, circle).area > 0.8 * polygon.area:
            polygon = circle
    return Reference.located(polygon, theta)


def is_between_fingers(track: Track, gripper: GripperView, shape: Gripper) -> bool:
    """Whether a track is between closed fingers: it fills a third of the space between them."""
    if not gripper.closed or gripper.opening < 5e-3 or track.is_dropped:
        return False
    back, front = shape.finger_reach - shape.finger_length, shape.finger_reach
    half = 0.5 * gripper.opening
    between = np.array([[back, -half], [front, -half], [front, half], [back, half]])
    space = shapely.Polygon(geometry.to_world(between, gripper.pose))
    shared = shapely.intersection(space, track.polygon).area
    return bool(shared > min(0.33 * space.area, 0.33 * track.polygon.area))


def on_surface(surface: shapely.Polygon, pose: FloatArray) -> FloatArray:
    """``pose`` [3], moved to the closest place on the surface: a drop has to be seen."""
    place = shapely.Point(pose[:2])
    inner = shapely.buffer(surface, -ON_EDGE)
    if shapely.contains(inner, place):
        return np.array(pose, dtype=np.float64)
    border = shapely.get_exterior_ring(inner)
    at_edge = shapely.line_interpolate_point(border, shapely.line_locate_point(border, place))
    return np.array([*shapely.get_coordinates(at_edge)[0], pose[2]])


def hidden_share(track: Track, pose: FloatArray, hidden: HiddenRegion) -> float:
    """Share of a track's outline at ``pose`` [3] that is hidden."""
    outline = track.reference.at(pose)
    return float(shapely.intersection(outline, hidden.at(*track.heights)).area / outline.area)


def hiding_place(track: Track, pose: FloatArray, arm: HiddenRegion, surface: shapely.Polygon) -> FloatArray | None:
    """The closest place behind the arm to which it may have pushed a track.

    Args:
        track: that is missed.
        pose: [3] where it is expected.
        arm: what is behind the arm.
        surface: on which the place is.

    Returns:
        Its pose [3] there; None if there is no such place within :data:`PUSHED`.
    """
    region = arm.at(*track.heights)
    if not shapely.distance(region, shapely.Point(pose[:2])) <= PUSHED:
        return None
    outline, inner = track.reference.at(pose), shapely.buffer(surface, -ON_EDGE)
    ring = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    directions = np.stack([np.cos(ring), np.sin(ring)], axis=1)
    for distance in np.arange(0.01, PUSHED + 1e-9, 0.01):
        best, place = _BEHIND * outline.area, None
        for offset in distance * directions:
            if not shapely.contains_xy(inner, *(pose[:2] + offset)):
                continue
            area = shapely.intersection(shapely.affinity.translate(outline, *offset), region).area
            if area > best:
                best, place = area, pose + (*offset, 0.0)
        if place is not None:
            return place
    return None
