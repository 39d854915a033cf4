"""A look at the whole table before an episode: the arm rises, turns aside, and returns the way it came.

At work, the arm hides up to a third of the table. What it hides in the first view is neither known nor planned with,
and what it hides in part gets a wrong outline. Before the first action, the robot therefore shows the camera the table
without the arm. Objects are not known yet: the gripper goes straight up to a height above all of them, and turns about
the first joint only.
"""

from __future__ import annotations

import math
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator

from visualrhp.embodiment.approach import CLEARANCE_HEIGHT
from visualrhp.embodiment.robot_cell import ArmLimits, JointTrajectory
from visualrhp.embodiment.robot_model import GRIPPER_RADIUS, Mounting
from visualrhp.embodiment.trajectories import MotionParameters, timed
from visualrhp.errors import UnreachableError
from visualrhp.types import FloatArray

ASIDE: Final = math.radians(105.0)
"""Direction, from the base, of the gripper when the arm is aside, against the direction to the table [rad]."""

RISE: Final = MotionParameters(speed=0.2, ramp_s=0.5, brake_s=0.5)
"""How fast the gripper rises."""

TURN: Final = MotionParameters(speed=0.8, ramp_s=0.5, brake_s=0.5)
"""How fast the arm then turns aside, above all objects."""

MOST_LEAN: Final = 0.06
"""By how much the gripper moves back towards the base at most while it rises, where the arm is stretched [m]."""

_LEAN_STEP: Final = 5e-3  # [m]
_HEIGHT_STEP: Final = 0.01  # of the way up [m]


class TallKinematics(Protocol):
    """What the survey needs of the arm: :class:`visualrhp.embodiment.kinematics.ArmKinematics`."""

    limits: ArmLimits

    @property
    def mounting(self) -> Mounting:
        """Where the base stands."""
        ...

    def forward(self, joints: FloatArray, /) -> Any:
        """The pose of the tool, with x, y, height [m] and theta [rad], of joint positions [6] [rad]."""
        ...

    def inverse(self, x: float, y: float, theta: float, near: npt.ArrayLike, height: float = ...) -> FloatArray:
        """The joint positions [6] of the level gripper at a height [m]. Raises UnreachableError."""
        ...


def survey_motions(kinematics: TallKinematics, start: FloatArray) -> tuple[JointTrajectory, JointTrajectory]:
    """The way out of the camera's sight: up, and aside, each from rest to rest.

    Args:
        kinematics: of the arm.
        start: [6] joint positions of the arm at rest [rad], the gripper level at its height.

    Raises:
        UnreachableError: the arm cannot rise in a straight line, or turn aside within its limits. Nothing has moved.
    """
    start = np.asarray(start, dtype=np.float64)
    path, rise = _rising(kinematics, start)
    places = np.linspace(0.0, 1.0, len(path))
    tool = kinematics.forward(start)
    away = tool.x - kinematics.mounting.x, tool.y - kinematics.mounting.y
    direction, radius = math.atan2(away[1], away[0]), math.hypot(*away) + GRIPPER_RADIUS
    turn = math.copysign(ASIDE, direction) - direction

    def aside(parts: FloatArray) -> FloatArray:
        return path[-1] + parts[:, None] * np.array([turn, 0.0, 0.0, 0.0, 0.0, 0.0])

    return (
        timed(PchipInterpolator(places, path), rise, kinematics.limits, RISE),
        timed(aside, radius * abs(turn), kinematics.limits, TURN),
    )


def _rising(kinematics: TallKinematics, start: FloatArray) -> tuple[FloatArray, float]:
    """[K, 6] joint positions on the way up, and its length [m]. A stretched arm rises on a line that leans back."""
    tool = kinematics.forward(start)
    rise = max(0.0, CLEARANCE_HEIGHT - tool.height)
    base = np.array([kinematics.mounting.x, kinematics.mounting.y])
    inwards = base - (tool.x, tool.y)
    inwards /= np.hypot(*inwards)
    problem = None
    for lean in np.arange(0.0, MOST_LEAN + 1e-9, _LEAN_STEP):
        joints = [start]
        try:
            for part in np.linspace(0.0, 1.0, max(1, math.ceil(rise / _HEIGHT_STEP)) + 1)[1:]:
                x, y = (tool.x, tool.y) + part * lean * inwards
                joints.append(kinematics.inverse(x, y, tool.theta, joints[-1], height=tool.height + part * rise))
        except UnreachableError as error:
            problem = error
            continue
        return np.array(joints), math.hypot(rise, lean)
    assert problem is not None
    raise problem


def backwards(trajectory: JointTrajectory) -> JointTrajectory:
    """The same way, the other way round."""
    return JointTrajectory(trajectory.times[-1] - trajectory.times[::-1], trajectory.positions[::-1])
