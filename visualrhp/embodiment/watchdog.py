"""The watchdog of a robot cell: what its devices report is checked before it is used, and a fault ends at rest.

Nothing that a device reports is believed: a state has to be fresh, finite, within the limits of the arm and close to
the one before; a frame has to be exposed after the robot came to rest, and to show something new; the clock has to run.
The rest of the loop talks to the cell through :class:`WatchedCell` only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.robot_cell import (
    NUM_JOINTS,
    ArmLimits,
    ArmState,
    CameraFrame,
    GripperState,
    JointTrajectory,
    RobotCell,
)
from visualrhp.errors import CellFault, PerceptionError, SimulationError
from visualrhp.parameters import Positive, parameters

_T = TypeVar("_T")

_CLOCK_TOLERANCE = 0.02
"""How far a time stamp may lie in the future [s]: clocks of devices are translated with an error."""
_JOINT_TOLERANCE = 0.02
"""How far a reported joint may lie beyond its limit [rad]."""
_OPENING_TOLERANCE = 0.003
"""How far a reported opening may lie beyond the stroke [m]."""
_SPEED_TOLERANCE = 1.3
"""Reported joint speeds may exceed their limit by this factor, since they are noisy."""
_JUMP = 0.05
"""Change of a joint between two reports [rad] that needs no time: noise."""
_BLACK_MEAN, _BLACK_CONTRAST = 6.0, 2.0
"""Mean and standard deviation of the grey levels of an image that shows nothing (of 255)."""
_SAMPLING = 8
"""Every eighth pixel is looked at."""


@parameters
class WatchdogLimits:
    """How old, how late and how wrong what the cell reports may be before the robot is stopped. SI units.

    The defaults are choices for a planar task at 0.15 m/s; at this speed, an arm that stops following is stopped within
    a few millimetres. They are not a certified safety function: a real cell keeps its emergency stop and the safety
    limits of its controller.

    Attributes:
        max_view_age_s: from the exposure of a frame to the start of a motion that is planned with it.
        max_state_age_s: age of the state of arm or gripper when it is read.
        max_frame_wait_s: for a new, usable frame.
        control_period_s: between two looks at the arm while it moves.
        max_clock_step_s: by which the clock may advance more than it was waited for.
        max_tracking_error: between measured and commanded joints in motion [rad].
        max_lag_s: by which the arm may be behind its command.
        max_settle_s: from the end of a commanded motion until arm and gripper are at rest.
        rest_speed: joint speed below which the arm is at rest [rad/s].
        rest_error: between the joints at rest and the end of the commanded motion [rad].
        max_drift: change of a joint [rad] since a frame was exposed, above which its view is old.
        max_opening_drift: the same of the opening of the gripper [m].
        max_stop_s: until an arm that is stopped is at rest.
        sensor_noise: whether two images of the camera are never identical, so that identical ones are a frozen camera.
    """

    max_view_age_s: Positive = 0.6
    max_state_age_s: Positive = 0.2
    max_frame_wait_s: Positive = 1.0
    control_period_s: Positive = 0.02
    max_clock_step_s: Positive = 0.5
    max_tracking_error: Positive = 0.06
    max_lag_s: Positive = 0.15
    max_settle_s: Positive = 3.0
    rest_speed: Positive = 0.02
    rest_error: Positive = 0.02
    max_drift: Positive = 0.01
    max_opening_drift: Positive = 0.003
    max_stop_s: Positive = 1.0
    sensor_noise: bool = True


class WatchedCell:
    """A robot cell whose reports are checked.

    Every method raises CellFault where the cell's own would, where the cell raises anything else, and where a report is
    impossible; the message names the device, what it reported, and what would be right. No method stops the robot but
    :meth:`halt`.

    Args:
        cell: the cell.
        stroke: of its gripper [m].
        limits: see :class:`WatchdogLimits`.
        arm_limits: of the arm.

    Attributes:
        stroke, limits, arm_limits: as given.
        last_image: the image of the frame that was accepted last; None before the first.
    """

    def __init__(
        self, cell: RobotCell, stroke: float, limits: WatchdogLimits | None = None, arm_limits: ArmLimits | None = None
    ) -> None:
        self.stroke = stroke
        self.limits = limits or WatchdogLimits()
        self.arm_limits = arm_limits or ArmLimits()
        self.last_image: npt.NDArray[np.uint8] | None = None
        self._cell = cell
        self._last_time = -math.inf
        self._last_arm: ArmState | None = None
        self._is_settled = True  # no motion of the arm has been commanded that has not ended
        self._settled_at: npt.NDArray[np.float64] | None = None  # joint positions at rest
        self._last_gripper_time = -math.inf
        self._last_frame_time = -math.inf

    # ------------------------------------------------------------------------------------------------------- the clock
    def now(self) -> float:
        """Time of the cell's clock [s]."""
        time_s = _number(_ask("the clock", self._cell.now), "the clock reports", " s")
        if time_s < self._last_time:
            raise CellFault(f"the clock went back from {self._last_time:.3f} s to {time_s:.3f} s; it never may")
        self._last_time = time_s
        return time_s

    def wait(self, duration_s: float) -> float:
        """Let time pass, and return the time afterwards [s]."""
        before = self.now()
        _ask("the clock", lambda: self._cell.wait(duration_s))
        after = self.now()
        if after - before < 0.5 * duration_s:
            raise CellFault(
                f"the clock stands still: it advanced by {after - before:.4f} s in a wait of {duration_s:.4f} s"
            )
        if after - before > duration_s + self.limits.max_clock_step_s:
            raise CellFault(
                f"the clock advanced by {after - before:.3f} s while {duration_s:.3f} s were waited for; at most "
                f"{self.limits.max_clock_step_s:g} s more are allowed"
            )
        return after

    # ------------------------------------------------------------------------------------------------ arm and gripper
    def arm(self) -> ArmState:
        """The state of the arm."""
        return _ask("the arm", self._read_arm)

    def _read_arm(self) -> ArmState:
        state = self._cell.arm()
        if state.fault is not None:
            raise CellFault(f"the arm has a fault: {state.fault}")
        positions, velocities = _joints(state.positions, "positions"), _joints(state.velocities, "velocities")
        time_s = self._fresh(state.time_s, "arm")
        limits = self.arm_limits
        beyond = np.maximum(limits.lower - positions, positions - limits.upper)
        if beyond.max() > _JOINT_TOLERANCE:
            joint = int(beyond.argmax())
            raise CellFault(
                f"the arm reports joint {joint} at {positions[joint]:.3f} rad; its range is "
                f"{limits.lower[joint]:.3f} to {limits.upper[joint]:.3f} rad"
            )
        if (np.abs(velocities) > _SPEED_TOLERANCE * limits.velocity).any():
            raise CellFault(
                f"the arm reports joint speeds of {np.abs(velocities).max():.2f} rad/s, above their limit of "
                f"{limits.velocity.max():.2f} rad/s"
            )
        last = self._last_arm
        if last is not None:
            if time_s < last.time_s:
                raise CellFault(f"the time stamps of the arm went back from {last.time_s:.3f} s to {time_s:.3f} s")
            step = np.abs(positions - last.positions)
            if (step > limits.velocity * (time_s - last.time_s) + _JUMP).any():
                raise CellFault(
                    f"the joints jumped by {step.max():.3f} rad in {time_s - last.time_s:.3f} s, faster than the arm "
                    "can move"
                )
        self._last_arm = ArmState(positions, velocities, time_s)
        return self._last_arm

    def gripper(self) -> GripperState:
        """The state of the gripper, its opening within the stroke."""
        return _ask("the gripper", self._read_gripper)

    def _read_gripper(self) -> GripperState:
        state = self._cell.gripper()
        if state.fault is not None:
            raise CellFault(f"the gripper has a fault: {state.fault}")
        opening = _number(state.opening, "the gripper reports an opening of", " m")
        if not -_OPENING_TOLERANCE <= opening <= self.stroke + _OPENING_TOLERANCE:
            raise CellFault(f"the gripper reports an opening of {opening:.4f} m; it is from 0 to {self.stroke:g} m")
        time_s = self._fresh(state.time_s, "gripper")
        if time_s < self._last_gripper_time:
            raise CellFault(
                f"the time stamps of the gripper went back from {self._last_gripper_time:.3f} s to {time_s:.3f} s"
            )
        self._last_gripper_time = time_s
        return GripperState(min(max(opening, 0.0), self.stroke), bool(state.is_moving), time_s)

    def _fresh(self, time_s: float, device: str) -> float:
        time_s, now = _number(time_s, f"the {device} reports a time stamp of", " s"), self.now()
        if now - time_s > self.limits.max_state_age_s:
            raise CellFault(
                f"the state of the {device} is {now - time_s:.3f} s old; at most {self.limits.max_state_age_s:g} s are "
                "allowed"
            )
        if time_s > now + _CLOCK_TOLERANCE:
            raise CellFault(f"the state of the {device} has a time stamp {time_s - now:.3f} s in the future")
        return time_s

    def rest(self, timeout_s: float | None = None) -> tuple[ArmState, GripperState]:
        """Wait until arm and gripper are at rest, and return their states.

        Args:
            timeout_s: time to wait at most [s]; ``max_settle_s`` by default.
        """
        timeout_s = self.limits.max_settle_s if timeout_s is None else timeout_s
        end = self.now() + timeout_s
        while True:
            arm, gripper = self.arm(), self.gripper()
            is_still = self.is_still(arm)
            if is_still and not gripper.is_moving:
                self._check_still_there(arm)
                return arm, gripper
            if self.now() > end:
                what = "gripper is still moving" if is_still else "arm is still moving"
                raise CellFault(f"the {what} {timeout_s:g} s after the end of its motion")
            self.wait(self.limits.control_period_s)

    def _check_still_there(self, arm: ArmState) -> None:
        """Check that an arm at rest is where it came to rest.

        Raises:
            CellFault: it has moved since.
        """
        if not self._is_settled:
            return
        if self._settled_at is None:
            self._settled_at = arm.positions
        drift = float(np.abs(arm.positions - self._settled_at).max())
        if drift > self.limits.max_drift:
            raise CellFault(f"the arm moved by {drift:.3f} rad without a command")

    def settle(self) -> None:
        """The last motion of the arm has ended: from now on, it is expected to stay where it is."""
        self._is_settled, self._settled_at = True, None

    def is_still(self, arm: ArmState) -> bool:
        """Whether the arm is at rest."""
        return bool(np.abs(arm.velocities).max() <= self.limits.rest_speed)

    # ------------------------------------------------------------------------------------------------------ the camera
    def frame_after(self, time_s: float) -> CameraFrame:
        """A frame that was exposed after ``time_s`` and shows something; lost, late and black ones are waited out.

        Raises:
            PerceptionError: there is none within ``max_frame_wait_s``; the message says what came instead.
            CellFault: the clock does not run.
        """
        end = self.now() + self.limits.max_frame_wait_s
        while True:
            try:
                frame, problem = _ask("the camera", lambda: self._read_frame(time_s))
            except CellFault as error:
                frame, problem = None, str(error)
            if frame is not None and problem is None:
                self._last_frame_time, self.last_image = float(frame.time_s), frame.image
                return frame
            if self.now() > end:
                raise PerceptionError(
                    f"the camera gives no usable image within {self.limits.max_frame_wait_s:g} s: {problem}"
                )
            self.wait(self.limits.control_period_s)

    def _read_frame(self, after: float) -> tuple[CameraFrame, str | None]:
        frame = self._cell.frame()
        return frame, self._frame_fault(frame, after)

    def _frame_fault(self, frame: CameraFrame, after: float) -> str | None:
        """Why a frame cannot be used; None if it can."""
        image, now = frame.image, self.now()
        time_s = _number(frame.time_s, "the camera reports a time stamp of", " s")
        if time_s > now + _CLOCK_TOLERANCE:
            return f"its time stamp lies {time_s - now:.3f} s in the future"
        if time_s <= after:
            return f"its newest image was exposed {now - time_s:.3f} s ago, before the robot came to rest"
        if time_s < self._last_frame_time:
            return f"its time stamps went back from {self._last_frame_time:.3f} s to {time_s:.3f} s"
        if not (isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3):
            return "its image is not an array [H, W, 3] of uint8"
        if self.last_image is not None:
            if image.shape != self.last_image.shape:
                return f"its image has the shape {list(image.shape)}, not {list(self.last_image.shape)} as before"
            if self.limits.sensor_noise and time_s > self._last_frame_time and np.array_equal(image, self.last_image):
                return "its image is frozen: no pixel differs from those of an earlier image"
        looked_at = image[::_SAMPLING, ::_SAMPLING]
        if looked_at.mean() < _BLACK_MEAN or looked_at.std() < _BLACK_CONTRAST:
            return "its image is black or shows nothing"
        if (np.ptp(looked_at, axis=1).max(axis=1) == 0).mean() > 0.25:
            return "its image is incomplete: whole rows have one colour"
        return None

    # ------------------------------------------------------------------------------------------------------- commands
    def follow(self, trajectory: JointTrajectory) -> None:
        """Start a motion of the arm."""
        self._is_settled = False
        _ask("the arm", lambda: self._cell.follow(trajectory))

    def move_gripper(self, opening: float) -> None:
        """Start a motion of the fingers."""
        _ask("the gripper", lambda: self._cell.move_gripper(opening))

    def halt(self) -> str | None:
        """Stop arm and gripper, and look whether they come to rest; never raises.

        Returns:
            None if the arm was seen to be at rest; otherwise why that is not known.
        """
        problem = "it was not asked"
        try:
            self._cell.stop()
            end = self.now() + self.limits.max_stop_s
            while self.now() <= end:
                state = _ask("the arm", self._cell.arm)
                velocities = _joints(state.velocities, "velocities")
                self._fresh(state.time_s, "arm")
                if np.abs(velocities).max() <= self.limits.rest_speed:
                    return None
                problem = f"it still moves at {np.abs(velocities).max():.3f} rad/s"
                self.wait(self.limits.control_period_s)
        except Exception as error:  # whatever is broken, the caller reports the first fault
            problem = str(error)
        return problem

    def close(self) -> None:
        """Stop, and release the devices."""
        self._cell.close()


def _ask(device: str, call: Callable[[], _T]) -> _T:
    """The result of a call of the cell; what a driver raises becomes a CellFault."""
    try:
        return call()
    except (CellFault, SimulationError):  # a simulated cell may diverge
        raise
    except Exception as error:
        raise CellFault(f"{device} does not answer: {type(error).__name__}: {error!s:.200}") from error


def _number(value: float, what: str, unit: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise CellFault(f"{what} {value!r:.60}, which is no number") from error
    if not math.isfinite(number):
        raise CellFault(f"{what} {number}{unit}, which is not finite")
    return number


def _joints(values: npt.ArrayLike, what: str) -> npt.NDArray[np.float64]:
    try:
        joints = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CellFault(f"the arm reports joint {what} that are no numbers") from error
    if joints.shape != (NUM_JOINTS,) or not np.isfinite(joints).all():
        raise CellFault(f"the arm reports joint {what} {joints.tolist()!s:.200}; they are {NUM_JOINTS} finite numbers")
    return joints
