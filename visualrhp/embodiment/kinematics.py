"""Kinematics of the arm (paper, Sec. 5.3): from planar motions of the level gripper to motions of the joints.

Pinocchio gives the forward kinematics and the Jacobian. The inverse kinematics is in closed form, since the bracket
makes it simple: the flange points down at a constant height, so joints 1 to 5 depend on the place of the flange alone,
and joint 6 turns the heading. That is exact, has one continuous solution everywhere (elbow up, wrist stretched
forwards) and takes a millisecond for a whole path, as long as one step of differential inverse kinematics. Where the
tool is not level at its height, :mod:`visualrhp.embodiment.approach` solves the general problem with Pink.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.reach import ReachMap, TurningRange, displacement_of
from visualrhp.embodiment.robot_cell import ArmLimits, JointTrajectory
from visualrhp.embodiment.robot_model import GRIPPER_HEIGHT, GRIPPER_RADIUS, Mounting, arm_file, flange_to_gripper
from visualrhp.embodiment.trajectories import MotionParameters, timed
from visualrhp.errors import UnreachableError
from visualrhp.simulation.action_spaces import GripperMotion
from visualrhp.types import FloatArray, wrap_angle

STRAIGHT_ELBOW: Final = 0.5
"""Least angle of the elbow from the stretched arm [rad], where the arm is singular and joints would move fast."""

FOLDED_ELBOW: Final = 2.9
"""Largest angle of the elbow [rad]; the folded arm is singular at pi, and collides with itself before."""

TURNING_MARGIN: Final = math.radians(3.0)
"""Of wrist 3 to its limits [rad]: in the middle of a straight line, it may turn further than at both ends."""

MAX_LEVEL_ERROR: Final = math.radians(4.0)
"""Largest difference [rad] between the joints at the start of a path and those that hold the gripper level at its
height: more than what a loaded joint sags, less than what would be a different posture."""

FLANGE: Final = "attachment_site"
"""Name of the flange's frame in the model of the arm."""

_HALF_TURN: Final = np.diag([-1.0, -1.0, 1.0, 1.0])  # Pinocchio ignores the pose of Menagerie's base
_DOWN: Final = -0.5 * math.pi  # the sum of joints 2 to 4, and joint 5, with the flange pointing down


@dataclass(frozen=True, slots=True)
class ToolPose:
    """Where the gripper frame is.

    Attributes:
        x, y: its origin in the world frame [m].
        theta: heading, the direction of its x axis seen from above [rad], in [-pi, pi).
        height: of the origin above the table [m].
        tilt: angle between its z axis and the vertical [rad].
    """

    x: float
    y: float
    theta: float
    height: float
    tilt: float


@dataclass(frozen=True, slots=True)
class _Lengths:
    """Of the arm [m]: heights and offsets of its links, from its model."""

    shoulder: float  # height of joint 2 above the base
    upper_arm: float
    forearm: float
    lateral: float  # of the flange from the plane of the arm's first link
    wrist: float  # from joint 4's axis to joint 6's, along joint 5
    flange: float  # from joint 5's axis to the flange, along joint 6


