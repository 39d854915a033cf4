"""From the camera's image and the robot's joints to the scene and the state of the planner (paper, Sec. 5.1).

Segmentation finds the objects, outlines are taken to the table without parallax, tracks keep identities and shapes,
template matching finds the target region, and forward kinematics gives the gripper. What is preloaded: the surface and
the gripper's shape.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Annotated, Final, Protocol

import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.arm_silhouette import arm_mask
from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.desired import DesiredObject
from visualrhp.embodiment.occlusion import all_hidden, hidden_around
from visualrhp.embodiment.outlines import Silhouette, silhouette
from visualrhp.embodiment.persistence import Persistence
from visualrhp.embodiment.robot_cell import ArmState, CameraFrame, GripperState
from visualrhp.embodiment.robot_model import CELL_GRIPPER, Mounting
from visualrhp.embodiment.segmentation.detection import Detection, Mask, Segmenter
from visualrhp.embodiment.separation import separated
from visualrhp.embodiment.target_search import FoundTarget, TargetSearch, find_target
from visualrhp.embodiment.track import GripperView, Track
from visualrhp.embodiment.tracking import Tracker, TrackerParameters
from visualrhp.embodiment.view import SeenObject, View, seen_object
from visualrhp.errors import PerceptionError
from visualrhp.parameters import Count, Field, Fraction, parameters
from visualrhp.scene.scene import Scene, TargetRegion, square_edges
from visualrhp.types import FloatArray, State

__all__ = [
    "ForwardKinematics",
    "FrameChecks",
    "GripperFrame",
    "Perception",
    "PerceptionParameters",
    "SeenObject",
    "View",
]


class ForwardKinematics(Protocol):
    """What perception needs of the arm's kinematics (:class:`visualrhp.embodiment.kinematics.ArmKinematics`)."""

    @property
    def mounting(self) -> Mounting:
        """Where the base stands."""
        ...

    def forward(self, joints: FloatArray, /) -> GripperFrame:
        """Pose of the gripper frame at joint positions [6] [rad]."""
        ...


class GripperFrame(Protocol):
    """Pose of the gripper frame in the world frame: x [m], y [m], theta [rad]."""

    @property
    def x(self) -> float: ...
    @property
    def y(self) -> float: ...
    @property
    def theta(self) -> float: ...


@parameters
class FrameChecks:
    """Which images are refused.

    Attributes:
        darkest: mean grey value below which an image is black.
        least_contrast: standard deviation of the grey values below which it shows nothing.
        refuse_repeated: whether an image that equals the last one in every pixel is refused as frozen: the noise of a
            camera makes every image different.
    """

    darkest: Annotated[float, Field(ge=0, le=255)] = 8.0
    least_contrast: Annotated[float, Field(ge=0, le=255)] = 2.0
    refuse_repeated: bool = True


@parameters
class PerceptionParameters:
    """Settings of the parts of perception.

    Attributes:
        least_score: of a detection that counts; a known object is found with it, a new one needs
            ``TrackerParameters.sure``.
        most_arm: share of a mask that may be the arm's; a detection with more is a part of the arm.
        frames: which images are refused.
        target: how the target region is found.
        tracker: how tracks are kept.
        goal_margin: by which the target region of the scene is smaller than the disc [m]: what is seen within it is
            within the disc in spite of errors of a few millimetres.
        target_views: views in a row in which the disc is in sight and not where it was, after which the camera or the
            surface has moved.
    """

    least_score: Fraction = 0.3
    most_arm: Fraction = 0.7
    frames: FrameChecks = Field(default_factory=FrameChecks)
    target: TargetSearch = Field(default_factory=TargetSearch)
    tracker: TrackerParameters = Field(default_factory=TrackerParameters)
    goal_margin: Annotated[float, Field(ge=0)] = 4e-3
    target_views: Count = 3


