"""Values that a robot cell exchanges."""

from __future__ import annotations

import numpy as np

from visualrhp.embodiment.robot_cell import NUM_JOINTS, ArmLimits, JointTrajectory


def test_a_trajectory_has_a_duration() -> None:
    assert JointTrajectory(np.array([0.0, 0.5]), np.zeros((2, NUM_JOINTS))).duration == 0.5


def test_the_limits_are_those_of_the_data_sheet() -> None:
    """UR5e: all joints +-360 degrees but the elbow, +-180; 180 degrees a second."""
    limits = ArmLimits()
    assert np.allclose(np.degrees(limits.upper), [360, 360, 180, 360, 360, 360])
    assert np.array_equal(limits.lower, -limits.upper)
    assert np.allclose(np.degrees(limits.velocity), 180.0)
