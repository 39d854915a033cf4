"""An independent monitor of a robot cell that counts blind motions.

A **blind motion** is a command to arm or fingers that rests on

- no image, or one that was never exposed as it was interpreted (black, torn),
- an image that was exposed before arm or fingers last moved,
- an image that was exposed longer ago than the limit, on the true clock,
- an interpretation that failed after the last one that succeeded,
- a decision that was made for another scene than the last image shows, or
- a robot of which something impossible or a failed motion has been reported since.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from visualrhp.embodiment.robot_cell import ArmState, CameraFrame, GripperState, JointTrajectory
from visualrhp.embodiment.watchdog import WatchdogLimits
from visualrhp.errors import PerceptionError
from visualrhp.scene.scene import Scene
from visualrhp.types import State

SAME_POSITION: Final = 0.02
"""Distance of an object between a decision and the last image, above which the decision was for another scene [m]."""

LIMITS: Final = WatchdogLimits()


@dataclass
class Fault:
    """A fault of a device.

    Attributes:
        kind: of :data:`tests.torture.robot_faults.KINDS`.
        start_s: when it begins, on the true clock.
        duration_s: how long it lasts.
        num_shown: how often it has shown.
        must_stop: whether it has shown in a way after which the robot must not move.
    """

    kind: str
    start_s: float
    duration_s: float
    num_shown: int = 0
    must_stop: bool = False

    def shows(self, time_s: float, *kinds: str) -> bool:
        """Whether it is one of ``kinds`` and shows now."""
        shows = self.kind in kinds and self.start_s <= time_s < self.start_s + self.duration_s
        self.num_shown += shows
        return shows


class MonitoredCell:
    """Knows what is true: when images were exposed and what they show, and when the robot moved.

    Attributes:
        truth: returns the true scene and state.
        blind: reasons of blind motions.
        num_motions: commands to arm and fingers.
        decided: the state of the last decision.
        fault: what the loop is told; set by the harness.
    """

    def __init__(self, cell: Any, truth: Callable[[], tuple[Scene, State]]) -> None:
        self.cell, self.truth = cell, truth
        self.blind: list[str] = []
        self.num_motions = 0
        self.decided: State | None = None
        self.fault: Fault | None = None
        self.seen: tuple[float, State] | None = None
        self._exposures: dict[bytes, tuple[float, Scene, State]] = {}
        self._moved_at = self._commanded_at = -math.inf

    def now(self) -> float:
        return self.cell.now()

    def wait(self, duration_s: float) -> None:
        was_moving = self.is_moving()
        self.cell.wait(duration_s)
        if was_moving or self.is_moving():
            self._moved_at = self.cell.now()

    def is_moving(self) -> bool:
        return bool(np.abs(self.cell.arm().velocities).max() > 0.02) or self.cell.gripper().is_moving

    def frame(self) -> CameraFrame:
        frame = self.cell.frame()
        self._exposures[frame.image.tobytes()] = (self.cell.now(), *self.truth())
        return frame

    def arm(self) -> ArmState:
        return self.cell.arm()

    def gripper(self) -> GripperState:
        return self.cell.gripper()

    def interpreted(self, image: Any) -> tuple[Scene, State]:
        """The scene and state that an image shows."""
        self.seen = None
        if not isinstance(image, np.ndarray) or image.tobytes() not in self._exposures:
            raise PerceptionError("the image shows nothing that is known")
        time_s, scene, state = self._exposures[image.tobytes()]
        self.seen = time_s, state
        return scene, state

    def follow(self, trajectory: JointTrajectory) -> None:
        self._judge()
        self.cell.follow(trajectory)

    def move_gripper(self, opening: float) -> None:
        self._judge()
        self.cell.move_gripper(opening)

    def _judge(self) -> None:
        now = self.cell.now()
        if now == self._commanded_at:  # arm and fingers of one action
            return
        self.num_motions, self._commanded_at = self.num_motions + 1, now
        if self.seen is None:
            self.blind.append("rests on no image, or on one that cannot be interpreted")
            return
        exposed, state = self.seen
        if exposed <= self._moved_at:
            self.blind.append(f"rests on an image of {exposed:.2f} s, and the robot moved at {self._moved_at:.2f} s")
        if now - exposed > LIMITS.max_view_age_s + 0.05:
            self.blind.append(f"rests on an image that is {now - exposed:.2f} s old")
        if self.decided is None or self.decided.num_objects != state.num_objects:
            self.blind.append("was decided for another number of objects")
        elif np.abs(self.decided.object_positions - state.object_positions).max() > SAME_POSITION:
            self.blind.append("was decided for another scene")
        if self.fault is not None and self.fault.must_stop:
            self.blind.append(f"follows the fault '{self.fault.kind}'")

    def stop(self) -> None:
        self.cell.stop()

    def close(self) -> None:
        self.cell.close()
