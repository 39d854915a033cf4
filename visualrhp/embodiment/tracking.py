"""Identity of objects from view to view, with shapes that stay.

Detections of a view are assigned to the tracks of earlier views so that the sum of their distances is smallest
(Hungarian algorithm). A track keeps its outline as long as later views agree with it (see
:mod:`visualrhp.embodiment.registration`), so that a planner sees a body that moves rather than one that changes. It
outlives the views in which the arm or another object hides it, and moves with the gripper while it is held.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import shapely
from scipy.optimize import linear_sum_assignment

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.merging import split
from visualrhp.embodiment.occlusion import HiddenRegion
from visualrhp.embodiment.outlines import Silhouette
from visualrhp.embodiment.registration import overlap, register_part, register_whole
from visualrhp.embodiment.track import (
    WHOLE,
    GripperView,
    Track,
    hidden_share,
    hiding_place,
    is_between_fingers,
    on_surface,
    reference_of,
    vote,
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
        established: views in which an object that appears late has to be seen before its absence means anything.
        sure: score of a detection from which on it may be a new object. One below it is an object that is known, close
            to where it should be and not detected otherwise, or nothing.
        gate: largest distance of a detection from where its track is expected [m].
        lost_gate: the same for a track that was not detected in the last view, and a detection of its kind [m]: what
            is behind the arm may roll, and there are no more objects than before.
        agreement: intersection over union from which on a view agrees with a track's outline.
        misfit: mean distance of the borders [m] up to which a view of a part agrees.
        hidden: share of an outline behind something from which on the object need not be detected.
        edge: distance from the edge of the surface [m] within which an object that is lost has fallen.
        outside: distance beyond the edge from which on an object that is seen there has fallen [m]; closer, it is on
            the edge, seen with an error.
    """

    confirm: Count = 3
    forget: Count = 3
    established: Count = 10
    sure: Fraction = 0.5
    gate: Positive = 0.2
    lost_gate: Positive = 0.4
    agreement: Fraction = 0.85
    misfit: Positive = 3e-3
    hidden: Fraction = 0.4
    edge: Positive = 0.07
    outside: Positive = 8e-3


_BETTER: Final = 0.08
"""By how much more of its border a view has to show to replace an outline."""

_OTHER_KIND: Final = 0.12
_SIMILAR_KIND: Final = 0.04
_OTHER_SIZE: Final = 0.03
"""Costs [m] of assigning a detection of another kind, of one that is easily taken for it (:data:`_ALIKE`), and of a
size that differs by a factor of e."""

_ALIKE: Final = (frozenset({Kind.BOTTLE, Kind.CUP}), frozenset({Kind.APPLE, Kind.ORANGE}))
"""A cup that lies is often taken for a bottle; an apple is not."""

_TURNS: Final = (0.5, -0.5, 1.0, -1.0)
"""Rotations [rad] from which the registration of a part starts if it fails."""

_FALLEN: Final = 0.05
"""Distance [m] from the edge at which an object is placed that fell unseen."""

_STUBBORN: Final = 3
"""Views in a row that do not agree with an outline from which on another one would not either."""

_UNLIKELY: Final = 0.02
_UNEXPECTED: Final = 0.04
"""Costs [m] of assigning a detection to a track that was there and should have moved, and to one that should be hidden
or has fallen."""

_CLOSE: Final = 0.05
"""Cost [m] up to which a detection that is not sure is a known object."""

_LITTLE: Final = 0.4
"""Share of an outline below which what is seen of it, if it does not fit, tells hardly more than that it is there."""

_SAME_SHAPE: Final = 0.96
"""Intersection over union from which on an outline is kept although a better view of it is there."""

