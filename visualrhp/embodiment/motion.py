"""A motion of the robot: every limit is checked before it starts, and the arm is watched until it is at rest again."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from visualrhp.embodiment.robot_cell import ArmLimits, ArmState, JointTrajectory
from visualrhp.embodiment.robot_model import GRIPPER_HEIGHT
from visualrhp.embodiment.watchdog import WatchedCell
from visualrhp.errors import CellFault, UnreachableError
from visualrhp.parameters import Positive, parameters
from visualrhp.simulation.action_spaces import GripperMotion
from visualrhp.types import FloatArray, wrap_angle

_NUM_LOOKED_AT = 24
"""Samples of a trajectory whose tool pose is checked, and of its recent part with which the arm is compared."""
_SLACK = 1.0 + 1e-6
_ACCELERATION_SLACK = 1.25
"""Second differences of a sampled trajectory exceed its acceleration a little."""
_NO_ROOM = 5e-4
"""A finger that moves by less than this has not moved [m]."""


class Kinematics(Protocol):
    """What a motion needs of the arm: :class:`visualrhp.embodiment.kinematics.ArmKinematics`."""

    def forward(self, joints: FloatArray, /) -> Any:
        """The pose of the tool, with x, y, height [m], theta and tilt [rad], of joint positions [6] [rad]."""
        ...

    def path(self, start: FloatArray, motion: GripperMotion, /) -> JointTrajectory:
        """The straight motion from joint positions [6]. Raises UnreachableError."""
        ...


@parameters
class MotionLimits:
    """What a commanded motion keeps to. SI units.

    Attributes:
        max_duration_s: of one motion.
        max_deviation: from the commanded line, and from the height of the gripper [m].
        max_rotation_deviation: from the commanded heading, and from the level [rad].
        workspace: half the side of the square about the table's centre in which the gripper frame stays [m].
    """

    max_duration_s: Positive = 10.0
    max_deviation: Positive = 0.002
    max_rotation_deviation: Positive = math.radians(0.5)
    workspace: Positive = 0.45


def check_trajectory(
    trajectory: JointTrajectory,
    arm: ArmState,
    motion: GripperMotion,
    kinematics: Kinematics,
    limits: MotionLimits,
    arm_limits: ArmLimits,
) -> None:
    """Check a motion before anything moves, by other means than those by which it was computed.

    Raises:
        UnreachableError: it does not start where the arm is, leaves a limit of the arm or the workspace, or is not the
            commanded line.
    """
    times, positions = np.asarray(trajectory.times), np.asarray(trajectory.positions)
    if times.ndim != 1 or len(times) < 2 or positions.shape != (len(times), len(arm.positions)):
        raise _refused(f"has times {list(times.shape)} and positions {list(positions.shape)}, not [K] and [K, 6]")
    if not (np.isfinite(times).all() and np.isfinite(positions).all()):
        raise _refused("is not finite")
    steps = np.diff(times)
    if times[0] != 0.0 or (steps <= 0.0).any() or times[-1] > limits.max_duration_s:
        raise _refused(f"does not take from 0 s to at most {limits.max_duration_s:g} s, with increasing times")
    if (offset := np.abs(positions[0] - arm.positions).max()) > 1e-3:
        raise _refused(f"starts {offset:.4f} rad from where the arm is")
    if (positions < arm_limits.lower).any() or (positions > arm_limits.upper).any():
        raise _refused("leaves the range of a joint")
    speeds = np.diff(positions, axis=0) / steps[:, None]
    if (fastest := (np.abs(speeds) / arm_limits.velocity).max()) > _SLACK:
        raise _refused(f"is {fastest:.2f} times as fast as a joint may move")
    # The arm is at rest before and after.
    changes = np.diff(np.vstack([np.zeros_like(speeds[:1]), speeds, np.zeros_like(speeds[:1])]), axis=0)
    spans = np.concatenate([steps[:1], 0.5 * (steps[1:] + steps[:-1]), steps[-1:]])
    strongest = (np.abs(changes) / spans[:, None] / arm_limits.acceleration).max()
    if strongest > _ACCELERATION_SLACK:
        raise _refused(f"accelerates a joint {strongest:.2f} times as much as allowed")
    _check_line(positions, motion, kinematics, limits)


def _check_line(positions: FloatArray, motion: GripperMotion, kinematics: Kinematics, limits: MotionLimits) -> None:
    """Check that the tool moves on the commanded line, level, at its height and in the workspace."""
    start = kinematics.forward(positions[0])
    c, s = math.cos(start.theta), math.sin(start.theta)
    way = np.array([c * motion.forward - s * motion.left, s * motion.forward + c * motion.left])
    # Distances in units of what is allowed, so that a part of the motion is found whatever it consists of.
    scale = np.array([limits.max_deviation, limits.max_deviation, limits.max_rotation_deviation])
    whole = np.array([*way, motion.rotation]) / scale
    size = float(whole @ whole)
    for index in np.unique(np.linspace(0, len(positions) - 1, _NUM_LOOKED_AT).round().astype(int)):
        pose = kinematics.forward(positions[index])
        offset = np.array([pose.x - start.x, pose.y - start.y])
        turned = wrap_angle(pose.theta - start.theta)
        part = np.array([*offset, turned]) / scale
        done = min(max(float(part @ whole) / size, 0.0), 1.0) if size > 0.0 else 0.0
        if index == len(positions) - 1:
            done = 1.0
        if (deviation := float(np.hypot(*(offset - done * way)))) > limits.max_deviation:
            raise _refused(f"is {1e3 * deviation:.1f} mm from the commanded line")
        if (error := abs(wrap_angle(turned - done * motion.rotation))) > limits.max_rotation_deviation:
            raise _refused(f"is {math.degrees(error):.2f} degrees from the commanded heading")
        if (error := abs(pose.height - GRIPPER_HEIGHT)) > limits.max_deviation:
            raise _refused(f"is {1e3 * error:.1f} mm from the height of the gripper")
        if abs(pose.tilt) > limits.max_rotation_deviation:
            raise _refused(f"tilts the gripper by {math.degrees(pose.tilt):.2f} degrees")
        if max(abs(pose.x), abs(pose.y)) > limits.workspace:
            raise _refused(f"leaves the workspace, at ({pose.x:.3f}, {pose.y:.3f}) m")


def _refused(what: str) -> UnreachableError:
    return UnreachableError(f"the motion was refused before it started: the computed trajectory {what}")


def execute(cell: WatchedCell, trajectory: JointTrajectory | None, opening: float | None) -> float:
    """Command a motion of the arm and the fingers, and watch it until both are at rest.

    Args:
        cell: the cell, at rest.
        trajectory: of the arm; None if only the fingers move.
        opening: to which the fingers move [m], until they hold something; None to leave them.

    Returns:
        The time that it took on the cell's clock [s].

    Raises:
        CellFault: a device reports a fault or something impossible, the arm does not follow, or the gripper does not
            move. The caller stops the robot.
    """
    limits = cell.limits
    before = cell.gripper()
    if trajectory is not None:
        cell.follow(trajectory)
    started = cell.now()
    if opening is not None:
        cell.move_gripper(opening)
    if trajectory is not None:
        while True:
            now = cell.wait(limits.control_period_s)
            arm = cell.arm()
            cell.gripper()
            _check_following(trajectory, arm, started, limits.max_lag_s, limits.max_tracking_error)
            if now - started >= trajectory.duration:
                break
    else:
        cell.wait(limits.control_period_s)
    if trajectory is not None:
        # An arm is at rest for a moment before it starts late; what counts is where it is.
        end = started + trajectory.duration + limits.max_lag_s
        while _rest_error(trajectory, cell.arm()) > limits.rest_error and cell.now() < end:
            cell.wait(limits.control_period_s)
        _check_end(trajectory, cell.arm(), limits.rest_error)
    arm, after = cell.rest()
    if trajectory is not None:
        _check_end(trajectory, arm, limits.rest_error)
        cell.settle()
    if opening is not None:
        after = _watch_fingers(cell, before.opening, opening)
    return after.time_s - started


def _watch_fingers(cell: WatchedCell, before: float, opening: float) -> Any:
    """Wait until fingers that have to move have moved, and are at rest; return the state of the gripper."""
    end = cell.now() + cell.limits.max_settle_s
    while True:
        state = cell.rest()[1]
        # What is held may stop the fingers anywhere but where they are fully open.
        is_stuck = abs(opening - state.opening) > 2e-3 and abs(state.opening - before) < _NO_ROOM
        is_held = opening < before and before < cell.stroke - 2e-3
        if not is_stuck or is_held:
            return state
        if cell.now() > end:
            what = "close" if opening < before else "open"
            raise CellFault(
                f"the gripper does not {what}: its fingers are {1e3 * state.opening:.1f} mm apart, as before, "
                f"{cell.limits.max_settle_s:g} s after they were commanded to {1e3 * opening:.1f} mm"
            )
        cell.wait(cell.limits.control_period_s)


def _check_end(trajectory: JointTrajectory, arm: ArmState, limit: float) -> None:
    if (error := _rest_error(trajectory, arm)) > limit:
        raise CellFault(f"the arm came to rest {error:.3f} rad from the end of its motion")


def _rest_error(trajectory: JointTrajectory, arm: ArmState) -> float:
    return float(np.abs(arm.positions - trajectory.positions[-1]).max())


def _check_following(
    trajectory: JointTrajectory, arm: ArmState, started: float, max_lag_s: float, max_error: float
) -> None:
    """Check that the arm is where it was commanded to be within the last ``max_lag_s``."""
    since = arm.time_s - started
    times = np.linspace(since - max_lag_s, since + 1e-3, _NUM_LOOKED_AT)
    commanded = np.stack([np.interp(times, trajectory.times, joint) for joint in trajectory.positions.T], axis=1)
    error = float(np.abs(arm.positions - commanded).max(axis=1).min())
    if error > max_error:
        raise CellFault(
            f"the arm does not follow: {since:.2f} s after the start, it is {error:.3f} rad from what was commanded "
            f"within the last {max_lag_s:g} s; at most {max_error:g} rad are allowed"
        )
