"""Identity of objects from view to view, with shapes that stay.

Detections of a view are assigned to the tracks of earlier views so that the sum of their distances is smallest
(Hungarian algorithm). A track keeps its outline as long as later views agree with it (see
:mod:`visualrhp.embodiment.registration`), so that a planner sees a body that moves rather than one that changes. It
outlives the views in which the arm or another object hides it, and moves with the gripper while it is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import shapely
from scipy.optimize import linear_sum_assignment

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.occlusion import HiddenRegion
from visualrhp.embodiment.outlines import Silhouette
from visualrhp.embodiment.registration import (
    Reference,
    fitted_circle,
    overlap,
    register_part,
    register_whole,
)
from visualrhp.errors import PerceptionError
from visualrhp.parameters import Count, Fraction, Positive, parameters
from visualrhp.scene import geometry
from visualrhp.scene.gripper import Gripper
from visualrhp.types import FloatArray, wrap_angle


@parameters
class TrackerParameters:
    """How tracks are kept.

    Attributes:
        confirm: views in a row in which a new object has to be seen before it counts.
        forget: views in a row in which an object that nothing hides has to be missed before it is dropped or lost.
        gate: largest distance of a detection from where its track is expected [m].
        agreement: intersection over union from which on a view agrees with a track's outline.
        misfit: mean distance of the borders [m] up to which a view of a part agrees.
        hidden: share of an outline behind something from which on the object need not be detected.
        edge: distance from the edge of the surface [m] within which an object that is lost has fallen.
    """

    confirm: Count = 3
    forget: Count = 3
    gate: Positive = 0.2
    agreement: Fraction = 0.85
    misfit: Positive = 3e-3
    hidden: Fraction = 0.4
    edge: Positive = 0.07


_WHOLE: Final = 0.97
"""Share of a border that is seen from which on all of it counts as seen."""

_BETTER: Final = 0.08
"""By how much more of its border a view has to show to replace an outline."""

_OTHER_KIND: Final = 0.08
_OTHER_SIZE: Final = 0.03
"""Costs [m] of assigning a detection of another kind, and of a size that differs by a factor of e."""

_TURNS: Final = (0.5, -0.5, 1.0, -1.0)
"""Rotations [rad] from which the registration of a part starts if it fails."""

_FALLEN: Final = 0.05
"""Distance [m] from the edge at which an object is placed that fell unseen."""

_SAME_SHAPE: Final = 0.96
"""Intersection over union from which on an outline is kept although a better view of it is there."""

_RADII: Final = {Kind.APPLE: 0.037, Kind.ORANGE: 0.036, Kind.CUP: 0.038, Kind.BOTTLE: 0.033}
_RADIUS_SPREAD: Final = 4e-3
"""Usual radii of round outlines [m], and their standard deviation, for those of which a part is hidden at first."""

_DUPLICATE: Final = 0.5
_OUTSIDE: Final = 0.03
"""Distance [m] from the surface beyond which something new is no object of the task."""


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
        num_seen: views in which it was detected.
        num_missed: last views in a row in which it was neither detected nor hidden.
        num_disagreeing: last views in a row that did not agree with the outline.
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
    num_seen: int = 1
    num_missed: int = 0
    num_disagreeing: int = 0
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


class Tracker:
    """Keeps the tracks.

    Args:
        edges: [E, 2] of the surface [m], world frame.
        gripper: its geometry.
        settings: how tracks are kept.
    """

    def __init__(self, edges: FloatArray, gripper: Gripper, settings: TrackerParameters | None = None) -> None:
        self.settings = settings or TrackerParameters()
        self._surface = shapely.Polygon(edges)
        self._gripper = gripper
        self._tracks: list[Track] = []
        self._last_gripper: GripperView | None = None
        self._next_id = 0

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Tracks that count, by id; before any does, all."""
        confirmed = tuple(track for track in self._tracks if self._is_confirmed(track))
        return confirmed or tuple(self._tracks)

    @property
    def is_settled(self) -> bool:
        """Whether another view would, as far as is known, not change what is there."""
        return bool(self._tracks) and all(
            self._is_confirmed(track) and (track.is_dropped or not (track.num_missed or track.num_disagreeing))
            for track in self._tracks
        )

    def _is_confirmed(self, track: Track) -> bool:
        return track.num_seen >= self.settings.confirm

    def update(
        self, silhouettes: Sequence[Silhouette], hidden: HiddenRegion, gripper: GripperView, time_s: float
    ) -> None:
        """Take in a view.

        Args:
            silhouettes: the objects that are detected.
            hidden: what is behind the arm or any object.
            gripper: where it is.
            time_s: of the view [s].

        Raises:
            PerceptionError: an object is gone that nothing hides and that was not close to an edge.
        """
        expected = [self._expected_poses(track, gripper) for track in self._tracks]
        pairs = self._assigned(silhouettes, expected)
        lost: list[Track] = []
        for number, track in enumerate(list(self._tracks)):
            if number in pairs:
                self._measure(track, silhouettes[pairs[number]], expected[number])
                track.last_seen_s = time_s
            elif self._miss(track, expected[number][-1], hidden):
                lost.append(track)
        for number in set(range(len(silhouettes))) - set(pairs.values()):
            self._appear(silhouettes[number], time_s)
        for track in self._tracks:
            track.is_held = self._holds(track, gripper)
        self._last_gripper = gripper
        if lost:
            named = ", ".join(f"{t.kind} {t.id} at ({t.pose[0]:z.3f}, {t.pose[1]:z.3f})" for t in lost)
            raise PerceptionError(
                f"vanished: {named}; it is neither hidden nor was it close to an edge, and was not seen in the last "
                f"{self.settings.forget} views; look whether it is still on the surface"
            )

    # ----------------------------------------------------------------------------------------------------- assignment
    def _expected_poses(self, track: Track, gripper: GripperView) -> list[FloatArray]:
        """Where a track may be: where it was, and if it was held, where the gripper has carried it; the likeliest
        last."""
        before = self._last_gripper
        if before is None or not track.is_held:
            return [track.pose]
        turn = gripper.pose[2] - before.pose[2]
        place = geometry.to_world(geometry.to_body(track.pose[None, :2], before.pose), gripper.pose)[0]
        return [track.pose, np.array([*place, wrap_angle(float(track.pose[2] + turn))])]

    def _assigned(self, silhouettes: Sequence[Silhouette], expected: Sequence[list[FloatArray]]) -> dict[int, int]:
        """The number of the silhouette for each number of a track."""
        if not silhouettes or not self._tracks:
            return {}
        costs = np.array(
            [
                [self._cost(track, poses, silhouette) for silhouette in silhouettes]
                for track, poses in zip(self._tracks, expected, strict=True)
            ]
        )
        far = 10.0
        rows, columns = linear_sum_assignment(np.where(np.isfinite(costs), costs, far))
        return {int(r): int(c) for r, c in zip(rows, columns, strict=True) if np.isfinite(costs[r, c])}

    def _cost(self, track: Track, expected: list[FloatArray], silhouette: Silhouette) -> float:
        distance = min(float(np.hypot(*(pose[:2] - silhouette.centroid))) for pose in expected)
        if distance > self.settings.gate:
            return np.inf
        growth = abs(float(np.log(silhouette.area / track.reference.shape.area)))
        other = _OTHER_KIND if silhouette.detection.kind is not track.kind else 0.0
        return distance + other + _OTHER_SIZE * silhouette.share_seen * growth

    # --------------------------------------------------------------------------------------------------------- updates
    def _measure(self, track: Track, silhouette: Silhouette, expected: list[FloatArray]) -> None:
        """Find the pose of a track that is detected."""
        start = min(reversed(expected), key=lambda pose: float(np.hypot(*(pose[:2] - silhouette.centroid))))
        is_whole = silhouette.share_seen >= _WHOLE
        if is_whole:
            pose, agreement = register_whole(track.reference, silhouette.polygon, float(start[2]))
            agrees = agreement >= self.settings.agreement
        else:
            pose, distance = self._partial_pose(track, start, silhouette)
            agrees = distance <= self.settings.misfit
        is_better = silhouette.share_seen > track.quality + _BETTER or (is_whole and track.quality < _WHOLE)
        if is_better and overlap(track.reference.at(pose), silhouette.polygon) > _SAME_SHAPE:
            track.quality, is_better = silhouette.share_seen, False
        has_changed = silhouette.detection.is_lying is not track.is_lying and is_whole and not agrees
        track.num_disagreeing = 0 if agrees else track.num_disagreeing + 1
        if is_better or has_changed or (track.num_disagreeing >= 2 and silhouette.share_seen > 0.5):
            track.reference, pose = _reference(silhouette, float(start[2]))
            track.quality, track.num_disagreeing = silhouette.share_seen, 0
        track.pose, track.heights = pose, silhouette.heights
        if is_whole or has_changed:
            track.is_lying = silhouette.detection.is_lying
        track.num_seen += 1
        track.num_missed, track.is_hidden = 0, False
        track.is_dropped = not self._surface.contains(shapely.Point(pose[:2]))
        _vote(track, silhouette)

    def _partial_pose(self, track: Track, start: FloatArray, silhouette: Silhouette) -> tuple[FloatArray, float]:
        border = silhouette.points[silhouette.is_seen]
        if len(border) < 8:
            return start, 0.0  # nothing to be learned from what is seen
        best = register_part(track.reference, start, border, silhouette.hidden)
        for turn in () if track.reference.is_round else _TURNS:
            if best[1] <= self.settings.misfit:
                break
            again = register_part(track.reference, start + (0.0, 0.0, turn), border, silhouette.hidden)
            best = min(best, again, key=lambda result: result[1])
        return best

    def _miss(self, track: Track, expected: FloatArray, hidden: HiddenRegion) -> bool:
        """Update a track that is not detected; return whether it is lost."""
        if track.is_dropped:
            return False
        outline = track.reference.at(expected)
        behind = shapely.intersection(outline, hidden.at(*track.heights)).area
        track.is_hidden = bool(behind >= self.settings.hidden * outline.area)
        if track.is_hidden:
            track.pose, track.num_missed = expected, 0
            return False
        track.num_missed += 1
        if not self._is_confirmed(track):
            self._tracks.remove(track)
            return False
        if track.num_missed < self.settings.forget:
            return False
        place = shapely.Point(track.pose[:2])
        border = self._surface.exterior
        if border.distance(place) > self.settings.edge:
            return True
        track.is_dropped = True
        at_edge = shapely.get_coordinates(border.interpolate(border.project(place)))[0]
        outwards = at_edge - shapely.get_coordinates(self._surface.centroid)[0]
        track.pose = np.array([*(at_edge + _FALLEN * outwards / np.hypot(*outwards)), track.pose[2]])
        return False

    def _appear(self, silhouette: Silhouette, time_s: float) -> None:
        """Start a track, unless it is no object of the task or a second detection of one."""
        if self._surface.distance(silhouette.polygon.centroid) > _OUTSIDE or silhouette.share_seen < 0.2:
            return
        if any(overlap(track.polygon, silhouette.polygon) > _DUPLICATE for track in self._tracks):
            return
        reference, pose = _reference(silhouette, 0.0)
        track = Track(self._next_id, reference, pose, silhouette.heights, is_lying=silhouette.detection.is_lying)
        track.quality, track.last_seen_s = silhouette.share_seen, time_s
        _vote(track, silhouette)
        self._next_id += 1
        self._tracks.append(track)

    def _holds(self, track: Track, gripper: GripperView) -> bool:
        """Whether a track is between closed fingers: it fills a third of the space between them."""
        if not gripper.closed or gripper.opening < 5e-3 or track.is_dropped:
            return False
        back, front = self._gripper.finger_reach - self._gripper.finger_length, self._gripper.finger_reach
        half = 0.5 * gripper.opening
        between = np.array([[back, -half], [front, -half], [front, half], [back, half]])
        space = shapely.Polygon(geometry.to_world(between, gripper.pose))
        shared = shapely.intersection(space, track.polygon).area
        return bool(shared > min(0.33 * space.area, 0.33 * track.polygon.area))


def _vote(track: Track, silhouette: Silhouette) -> None:
    for kind in track.votes:
        track.votes[kind] *= 0.8
    track.votes[silhouette.detection.kind] = (
        track.votes.get(silhouette.detection.kind, 0.0) + silhouette.detection.score
    )


def _reference(silhouette: Silhouette, theta: float) -> tuple[Reference, FloatArray]:
    """The outline of a silhouette; of a round one that is seen in part, the circle through the border that is seen."""
    polygon = silhouette.polygon
    detection, border = silhouette.detection, silhouette.points[silhouette.is_seen]
    if silhouette.share_seen < _WHOLE and not detection.is_lying and detection.kind in _RADII and len(border) > 8:
        centre, radius = fitted_circle(border, _RADII[detection.kind], _RADIUS_SPREAD)
        circle = shapely.Point(centre).buffer(radius, quad_segs=16)
        # It should hold what is seen, and be behind something elsewhere.
        beyond = shapely.difference(circle, shapely.union(polygon.buffer(2e-3), silhouette.hidden))
        if beyond.area < 0.1 * circle.area and shapely.intersection(polygon, circle).area > 0.8 * polygon.area:
            polygon = circle
    return Reference.located(polygon, theta)