_DUPLICATE: Final = 0.5


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
        self._predicted: dict[int, FloatArray] = {}
        self._next_id = 0
        self._has_settled = False

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Tracks that count, by id; before any does, all."""
        confirmed = tuple(track for track in self._tracks if self._is_confirmed(track))
        return confirmed or tuple(self._tracks)

    @property
    def is_settled(self) -> bool:
        """Whether another view would, as far as is known, not change what is there."""
        return bool(self._tracks) and all(
            self._is_confirmed(track)
            and (track.is_dropped or not (track.num_missed or 0 < track.num_disagreeing < _STUBBORN))
            for track in self._tracks
        )

    def _is_confirmed(self, track: Track) -> bool:
        return track.num_seen >= self.settings.confirm

    def expect(self, poses: Mapping[int, FloatArray]) -> None:
        """Where a model expects tracks in the next view: poses [3] by their ids. What is hidden then is there."""
        self._predicted = {number: on_surface(self._surface, pose) for number, pose in poses.items()}

    def update(
        self,
        silhouettes: Sequence[Silhouette],
        hidden: HiddenRegion,
        gripper: GripperView,
        time_s: float,
        arm: HiddenRegion | None = None,
    ) -> None:
        """Take in a view.

        Args:
            silhouettes: the objects that are detected.
            hidden: what is behind the arm or any object.
            gripper: where it is.
            time_s: of the view [s].
            arm: what is behind the arm, where an object may have been pushed; None for the same as ``hidden``.

        Raises:
            PerceptionError: an object is gone that nothing hides and that was not close to an edge.
        """
        expected = [self._expected_poses(track, gripper) for track in self._tracks]
        silhouettes = split(silhouettes, self._tracks, expected)
        pairs = self._assigned(silhouettes, expected, hidden)
        lost: list[Track] = []
        for number, track in enumerate(list(self._tracks)):
            if number in pairs:
                track.detection = silhouettes[pairs[number]].detection
                self._measure(track, silhouettes[pairs[number]], expected[number])
                track.last_seen_s = time_s
            else:
                track.detection = None
                if self._miss(track, expected[number], hidden, arm or hidden):
                    lost.append(track)
        for number in set(range(len(silhouettes))) - set(pairs.values()):
            self._appear(silhouettes[number], time_s)
        for track in self._tracks:
            track.is_held = is_between_fingers(track, gripper, self._gripper)
        self._last_gripper, self._predicted = gripper, {}
        self._has_settled = self._has_settled or self.is_settled
        if lost:
            named = ", ".join(f"{t.kind} {t.id} at ({t.pose[0]:z.3f}, {t.pose[1]:z.3f})" for t in lost)
            raise PerceptionError(
                f"vanished: {named}; it is neither hidden nor was it close to an edge, and was not seen in the last "
                f"{self.settings.forget} views; look whether it is still on the surface"
            )

    # ----------------------------------------------------------------------------------------------------- assignment
    def _expected_poses(self, track: Track, gripper: GripperView) -> list[FloatArray]:
        """Where a track may be, the likeliest last: where it was, where a model expects it, and if it was held, where
        the gripper has carried it."""
        expected = [track.pose]
        if track.id in self._predicted and not track.is_dropped:
            expected.append(self._predicted[track.id])
        before = self._last_gripper
        if before is not None and track.is_held and gripper.closed:
            turn = gripper.pose[2] - before.pose[2]
            place = geometry.to_world(geometry.to_body(track.pose[None, :2], before.pose), gripper.pose)[0]
            expected.append(np.array([*place, wrap_angle(float(track.pose[2] + turn))]))
        return expected

    def _assigned(
        self, silhouettes: Sequence[Silhouette], expected: Sequence[list[FloatArray]], hidden: HiddenRegion
    ) -> dict[int, int]:
        """The number of the silhouette for each number of a track."""
        if not silhouettes or not self._tracks:
            return {}
        costs = np.array(
            [
                [self._cost(track, poses, silhouette) for silhouette in silhouettes]
                for track, poses in zip(self._tracks, expected, strict=True)
            ]
        )
        # What should be in sight is the more likely one to be seen.
        for number, track in enumerate(self._tracks if len(silhouettes) < len(self._tracks) else ()):
            if track.is_dropped or hidden_share(track, expected[number][-1], hidden) >= self.settings.hidden:
                costs[number] += _UNEXPECTED
        # First the detections that are sure, then the others for what is left (ByteTrack, Zhang et al., 2022).
        is_sure = np.array([each.detection.score >= self.settings.sure for each in silhouettes])
        pairs = _matched(np.where(is_sure, costs, np.inf))
        is_left = np.array([number not in pairs for number in range(len(self._tracks))])
        return pairs | _matched(np.where(is_left[:, None] & ~is_sure & (costs <= _CLOSE), costs, np.inf))

    def _cost(self, track: Track, expected: list[FloatArray], silhouette: Silhouette) -> float:
        distances = [float(np.hypot(*(pose[:2] - silhouette.centroid))) for pose in expected]
        is_lost = track.detection is None and track.kind is silhouette.detection.kind
        if min(distances) > (self.settings.lost_gate if is_lost else self.settings.gate):
            return np.inf
        distance = min(distances[-1], min(distances) + _UNLIKELY)
        growth = abs(float(np.log(silhouette.area / track.reference.shape.area)))
        return (
            distance + _kind_cost(track.kind, silhouette.detection.kind) + _OTHER_SIZE * silhouette.share_seen * growth
        )

    # --------------------------------------------------------------------------------------------------------- updates
    def _measure(self, track: Track, silhouette: Silhouette, expected: list[FloatArray]) -> None:
        """Find the pose of a track that is detected."""
        start = min(reversed(expected), key=lambda pose: float(np.hypot(*(pose[:2] - silhouette.centroid))))
        is_whole = silhouette.share_seen >= WHOLE
        if is_whole:
            pose, agreement = register_whole(track.reference, silhouette.polygon, float(start[2]))
            agrees = agreement >= self.settings.agreement
        else:
            pose, distance = self._partial_pose(track, start, expected, silhouette)
            agrees = distance <= self.settings.misfit
            if not agrees and silhouette.area < _LITTLE * track.reference.shape.area:
                pose, agrees = _around(track, expected[-1], silhouette), True
        is_better = silhouette.share_seen > track.quality + _BETTER or (is_whole and track.quality < WHOLE)
        if is_better and overlap(track.reference.at(pose), silhouette.polygon) > _SAME_SHAPE:
            track.quality, is_better = silhouette.share_seen, False
        has_changed = silhouette.detection.is_lying is not track.is_lying and is_whole and not agrees
        track.num_disagreeing = 0 if agrees else track.num_disagreeing + 1
        if is_better or has_changed or (track.num_disagreeing >= 2 and silhouette.share_seen > 0.5):
            track.reference, pose = reference_of(silhouette, float(start[2]))
            track.quality, track.num_disagreeing = silhouette.share_seen, 0
        track.pose, track.heights = pose, silhouette.heights
        if is_whole or has_changed:
            track.is_lying = silhouette.detection.is_lying
        track.num_seen += 1
        track.num_missed, track.is_hidden = 0, False
        self._place(track, silhouette)
        vote(track, silhouette)

    def _place(self, track: Track, silhouette: Silhouette) -> None:
        """Tell whether a track that is seen has fallen: all that is seen of it tells so, by more than an error."""
        place = shapely.Point(track.pose[:2])
        if self._surface.contains(place):
            track.is_dropped = False
            return
        seen = place if silhouette.share_seen >= WHOLE else shapely.Point(silhouette.centroid)
        beyond = min(self._surface.distance(place), self._surface.distance(seen))
        track.is_dropped = bool(beyond > self.settings.outside)
        if not track.is_dropped:
            track.pose = on_surface(self._surface, track.pose)

    def _partial_pose(
        self, track: Track, start: FloatArray, expected: Sequence[FloatArray], silhouette: Silhouette
    ) -> tuple[FloatArray, float]:
        border = silhouette.points[silhouette.is_seen]
        if len(border) < 8:
            return start, 0.0  # nothing to be learned from what is seen
        turns = () if track.reference.is_round else _TURNS
        around = np.array([*silhouette.centroid, start[2]])
        starts = [*reversed(expected), around]
        starts += [start + (0.0, 0.0, turn) for turn in turns] + [around + (0.0, 0.0, turn) for turn in turns]
        best = start, np.inf
        for pose in starts:
            again = register_part(track.reference, pose, border, silhouette.hidden)
            best = min(best, again, key=lambda result: result[1])
            if best[1] <= self.settings.misfit:
                break
        return best

    def _miss(self, track: Track, expected: Sequence[FloatArray], hidden: HiddenRegion, arm: HiddenRegion) -> bool:
        """Update a track that is not detected; return whether it is lost."""
        if track.is_dropped:
            return False
        places = [pose for pose in expected if hidden_share(track, pose, hidden) >= self.settings.hidden]
        place = places[-1] if places else None
        if place is None and self._is_confirmed(track):
            place = hiding_place(track, expected[-1], arm, self._surface)
        track.is_hidden = place is not None
        if place is not None:
            track.pose, track.num_missed, track.num_disagreeing = place, 0, 0
            return False
        track.num_missed += 1
        if not self._is_confirmed(track):
            self._tracks.remove(track)
            return False
        if track.num_missed < self.settings.forget:
            return False
        if track.is_late and track.num_seen < self.settings.established:
            self._tracks.remove(track)
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
        """Start a track, unless it is no object of the task or a second detection of one.

        What was never on the surface cannot fall off it.
        """
        beyond = self._surface.distance(silhouette.polygon.centroid)
        if beyond > self.settings.outside or silhouette.share_seen < 0.2:
            return
        if silhouette.detection.score < self.settings.sure:
            return
        if any(overlap(track.polygon, silhouette.polygon) > _DUPLICATE for track in self._tracks):
            return
        reference, pose = reference_of(silhouette, 0.0)
        track = Track(self._next_id, reference, pose, silhouette.heights, is_lying=silhouette.detection.is_lying)
        track.quality, track.last_seen_s, track.detection = silhouette.share_seen, time_s, silhouette.detection
        track.is_late = self._has_settled
        vote(track, silhouette)
        self._next_id += 1
        self._tracks.append(track)


def _matched(costs: FloatArray) -> dict[int, int]:
    """Column of each row in the assignment of least cost; pairs of infinite cost are none."""
    far = 10.0
    rows, columns = linear_sum_assignment(np.where(np.isfinite(costs), costs, far))
    return {int(r): int(c) for r, c in zip(rows, columns, strict=True) if np.isfinite(costs[r, c])}


def _kind_cost(known: Kind, seen: Kind) -> float:
    if known is seen:
        return 0.0
    return _SIMILAR_KIND if frozenset({known, seen}) in _ALIKE else _OTHER_KIND


def _around(track: Track, pose: FloatArray, silhouette: Silhouette) -> FloatArray:
    """``pose`` [3], moved so that the outline of a track reaches what is seen of it."""
    outline, seen = track.reference.at(pose), shapely.Point(silhouette.centroid)
    if shapely.contains(outline, seen):
        return pose
    closest = shapely.get_coordinates(shapely.shortest_line(outline, seen))
    return pose + np.array([*(closest[1] - closest[0]), 0.0])