class Perception:
    """Interprets the images of one episode, one after the other.

    Args:
        camera: calibrated.
        segmenter: finds the objects.
        kinematics: of the arm.
        desired: the object that is to be moved to the target region.
        edges: [E, 2] of the surface [m], world frame; None for the square of the paper.
        settings: of the parts.
    """

    places_hidden: Final = True
    """Hidden objects are where :meth:`expect` says."""

    def __init__(
        self,
        camera: Camera,
        segmenter: Segmenter,
        kinematics: ForwardKinematics,
        desired: DesiredObject,
        edges: FloatArray | None = None,
        settings: PerceptionParameters | None = None,
    ) -> None:
        self.camera = camera
        self.desired = desired
        self.settings = settings or PerceptionParameters()
        self._segmenter = segmenter
        self._kinematics = kinematics
        self._edges = square_edges(0.5) if edges is None else edges
        self._tracker = Tracker(self._edges, CELL_GRIPPER, self.settings.tracker)
        self._persistence = Persistence()
        self._desired_id: int | None = None
        self._target: FoundTarget | None = None
        self._target_missed = 0
        self._last_image: npt.NDArray[np.uint8] | None = None
        self._last_time_s = -np.inf
        self._scene: Scene | None = None

    def expect(self, poses: Mapping[int, FloatArray]) -> None:
        """Take in where a model expects the objects after a motion.

        Args:
            poses: [3] by the ids of tracks, as in the state. In the next view, objects are looked for there first, and
                what the arm hides is there.
        """
        self._tracker.expect(poses)

    def perceive(self, frame: CameraFrame, arm: ArmState, gripper: GripperState, closed: bool) -> View:
        """Interpret an image.

        Args:
            frame: taken with the arm at rest.
            arm: state of the arm when it was taken.
            gripper: state of the gripper when it was taken.
            closed: whether the gripper was last commanded to close.

        Raises:
            PerceptionError: the image is black, frozen, older than the last one or of the wrong size; an object has
                vanished; the target region or the desired object is not found.
        """
        latencies: dict[str, float] = {}
        image = self._checked(frame)
        with _timed(latencies, "kinematics"):
            tool = self._kinematics.forward(arm.positions)
            opening = float(np.clip(gripper.opening, 0.0, CELL_GRIPPER.stroke))
            hand = GripperView(np.array([tool.x, tool.y, tool.theta]), opening, closed)
            robot = arm_mask(self.camera, arm.positions, opening, self._kinematics.mounting)
        with _timed(latencies, "segmentation"):
            detections = self._kept(self._segmenter.segment(image), robot)
            recalled = self._persistence.recall(image, detections, robot)
            detections += recalled.values()
        with _timed(latencies, "outlines"):
            masks = [detection.mask for detection in detections]
            found = [
                silhouette(self.camera, detection, hidden_around(self.camera, robot, masks, number))
                for number, detection in enumerate(detections)
            ]
        with _timed(latencies, "target"):
            sure = [each.mask for each in detections if each.score >= self.settings.tracker.sure]
            target = self._find_target(image, robot, sure)
        with _timed(latencies, "tracking"):
            seen: list[Silhouette] = [each for each in found if each is not None]
            hidden, behind_arm = all_hidden(self.camera, robot, sure), all_hidden(self.camera, robot, [])
            self._tracker.update(seen, hidden, hand, frame.time_s, behind_arm)
            self._remember(image, robot, list(recalled.values()))
            tracks = self._ordered()
        with _timed(latencies, "state"):
            scene = self._scene_of(tracks, target)
            poses, opening = separated(
                scene.objects,
                np.array([track.pose for track in tracks]),
                CELL_GRIPPER,
                hand.pose,
                opening,
                [number for number, track in enumerate(tracks) if track.is_held],
            )
            seen_pose = tracks[0].pose
            if _is_within(scene.target, seen_pose) != _is_within(scene.target, poses[0]):
                poses[0] = seen_pose  # what is seen decides about the goal, not what a planner can start from
            state = State.create(hand.pose, opening, closed, poses)
        objects = tuple(seen_object(track, pose, frame.time_s) for track, pose in zip(tracks, poses, strict=True))
        return View(
            scene,
            state,
            objects,
            tuple(detections),
            robot,
            target,
            frame.time_s,
            self._tracker.is_settled,
            latencies,
        )

    # ------------------------------------------------------------------------------------------------------ the image
    def _checked(self, frame: CameraFrame) -> npt.NDArray[np.uint8]:
        """The image of a frame, if it can be used."""
        image, checks = frame.image, self.settings.frames
        expected = (self.camera.height, self.camera.width, 3)
        if image.shape != expected or image.dtype != np.uint8:
            raise PerceptionError(
                f"the image has the shape {list(image.shape)} and the type {image.dtype}; the calibrated camera gives "
                f"{list(expected)} and uint8"
            )
        if frame.time_s <= self._last_time_s:
            raise PerceptionError(
                f"the image is of {frame.time_s:.3f} s, and the last one was of {self._last_time_s:.3f} s: the camera "
                "gives old images"
            )
        coarse = image[::4, ::4]
        if float(coarse.mean()) < checks.darkest:
            raise PerceptionError(
                f"the image is black (mean grey value {coarse.mean():.1f}); look at the lens, the light and the cable"
            )
        if float(coarse.std()) < checks.least_contrast:
            raise PerceptionError(f"the image shows nothing: all its pixels are about {coarse.mean():.0f}")
        if checks.refuse_repeated and self._last_image is not None and np.array_equal(image, self._last_image):
            raise PerceptionError("the image is frozen: it equals the last one in every pixel")
        self._last_image, self._last_time_s = image.copy(), frame.time_s
        return image

    def _kept(self, detections: list[Detection], robot: Mask) -> list[Detection]:
        """Detections that count: confident, not of the arm, and each object once."""
        kept: list[Detection] = []
        for detection in sorted(detections, key=lambda each: -each.score):
            size = int(np.count_nonzero(detection.mask))
            if detection.score < self.settings.least_score or not size:
                continue
            if np.count_nonzero(detection.mask & robot) > self.settings.most_arm * size:
                continue
            if any(np.count_nonzero(detection.mask & other.mask) > _SAME * size for other in kept):
                continue
            kept.append(detection)
        return kept

    def _find_target(self, image: npt.NDArray[np.uint8], robot: Mask, masks: list[Mask]) -> FoundTarget:
        """The target region: searched once, looked at while it is in sight, and located again if more of it is."""
        covered = robot.copy()
        for mask in masks:
            covered |= mask
        search = self.settings.target
        if self._target is None:
            self._target = find_target(image, self.camera, self._edges, covered, search)
            return self._target
        x, y = self._target.position
        is_missed = False
        try:
            # Any place counts that is a little like the disc: shadows and lights change while the arm moves.
            anything = replace(search, least_score=0.0)
            found = find_target(image, self.camera, self._edges, covered, anything, near=self._target.position)
            is_missed = found.visible > _MUCH_COVERED and found.score < 0.5 * search.least_score
            if self._target.visible < _MUCH and found.visible > self._target.visible + _MORE:
                self._target = find_target(image, self.camera, self._edges, covered, search)
        except PerceptionError as error:
            is_missed = "cover" not in str(error)
        self._target_missed = self._target_missed + 1 if is_missed else 0
        if self._target_missed >= self.settings.target_views:
            raise PerceptionError(
                f"the target region was at ({x:.3f}, {y:.3f}) and is not there any more: the camera or the surface has "
                "moved; calibrate the camera again"
            )
        return self._target

    def _remember(self, image: npt.NDArray[np.uint8], robot: Mask, recalled: list[Detection]) -> None:
        """Keep how the objects look that were detected, each on its own."""
        tracks = [t for t in self._tracker.tracks if t.num_seen >= self.settings.tracker.confirm and not t.is_dropped]
        owners = Counter(id(track.detection) for track in tracks)
        found = {
            track.id: track.detection
            for track in tracks
            if track.detection is not None and owners[id(track.detection)] == 1 and track.detection not in recalled
        }
        self._persistence.remember(image, found, robot, [track.id for track in tracks])

    # ------------------------------------------------------------------------------------------------------ the scene
    def _ordered(self) -> tuple[Track, ...]:
        """Tracks, the desired one first."""
        tracks = self._tracker.tracks
        if self._desired_id is None or self._desired_id not in {track.id for track in tracks}:
            mounting = self._kinematics.mounting
            chosen = self.desired.choose(tracks, (mounting.x, mounting.y)).id
            if self._tracker.is_settled:
                self._desired_id = chosen
        else:
            chosen = self._desired_id
        return tuple(sorted(tracks, key=lambda track: (track.id != chosen, track.id)))

    def _scene_of(self, tracks: tuple[Track, ...], target: FoundTarget) -> Scene:
        """The scene of the tracks; the same object as long as nothing of it changes."""
        region = TargetRegion(target.position, self.settings.target.radius - self.settings.goal_margin)
        shapes = tuple(track.reference.shape for track in tracks)
        last = self._scene
        is_same = (
            last is not None
            and last.target == region
            and len(last.objects) == len(shapes)
            and all(old is new for old, new in zip(last.objects, shapes, strict=True))
        )
        if last is None or not is_same:
            self._scene = last = Scene(region, shapes, self._edges, CELL_GRIPPER)
        return last


_MUCH, _MORE = 0.9, 0.15
"""A disc of which less than the first share was seen is located again when the second share more of it is seen."""

_MUCH_COVERED: Final = 0.6
"""Visible share of the disc below which it is not told whether it is still there."""

_SAME: Final = 0.7
"""Share of a mask within that of a more confident detection from which on both are the same object."""


def _is_within(target: TargetRegion, pose: FloatArray) -> bool:
    return bool(np.hypot(*(pose[:2] - target.position)) <= target.radius)


@contextmanager
def _timed(latencies: dict[str, float], part: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    latencies[part] = time.perf_counter() - started
