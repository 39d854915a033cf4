"""The way of the arm to where an episode begins, from wherever it is: up, across, and down onto the table.

Here the tool is not level at its height, so the closed form of :mod:`visualrhp.embodiment.kinematics` does not apply:
the way up is differential inverse kinematics with Pink. In every step a quadratic program finds the joint velocities
that bring the tool closest to its next pose, within the limits of the joints, drawn to the posture of home, away from
singularities.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator

from visualrhp.embodiment.kinematics import FLANGE, ArmKinematics
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.reach_computation import CollisionModel
from visualrhp.embodiment.robot_cell import JointTrajectory
from visualrhp.embodiment.robot_model import GRIPPER_HEIGHT, GRIPPER_RADIUS, HOME
from visualrhp.embodiment.trajectories import MotionParameters, timed
from visualrhp.errors import UnreachableError
from visualrhp.types import FloatArray

CLEARANCE_HEIGHT: Final = 0.25
"""Height of the gripper's axis while it crosses the table [m]: more than that of the objects (20 cm) below its base."""

ACROSS: Final = MotionParameters(speed=0.5, ramp_s=0.5, brake_s=0.5)
"""How fast the arm crosses the table."""

_ARM_LENGTH: Final = 0.85  # of a stretched UR5e, with which a turn of a joint moves the tool furthest [m]
_STEP: Final = 0.01  # between poses of the tool [m]
_TURN: Final = math.radians(3.0)  # [rad]
_PERIOD: Final = 0.05  # of an iteration [s]: times the limit of the speed, the largest step of a joint
_MOST_ITERATIONS: Final = 30
_CLOSE: Final = 1e-4  # [m] and [rad]
_POSTURE_COST: Final = 1e-3  # relative to a metre or a radian of the tool: it decides only what the tool leaves open
_DAMPING: Final = 1e-6  # Levenberg-Marquardt: bounds the joints' steps where the arm is nearly singular
_SAME_POSTURE: Final = 0.05  # [rad]


def approach(
    kinematics: ArmKinematics,
    start: npt.ArrayLike,
    pose: npt.ArrayLike,
    collisions: CollisionModel,
    clearance: float = CLEARANCE_HEIGHT,
) -> tuple[JointTrajectory, JointTrajectory, JointTrajectory]:
    """Three motions, each from rest to rest: up and level, across, and down.

    The tool first rises on a straight line from where it is, and is levelled on the way; then it moves in the joints at
    the height of ``clearance``; then it goes straight down. Objects are not known here: nothing but the gripper's own
    place should be occupied where it rises and goes down.

    Args:
        kinematics: of the arm.
        start: [6] joint positions of the arm at rest [rad].
        pose: [3] x [m], y [m], theta [rad] of the level gripper at the end.
        collisions: of the same mounting.
        clearance: height of the gripper frame's origin while it crosses the table [m].

    Raises:
        UnreachableError: the end is outside the reach, or the way leads through a collision, a limit or a singularity,
            or into another posture than that of home. Nothing has moved.
    """
    start, pose = np.asarray(start, dtype=np.float64), np.asarray(pose, dtype=np.float64)
    if not kinematics.reach.contains(pose):
        raise UnreachableError(f"the gripper cannot be at (x, y, theta) = {pose.tolist()}: it is outside the reach")
    tool = kinematics.forward(start)
    up = max(clearance, tool.height)
    rising = _rising(kinematics, start, up)
    raised = kinematics.forward(rising[-1])
    level = kinematics.inverse(raised.x, raised.y, raised.theta, near=rising[-1], height=up)
    if np.abs(level - rising[-1]).max() > _SAME_POSTURE:
        raise UnreachableError(
            f"the arm would rise into another posture than that of home, {np.round(rising[-1], 2).tolist()} instead of "
            f"{np.round(level, 2).tolist()} [rad]: move it close to the home posture first"
        )
    above = kinematics.inverse(*pose, near=HOME, height=up)

    def descending(parts: FloatArray) -> FloatArray:
        heights = up + (GRIPPER_HEIGHT - up) * parts
        return np.stack([kinematics.inverse(*pose, near=above, height=height) for height in heights])

    ends = rising[-1], above
    turned = float(np.abs(ends[1] - ends[0]).max())
    slow = kinematics.motion
    legs: tuple[tuple[Callable[[FloatArray], FloatArray], float, MotionParameters], ...] = (
        (_interpolated(rising), up - tool.height + GRIPPER_RADIUS * tool.tilt, slow),
        (lambda parts: ends[0] + parts[:, None] * (ends[1] - ends[0]), _ARM_LENGTH * turned, ACROSS),
        (descending, up - GRIPPER_HEIGHT, slow),
    )
    trajectories = [timed(curve, length, kinematics.limits, motion) for curve, length, motion in legs]
    touching = collisions.touching(start)  # rising is the way out
    for name, trajectory in zip(("up", "across", "down"), trajectories, strict=True):
        _check_collisions(trajectory, collisions, name, touching if name == "up" else [])
    return trajectories[0], trajectories[1], trajectories[2]


