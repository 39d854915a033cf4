"""Timing of joint motions: a smooth profile along a path, slow enough for the tool, the joints and their motors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np
from pydantic import Field

from visualrhp.embodiment.robot_cell import ArmLimits, JointTrajectory
from visualrhp.errors import UnreachableError
from visualrhp.parameters import Positive, parameters
from visualrhp.types import FloatArray

_LONGEST = 600.0  # [s]; a path that jumps would take for ever


@parameters
class MotionParameters:
    """How fast the tool moves.

    Attributes:
        speed: largest speed of the point of the tool that moves furthest [m/s].
        ramp_s: time from rest to full speed [s].
        brake_s: time from full speed to rest [s]. Fruit rolls on if the gripper brakes faster than the table brakes the
            fruit: a sphere of 4 cm radius, whose rolling friction is 1 mm, loses 0.17 m/s in a second.
        period_s: largest time between samples of a trajectory [s]; 8 ms are the cycle of many robot controllers.
    """

    speed: Positive = 0.1
    ramp_s: Positive = 0.3
    brake_s: Positive = 1.0
    period_s: Annotated[float, Field(gt=0, le=0.1)] = 0.008


def progress(times: FloatArray, duration: float, ramp: float, brake: float) -> FloatArray:
    """The part of a motion [K] that is done at ``times`` [K] [s]: from 0 to 1, at rest at both ends.

    The speed rises as (1 - cos) / 2 in ``ramp`` seconds, is constant, and falls in the same way in ``brake`` seconds;
    speed and acceleration are continuous. The largest speed is 1 / (duration - (ramp + brake) / 2), the largest
    acceleration pi / 2 / ramp times as much.

    Args:
        times: within [0, duration].
        duration: of the motion [s], at least ``ramp + brake``.
        ramp: duration of the acceleration [s].
        brake: duration of the deceleration [s].
    """

    def risen(t: FloatArray, ramp: float) -> FloatArray:
        return 0.5 * t - 0.5 * ramp / np.pi * np.sin(np.pi * t / ramp)

    rising, falling = risen(np.minimum(times, ramp), ramp), risen(np.minimum(duration - times, brake), brake)
    cruising = np.clip(times, ramp, duration - brake) - ramp
    return (rising + cruising + 0.5 * brake - falling) / (duration - 0.5 * (ramp + brake))


def timed(
    curve: Callable[[FloatArray], FloatArray],
    length: float,
    limits: ArmLimits,
    motion: MotionParameters | None = None,
) -> JointTrajectory:
    """Time a path so that no limit is exceeded.

    Args:
        curve: joint positions [K, 6] [rad] at the parts [K] of the path, from 0 to 1; smooth.
        length: of the way of the point of the tool that moves furthest [m].
        limits: of the joints.
        motion: how fast the tool may be.

    Raises:
        UnreachableError: a position is outside the limits, not finite, or not reached within the limits of the speed.
    """
    motion = motion or MotionParameters()
    ramp, brake = motion.ramp_s, motion.brake_s
    mean_ramp = 0.5 * (ramp + brake)
    duration = max(length / motion.speed, mean_ramp) + mean_ramp
    while duration < _LONGEST:
        times = np.linspace(0.0, duration, max(int(np.ceil(duration / motion.period_s)), 2) + 1)
        trajectory = JointTrajectory(times, curve(progress(times, duration, ramp, brake)))
        _check_positions(trajectory, limits)
        excess = _excess(trajectory, limits)
        if excess <= 1.0:
            return trajectory
        slower = 1.02 * excess
        duration, ramp, brake = slower * duration, slower * ramp, slower * brake
    raise UnreachableError(
        f"a joint would move faster than its limit in a motion of {length:.3f} m, or the motion would "
        f"take longer than {_LONGEST:g} s: the path jumps in the joints"
    )


def _check_positions(trajectory: JointTrajectory, limits: ArmLimits) -> None:
    positions = trajectory.positions
    outside = ~((positions >= limits.lower) & (positions <= limits.upper))  # NaN is outside, too
    if outside.any():
        sample, joint = np.argwhere(outside)[0]
        raise UnreachableError(
            f"joint {joint + 1} would be at {positions[sample, joint]:.3f} rad, and its range is "
            f"[{limits.lower[joint]:.3f}, {limits.upper[joint]:.3f}]"
        )


def _excess(trajectory: JointTrajectory, limits: ArmLimits) -> float:
    """The factor by which the motion is too fast; at most 1 if it is not."""
    step = trajectory.times[1]
    velocities = np.diff(trajectory.positions, axis=0) / step
    at_rest = np.zeros((1, velocities.shape[1]))
    accelerations = np.diff(np.concatenate([at_rest, velocities, at_rest]), axis=0) / step
    by_speed = (np.abs(velocities) / limits.velocity).max()
    by_acceleration = (np.abs(accelerations) / limits.acceleration).max()
    return float(max(by_speed, np.sqrt(by_acceleration)))
