"""Timing of joint motions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visualrhp.embodiment.robot_cell import ArmLimits
from visualrhp.embodiment.trajectories import MotionParameters, progress, timed
from visualrhp.errors import ConfigError, UnreachableError


def straight(change: float) -> object:
    """All joints move from 0 to ``change`` [rad]."""
    return lambda parts: np.outer(parts, np.full(6, change))


def test_progress_by_hand() -> None:
    """1 s of acceleration, 1 s of cruise, 2 s of braking: at speed 1 / 2.5, of which 0.2 are done after the first."""
    done = progress(np.array([0.0, 1.0, 2.0, 3.0, 4.0]), 4.0, 1.0, 2.0)
    half_braked = 0.5 * 1.0 - 0.5 * 2.0 / np.pi  # the way that is left, in units of the speed times a second
    assert done == pytest.approx([0.0, 0.2, 0.6, 1.0 - 0.4 * half_braked, 1.0])


@given(st.floats(0.1, 2.0), st.floats(0.1, 2.0), st.floats(1.0, 5.0))
def test_progress_is_smooth(ramp: float, brake: float, ratio: float) -> None:
    duration = (ramp + brake) * ratio
    times = np.linspace(0.0, duration, 2001)
    done = progress(times, duration, ramp, brake)
    speed = np.gradient(done, times)
    acceleration = np.gradient(speed, times)
    largest = 1.0 / (duration - 0.5 * (ramp + brake))
    assert (speed > -1e-9).all()
    assert speed.max() <= (1.0 + 1e-3) * largest
    assert acceleration.max() <= 1.01 * np.pi / 2.0 / ramp * largest
    assert -acceleration.min() <= 1.01 * np.pi / 2.0 / brake * largest
    assert progress(duration - times, duration, brake, ramp) == pytest.approx(1.0 - done)


def test_the_tool_has_the_speed_that_was_asked_for() -> None:
    motion = MotionParameters(speed=0.1, ramp_s=0.2, brake_s=0.4)
    assert timed(straight(0.1), 0.1, ArmLimits(), motion).duration == pytest.approx(1.0 + 0.3)
    assert timed(straight(0.0), 0.0, ArmLimits(), motion).duration == pytest.approx(0.6)


@given(st.floats(0.0, 3.0), st.floats(0.3, 2.0), st.floats(0.5, 5.0), st.floats(0.0, 0.2))
def test_limits_hold(change: float, speed: float, acceleration: float, length: float) -> None:
    limits = ArmLimits(velocity=np.full(6, speed), acceleration=np.full(6, acceleration))
    trajectory = timed(straight(change), length, limits)
    steps = np.diff(trajectory.times)
    velocities = np.diff(trajectory.positions, axis=0) / steps[:, None]
    rest = np.zeros((1, 6))
    accelerations = np.diff(np.concatenate([rest, velocities, rest]), axis=0) / steps[0]
    assert abs(velocities).max() <= speed * (1 + 1e-9)
    assert abs(accelerations).max() <= acceleration * (1 + 1e-9)
    assert trajectory.times[0] == 0.0 and (steps > 0.0).all() and steps.max() <= MotionParameters().period_s + 1e-12
    assert trajectory.positions[0] == pytest.approx(np.zeros(6))
    assert trajectory.positions[-1] == pytest.approx(np.full(6, change))


@pytest.mark.parametrize("bad", [np.nan, np.inf, 7.0])
def test_positions_outside_the_range_are_refused(bad: float) -> None:
    with pytest.raises(UnreachableError, match=r"joint 3 would be at .*, and its range is \[-3.142, 3.142\]"):
        timed(lambda parts: np.where(np.arange(6) == 2, bad, np.zeros((len(parts), 6))), 0.1, ArmLimits())


def test_a_jump_in_the_joints_is_refused() -> None:
    with pytest.raises(UnreachableError, match="the path jumps in the joints"):
        timed(lambda parts: np.where(parts[:, None] < 0.5, 0.0, np.ones(6)), 0.1, ArmLimits())


@pytest.mark.parametrize("name", ["speed", "ramp_s", "brake_s", "period_s"])
def test_parameters_are_positive(name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        MotionParameters(**{name: 0.0})
