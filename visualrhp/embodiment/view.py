"""What an image and the robot's joints tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation.detection import Detection, Mask
from visualrhp.embodiment.target_search import FoundTarget
from visualrhp.embodiment.track import Track
from visualrhp.scene.scene import Scene
from visualrhp.types import FloatArray, State


@dataclass(frozen=True)
class SeenObject:
    """A track, as it is in one view.

    Attributes:
        id: of the track.
        kind: what it is.
        is_lying: whether it lies on its side.
        outline: [V, 2] fine outline [m], world frame.
        pose: [3] x [m], y [m], theta [rad], as in the state.
        age_s: time since it was last detected [s].
        is_hidden: something hides it.
        is_held: it is between the closed fingers.
        is_dropped: it has fallen off the surface.
    """

    id: int
    kind: Kind
    is_lying: bool
    outline: FloatArray
    pose: FloatArray
    age_s: float
    is_hidden: bool
    is_held: bool
    is_dropped: bool


@dataclass(frozen=True)
class View:
    """What an image and the robot's joints tell.

    Attributes:
        scene: the desired object first, then the others in the order of their appearance.
        state: the gripper, and the objects of ``scene``. Bodies do not overlap by more than a planner accepts.
        tracks: of the objects of ``scene``, in this order.
        detections: of the image.
        arm: [H, W] pixels in which the arm may be seen.
        target: the disc.
        time_s: of the image, on the clock of the cell [s].
        is_settled: another view would, as far as is known, not change what is there; otherwise, an object is new,
            missed or of another shape, and another image should be taken before a decision.
        latencies: wall-clock time of each part [s].
    """

    scene: Scene
    state: State
    tracks: tuple[SeenObject, ...]
    detections: tuple[Detection, ...]
    arm: Mask
    target: FoundTarget
    time_s: float
    is_settled: bool
    latencies: dict[str, float]


def seen_object(track: Track, pose: FloatArray, time_s: float) -> SeenObject:
    """A track in a view of the time ``time_s`` [s], at ``pose`` [3]."""
    outline = np.asarray(track.polygon.exterior.coords)[:-1]
    return SeenObject(
        track.id,
        track.kind,
        track.is_lying,
        outline,
        pose,
        time_s - track.last_seen_s,
        track.is_hidden,
        track.is_held,
        track.is_dropped,
    )
