"""A robot cell whose devices fail.

Layers, from the outside: the loop (:class:`~visualrhp.embodiment.robot_world.RobotWorld`), :class:`FaultyCell` (what
the loop is told), :class:`~tests.torture.robot_monitor.MonitoredCell` (what is true), the cell.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from tests.torture.robot_monitor import LIMITS, Fault, MonitoredCell
from visualrhp.embodiment.robot_cell import ArmState, CameraFrame, GripperState, JointTrajectory
from visualrhp.errors import CellFault, PerceptionError
from visualrhp.planning.planner import Decision, Planner
from visualrhp.scene.scene import Scene
from visualrhp.types import State

CAMERA = ("lost", "broken", "repeated", "frozen", "late", "black", "torn", "future", "timeless", "small", "floating")
ARM = (
    "protective stop",
    "silent",
    "nothing",
    "nan",
    "jump",
    "out of range",
    "stale",
    "spinning",
    "no time",
    "too fast",
)
MOTION = ("refused", "stuck", "lagging", "halfway", "astray", "drifting")
GRIPPER = ("gripper fault", "gripper silent", "gripper nan", "gripper stuck", "gripper busy", "gripper stale")
CLOCK = ("stands still", "jumps ahead", "goes back", "clock nan", "clock silent")
SIGHT = ("flicker", "unclear", "perception bug", "no numbers")
WORLD = ("vanished", "appeared", "moved by hand", "dropped")
PLANNER = ("planner raises", "no action", "nan action", "wrong action", "slow", "slow and moved")
KINDS: Final = (*CAMERA, *ARM, *MOTION, *GRIPPER, *CLOCK, *SIGHT, *WORLD, *PLANNER)


class FaultyCell:
    """Tells the loop something else than what is true while its fault shows."""

    def __init__(self, cell: MonitoredCell, fault: Fault, seed: int) -> None:
        self.cell, self.fault = cell, fault
        self.num_stops = 0
        self._rng = np.random.default_rng(seed)
        self._frame: CameraFrame | None = None
        self._past: list[CameraFrame] = []
        self._arm: ArmState | None = None
        self._gripper: GripperState | None = None
        self._still_time: float | None = None
        self._is_drifting = False

    def _shows(self, *kinds: str) -> bool:
        return self.fault.shows(self.cell.now(), *kinds)

    # The clock
    def now(self) -> float:
        true = self.cell.now()
        if self._shows("stands still"):
            self._still_time = true if self._still_time is None else self._still_time
            return self._still_time
        if self._shows("clock nan"):
            self.fault.must_stop = True
            return math.nan
        if self._shows("clock silent"):
            self.fault.must_stop = True
            raise OSError("no clock")
        if self._shows("goes back"):
            self.fault.must_stop = True
            return true - 5.0
        return true + (10.0 if self._shows("jumps ahead") else 0.0)

    def wait(self, duration_s: float) -> None:
        if self._shows("drifting") and not self.cell.is_moving():
            self._drift()
        self.cell.wait(duration_s)

    def _drift(self) -> None:
        """The arm moves by itself: a following error, or someone pushes it."""
        if not self._is_drifting:
            self._is_drifting = True
            start = self.cell.arm().positions
            way = np.array([0.15, 0.0, 0.0, 0.0, 0.0, 0.0])
            self.cell.cell.follow(JointTrajectory(np.array([0.0, 0.8]), np.stack([start, start + way])))

    # The camera
    def frame(self) -> CameraFrame:
        frame = self.cell.frame()
        self._past.append(frame)
        if self._shows("lost"):
            raise CellFault("the camera gives no image")
        if self._shows("broken"):
            raise RuntimeError("VIDIOC_DQBUF: no such device")
        old = self._frame
        if old is not None and self._shows("repeated"):
            return old
        if old is not None and self._shows("frozen"):
            return replace(old, time_s=frame.time_s)
        if self._shows("late"):
            late = [past for past in self._past if past.time_s < frame.time_s - 0.7]
            return late[-1] if late else self._past[0]
        self._frame = frame
        if self._shows("black"):
            return CameraFrame(np.zeros_like(frame.image), frame.time_s)
        if self._shows("torn"):
            image = frame.image.copy()
            image[len(image) // 2 :] = 0
            return CameraFrame(image, frame.time_s)
        if self._shows("future"):
            return CameraFrame(frame.image, frame.time_s + 3.0)
        if self._shows("timeless"):
            return CameraFrame(frame.image, math.nan)
        if self._shows("small"):
            return CameraFrame(frame.image[::2, ::2].copy(), frame.time_s)
        if self._shows("floating"):
            return CameraFrame(frame.image / 255.0, frame.time_s)
        return frame

    # The arm
    def arm(self) -> ArmState:
        state = self.cell.arm()
        last, self._arm = self._arm, state
        if self.fault.kind not in ARM or last is None or not self._shows(*ARM):
            return state
        self.fault.must_stop = True
        q, v, t = state.positions.copy(), state.velocities.copy(), state.time_s
        match self.fault.kind:
            case "protective stop":
                self.cell.stop()
                return ArmState(q, v, t, "protective stop C153")
            case "silent":
                raise ConnectionResetError("connection reset by peer")
            case "nothing":
                return None  # type: ignore[return-value]
            case "nan" | "stop raises":
                q[2] = math.nan
            case "jump":
                q[1] += 0.4
            case "out of range":
                q[3] = 7.5
            case "stale":
                self._arm = last
                self.fault.must_stop = t - last.time_s > LIMITS.max_state_age_s
                return last
            case "spinning":
                self.fault.must_stop = False  # it looks like a motion that goes on
                v[4] = 0.3
            case "no time":
                t = math.nan
            case "too fast":
                v[0] = 40.0
        return ArmState(q, v, t)

    def follow(self, trajectory: JointTrajectory) -> None:
        if self._shows("refused"):
            self.fault.must_stop = True
            raise CellFault("the controller refuses: it is not in remote control")
        times, positions = trajectory.times, trajectory.positions
        is_long = np.abs(positions[-1] - positions[0]).max() > 0.1
        if is_long and self._shows("stuck", "lagging", "halfway", "astray"):
            match self.fault.kind:
                case "stuck":
                    positions = np.repeat(positions[:1], len(times), axis=0)
                case "lagging":
                    times = np.concatenate([[0.0], times + 0.6])
                    positions = np.vstack([positions[:1], positions])
                case "halfway":
                    positions = positions[: len(times) // 2]
                    times = times[: len(times) // 2]
                case "astray":
                    positions = positions + np.outer(times / times[-1], [0.2, -0.2, 0.0, 0.0, 0.0, 0.0])
            self.cell.follow(JointTrajectory(times, positions))
            self.fault.must_stop = True
            return
        self.cell.follow(trajectory)

    # The gripper
    def gripper(self) -> GripperState:
        state = self.cell.gripper()
        last, self._gripper = self._gripper, state
        if self._shows("gripper fault"):
            self.fault.must_stop = True
            return replace(state, fault="overcurrent")
        if self._shows("gripper silent"):
            self.fault.must_stop = True
            raise TimeoutError("timed out")
        if self._shows("gripper nan"):
            self.fault.must_stop = True
            return replace(state, opening=math.nan)
        if self._shows("gripper busy"):
            return replace(state, is_moving=True)
        if last is not None and self._shows("gripper stale"):
            self._gripper = last
            self.fault.must_stop = state.time_s - last.time_s > LIMITS.max_state_age_s
            return last
        return state

    def move_gripper(self, opening: float) -> None:
        if abs(opening - self.cell.gripper().opening) > 0.01 and self._shows("gripper stuck"):
            return
        self.cell.move_gripper(opening)

    def stop(self) -> None:
        self.num_stops += 1
        self.cell.stop()
        if self.fault.kind == "stop raises" and self.fault.must_stop:
            raise OSError("no connection")

    def close(self) -> None:
        self.cell.close()


@dataclass(frozen=True)
class Seen:
    """A view."""

    scene: Scene
    state: State


class FaultyPerception:
    """Interprets an image by what was exposed, and fails or is wrong while its fault shows."""

    def __init__(self, cell: MonitoredCell, fault: Fault, seed: int) -> None:
        self.cell, self.fault = cell, fault
        self._rng = np.random.default_rng(seed)

    def perceive(self, frame: CameraFrame, arm: ArmState, gripper: GripperState, closed: bool) -> Seen:
        scene, state = self.cell.interpreted(frame.image)
        now = self.cell.now()
        poses = state.object_poses
        if self.fault.shows(now, "unclear"):
            self.cell.seen = None
            raise PerceptionError("the desired object is not in the image")
        if self.fault.shows(now, "perception bug"):
            self.cell.seen = None
            raise ValueError("zero-size array to reduction operation maximum which has no identity")
        if self.fault.shows(now, "no numbers"):
            self.cell.seen = None
            vector = state.vector.copy()
            vector[5] = math.nan
            return Seen(scene, State(vector))
        if len(poses) > 1 and self._rng.random() < 0.5 and self.fault.shows(now, "flicker"):
            scene, poses = replace(scene, objects=scene.objects[:-1]), poses[:-1]
        seen = State.create(state.gripper_pose, gripper.opening, closed, poses)
        self.cell.seen = now if self.cell.seen is None else self.cell.seen[0], seen
        return Seen(scene, seen)


class FaultyPlanner(Planner):
    """Decides as another planner, and fails while its fault shows.

    Args:
        planner: that decides.
        cell: which is told what was decided.
        fault: of the planner, or of the world while the planner decides.
        disturb: changes the true scene: a kind of :data:`WORLD` to nothing.
    """

    name = "Faulty"

    def __init__(self, planner: Planner, cell: MonitoredCell, fault: Fault, disturb: Callable[[str], None]) -> None:
        self.planner, self.cell, self.fault, self.disturb = planner, cell, fault, disturb

    def start(self, model, rng):
        policy = self.planner.start(model, rng)

        def faulty(state: State) -> Decision:
            self.cell.decided = state
            now = self.cell.now()
            if self.fault.shows(now, "slow", "slow and moved"):
                self.cell.wait(2.0)
                if self.fault.kind == "slow and moved":
                    self.disturb("moved by hand")
            if self.fault.kind in WORLD and not self.fault.num_shown and self.fault.shows(now, *WORLD):
                self.disturb(self.fault.kind)
            if self.fault.shows(now, "planner raises"):
                raise ZeroDivisionError("float division by zero")
            if self.fault.shows(now, "no action"):
                return Decision(None)
            if self.fault.shows(now, "nan action"):
                return Decision(np.full(4, np.nan))
            if self.fault.shows(now, "wrong action"):
                return Decision("forward")  # type: ignore[arg-type]
            return policy(state)

        return faulty