class ArmKinematics:
    """Forward and inverse kinematics, and paths, of the arm with the level gripper.

    Not to be shared between threads: Pinocchio's data are reused.

    Args:
        mounting: of the base.
        limits: of the joints.
        motion: how fast the tool moves.
        reach: what the arm can reach without collision; by default that of the mounting (see
            :func:`visualrhp.embodiment.reach_computation.reach_of`).

    Attributes:
        mounting, limits, motion: as given.
        model: Pinocchio's model of the arm, in the frame of its base turned by half a turn.

    Raises:
        ConfigError: the robot's packages are not installed.
    """

    def __init__(
        self,
        mounting: Mounting | None = None,
        limits: ArmLimits | None = None,
        motion: MotionParameters | None = None,
        reach: ReachMap | None = None,
    ) -> None:
        self.mounting = mounting or Mounting()
        self.limits = limits or ArmLimits()
        self.motion = motion or MotionParameters()
        self._reach = reach
        self._pin: Any = robot_package("pinocchio")
        self.model: Any = self._pin.buildModelFromMJCF(arm_file())
        self._data: Any = self.model.createData()
        self._flange = self.model.getFrameId(FLANGE)
        self._base = self.mounting.base_transform @ _HALF_TURN
        self._tool = flange_to_gripper()
        self._lengths = self._read_lengths()

    def _read_lengths(self) -> _Lengths:
        places = np.array([placement.translation for placement in self.model.jointPlacements[1:]])
        lateral = places[[1, 2, 4], 1].sum()
        flange = self.model.frames[self._flange].placement.translation[1]
        return _Lengths(places[0, 2], places[2, 2], places[3, 2], lateral, places[5, 2], flange)

    @cached_property
    def reach(self) -> ReachMap:
        """What the arm can reach without collision."""
        if self._reach is not None:
            return self._reach
        from visualrhp.embodiment.reach_computation import reach_of

        return reach_of(self.mounting)

    # Forward

    def tool_transform(self, joints: npt.ArrayLike) -> FloatArray:
        """[4, 4] pose of the gripper frame in the world frame at ``joints`` [6]."""
        self._pin.forwardKinematics(self.model, self._data, np.asarray(joints, dtype=np.float64))
        flange = self._pin.updateFramePlacement(self.model, self._data, self._flange)
        return self._base @ flange.homogeneous @ self._tool

    def flange_target(self, tool: FloatArray) -> FloatArray:
        """[4, 4] pose of the flange in the frame of :attr:`model` that brings the gripper frame to ``tool`` [4, 4]."""
        return np.linalg.inv(self._base) @ tool @ np.linalg.inv(self._tool)

    def forward(self, joints: npt.ArrayLike) -> ToolPose:
        """Where the gripper is at ``joints`` [6] [rad]."""
        tool = self.tool_transform(joints)
        x, y, height = tool[:3, 3].tolist()
        tilt = math.atan2(math.hypot(tool[0, 2], tool[1, 2]), tool[2, 2])
        return ToolPose(x, y, wrap_angle(math.atan2(tool[1, 0], tool[0, 0])), height, tilt)

    def jacobian(self, joints: npt.ArrayLike) -> FloatArray:
        """[6, 6] derivative of the gripper frame by ``joints`` [6], in the directions of the world frame.

        The first three rows are the velocity of its origin [m/rad], the others its angular velocity [rad/rad].
        """
        pin, data = self._pin, self._data
        joints = np.asarray(joints, dtype=np.float64)
        jacobian = pin.computeFrameJacobian(self.model, data, joints, self._flange, pin.LOCAL_WORLD_ALIGNED)
        jacobian = np.kron(np.eye(2), self._base[:3, :3]) @ jacobian
        lever = self.tool_transform(joints)[:3, 3] - self._base[:3, :3] @ data.oMf[self._flange].translation
        lever -= self._base[:3, 3]
        jacobian[:3] += np.cross(jacobian[3:].T, lever).T
        return jacobian

    # Inverse

    def inverse(
        self, x: float, y: float, theta: float, near: npt.ArrayLike, height: float = GRIPPER_HEIGHT
    ) -> FloatArray:
        """The joint positions [6] [rad] that hold the gripper level at (x, y, theta).

        Args:
            x, y: of the gripper frame's origin, world frame [m].
            theta: its heading [rad].
            near: [6] joint positions; of the equivalent solutions, a turn apart, the nearest in the limits is taken.
            height: of the gripper frame's origin above the table [m].

        Raises:
            UnreachableError: there is no solution within the limits, or it is too close to a singularity. Collisions
                are not checked.
        """
        joints = self._solutions(np.array([[x, y, theta]]), height)[0]
        return self._wound(joints, np.asarray(near, dtype=np.float64))

    def _solutions(self, poses: FloatArray, height: float) -> FloatArray:
        """Joint positions [N, 6] of ``poses`` [N, 3], of which joints 1 to 5 are in the range of one turn.

        Continuous in the poses while the flange does not go round the base: the heading is not wrapped.
        """
        lengths, tool, base = self._lengths, self._tool, self._base
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        # The flange's axis is where the gripper frame sees it: behind its origin.
        behind = tool[1, 3]
        x, y = poses[:, 0] - behind * cos - base[0, 3], poses[:, 1] - behind * sin - base[1, 3]
        x, y = base[0, 0] * x + base[1, 0] * y, base[0, 1] * x + base[1, 1] * y
        radius = np.hypot(x, y)
        nearest, farthest = self.ring(height)
        if not (nearest <= radius.min() and radius.max() <= farthest):
            raise UnreachableError(
                f"the flange would be {radius.min():.3f} to {radius.max():.3f} m from the axis of joint 1, and it "
                f"reaches {nearest:.3f} to {farthest:.3f} m: beyond, the elbow is stretched or folded"
            )
        forward = np.sqrt(radius**2 - lengths.lateral**2)
        pan = np.arctan2(y, x) - np.arctan2(lengths.lateral, forward)
        along = forward - lengths.wrist
        up = self._wrist_above_shoulder(height)
        upper, lower = lengths.upper_arm, lengths.forearm
        cos_elbow = (along**2 + up**2 - upper**2 - lower**2) / (2.0 * upper * lower)
        elbow = np.arccos(cos_elbow)
        lift = -np.arctan2(up, along) - np.arctan2(lower * np.sin(elbow), upper + lower * cos_elbow)
        pan_to_heading = math.atan2(base[1, 0], base[0, 0]) + math.pi
        wrist = pan_to_heading + pan - poses[:, 2]
        down = np.full_like(pan, _DOWN)
        return np.stack([pan, lift, elbow, down - lift - elbow, down, wrist], axis=1)

    def ring(self, height: float = GRIPPER_HEIGHT) -> tuple[float, float]:
        """Between which distances from the axis of joint 1 the flange can be [m], away from singularities.

        Args:
            height: of the gripper frame's origin above the table [m].
        """
        lengths, up = self._lengths, self._wrist_above_shoulder(height)
        upper, lower = lengths.upper_arm, lengths.forearm
        along = [
            math.sqrt(max(upper**2 + lower**2 + 2.0 * upper * lower * math.cos(elbow) - up**2, 0.0))
            for elbow in (FOLDED_ELBOW, STRAIGHT_ELBOW)
        ]
        nearest, farthest = (math.hypot(a + lengths.wrist, lengths.lateral) for a in along)
        return nearest, farthest

    def _wrist_above_shoulder(self, height: float) -> float:
        """Of joint 4 above joint 2 [m], when the gripper is level at ``height``."""
        lengths = self._lengths
        return height + self._tool[2, 3] + lengths.flange - (self._base[2, 3] + lengths.shoulder)

    def _wound(self, joints: FloatArray, near: FloatArray) -> FloatArray:
        """``joints`` [6] moved by whole turns, within the limits, as near to ``near`` [6] as possible."""
        turn = 2.0 * np.pi
        lowest = np.ceil((self.limits.lower - joints) / turn)
        highest = np.floor((self.limits.upper - joints) / turn)
        if (lowest > highest).any():
            joint = int(np.argmax(lowest > highest))
            raise UnreachableError(
                f"joint {joint + 1} would be at {joints[joint]:.3f} rad, which no number of turns brings into its "
                f"range, [{self.limits.lower[joint]:.3f}, {self.limits.upper[joint]:.3f}]"
            )
        return joints + turn * np.clip(np.round((near - joints) / turn), lowest, highest)

    def turning_range(self, joints: npt.ArrayLike) -> TurningRange:
        """How far wrist 3 can turn from ``joints`` [6] [rad], but for :data:`TURNING_MARGIN`."""
        tool, wrist = self.forward(joints), float(np.asarray(joints)[5])
        return TurningRange(
            self.mounting,
            self._lengths.lateral,
            (tool.x, tool.y, tool.theta),
            forwards=float(self.limits.upper[5]) - TURNING_MARGIN - wrist,
            backwards=wrist - float(self.limits.lower[5]) - TURNING_MARGIN,
        )

    # Paths

    def path(self, start: npt.ArrayLike, motion: GripperMotion) -> JointTrajectory:
        """The joint motion of a planar motion of the gripper, from rest to rest.

        The origin of the gripper frame moves on a straight line while the heading turns in proportion, as the palm does
        in the planner's simulator. The line begins where the gripper is at ``start``. What is missing there to the
        level gripper at its height is made up for along the path, so that errors do not add up.

        Args:
            start: [6] joint positions of the arm at rest [rad].
            motion: of the gripper, in its frame. A motion that only opens or closes the fingers corrects the height.

        Raises:
            UnreachableError: the start is not level at its height, or the way or the end is outside the reach: a limit
                of a joint, its number of turns, a singularity, a collision, the workspace. Nothing has moved.
        """
        start = np.asarray(start, dtype=np.float64)
        if start.shape != (6,) or not np.isfinite(start).all():
            raise UnreachableError(
                f"the arm reports joint positions {start.tolist()!s:.200}; there are six, all finite"
            )
        tool = self.forward(start)
        pose = np.array([tool.x, tool.y, tool.theta])
        self.reach.check(pose, motion)
        displacement = displacement_of(tool.theta, motion)
        first = self._solutions(pose[None], GRIPPER_HEIGHT)[0]
        level = self._wound(first, start)
        error = start - level
        if np.abs(error).max() > MAX_LEVEL_ERROR:
            joint = int(np.argmax(np.abs(error)))
            raise UnreachableError(
                f"the gripper is {tool.height:.4f} m above the table and tilted by {math.degrees(tool.tilt):.2f} "
                f"degrees, or the arm is in another posture (joint {joint + 1} is at {start[joint]:.3f} rad, expected "
                f"{level[joint]:.3f}); a path begins level, {GRIPPER_HEIGHT} m above the table: approach it first"
            )

        def curve(parts: FloatArray) -> FloatArray:
            joints = self._solutions(pose + parts[:, None] * displacement, GRIPPER_HEIGHT)
            return np.unwrap(joints, axis=0) + (level - first) + (1.0 - parts[:, None]) * error

        length = math.hypot(*displacement[:2]) + GRIPPER_RADIUS * abs(displacement[2])
        return timed(curve, length, self.limits, self.motion)