def _rising(kinematics: ArmKinematics, start: FloatArray, up: float) -> FloatArray:
    """[K, 6] joint positions while the tool rises to the height ``up`` and is levelled."""
    pink, pin = robot_package("pink"), robot_package("pinocchio")
    model = kinematics.model.copy()
    model.lowerPositionLimit, model.upperPositionLimit = kinematics.limits.lower, kinematics.limits.upper
    model.velocityLimit = kinematics.limits.velocity
    configuration = pink.Configuration(model, model.createData(), start)
    flange = pink.tasks.FrameTask(FLANGE, position_cost=1.0, orientation_cost=1.0, lm_damping=_DAMPING)
    posture = pink.tasks.PostureTask(cost=_POSTURE_COST)
    posture.set_target(np.array(HOME))
    first, last = kinematics.tool_transform(start), _level_above(kinematics.tool_transform(start), up)
    turn = pin.log3(first[:3, :3].T @ last[:3, :3])
    count = math.ceil(max((up - first[2, 3]) / _STEP, float(np.linalg.norm(turn)) / _TURN, 1.0))
    joints = [start]
    for part in np.arange(1, count + 1) / count:
        target = last.copy()
        target[:3, :3] = first[:3, :3] @ pin.exp3(part * turn)
        target[:3, 3] = first[:3, 3] + part * (last[:3, 3] - first[:3, 3])
        flange.set_target(pin.SE3(kinematics.flange_target(target)))
        joints.append(_solved(pink, configuration, (flange, posture), part))
    return np.array(joints)


def _solved(pink: Any, configuration: Any, tasks: tuple[Any, Any], part: float) -> FloatArray:
    """The joint positions [6] near those of ``configuration`` with which the first task is fulfilled."""
    for _ in range(_MOST_ITERATIONS):
        if np.abs(tasks[0].compute_error(configuration)).max() < _CLOSE:
            return configuration.q.copy()
        try:
            velocity = pink.solve_ik(configuration, tasks, _PERIOD, solver="daqp")
        except (pink.exceptions.PinkError, ValueError) as error:
            raise UnreachableError(f"the arm cannot rise: a limit of a joint is in the way ({error!s:.200})") from error
        configuration.integrate_inplace(velocity, _PERIOD)
    raise UnreachableError(
        f"the arm cannot rise in a straight line: {100 * part:.0f}% of the way up, its joints reach their limits or it "
        "is singular; move it close to the home posture first"
    )


def _level_above(tool: FloatArray, up: float) -> FloatArray:
    """[4, 4] the pose ``tool`` made level, with the same heading, at the height ``up``."""
    theta = math.atan2(tool[1, 0], tool[0, 0])
    level = np.eye(4)
    level[:2, :2] = [[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]]
    level[:3, 3] = *tool[:2, 3], up
    return level


def _interpolated(joints: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """A smooth curve through ``joints`` [K, 6], at equal parts of the way."""
    return PchipInterpolator(np.linspace(0.0, 1.0, len(joints)), joints)


def _check_collisions(
    trajectory: JointTrajectory, collisions: CollisionModel, name: str, ignored: list[tuple[str, str]]
) -> None:
    count = max(math.ceil(float(np.abs(np.diff(trajectory.positions, axis=0)).sum(axis=0).max()) / _TURN), 1)
    for index in np.unique(np.linspace(0, len(trajectory.times) - 1, count + 1).astype(int)):
        touching = [pair for pair in collisions.touching(trajectory.positions[index]) if pair not in ignored]
        if touching:
            raise UnreachableError(
                f"on the way {name}, the arm would come too close to itself or the table: "
                f"{' and '.join(touching[0])}, at joints {np.round(trajectory.positions[index], 2).tolist()} [rad]"
            )
