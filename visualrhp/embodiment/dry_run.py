"""A dry run: every motion of an episode is computed and checked, and none is commanded."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from visualrhp.embodiment.looking import Looker, LookLimits, Perceiver, RobotMask, Sight, StepLatency
from visualrhp.embodiment.motion import Kinematics, MotionLimits, check_trajectory
from visualrhp.embodiment.robot_cell import ArmLimits, ArmState, JointTrajectory, RobotCell
from visualrhp.embodiment.robot_model import CELL_GRIPPER
from visualrhp.embodiment.watchdog import WatchdogLimits, WatchedCell
from visualrhp.errors import CellFault
from visualrhp.execution.world import World
from visualrhp.scene.scene import Scene
from visualrhp.simulation.action_spaces import ActionSpace, GripperMotion
from visualrhp.types import Action, FloatArray, State


@dataclass(frozen=True)
class PlannedMotion:
    """A motion that was checked.

    Attributes:
        motion: of the gripper, in its frame.
        trajectory: of the joints; None if only the fingers move.
        start, end: joint positions [6] [rad].
        state: that the planner's model expects afterwards.
    """

    motion: GripperMotion
    trajectory: JointTrajectory | None
    start: FloatArray
    end: FloatArray
    state: State

    def describe(self) -> str:
        """One line: what moves, for how long, and where it ends."""
        parts = []
        if self.trajectory is not None:
            speed = np.abs(np.diff(self.trajectory.positions, axis=0) / np.diff(self.trajectory.times)[:, None]).max()
            parts.append(
                f"forward {100 * self.motion.forward:+.1f} cm, left {100 * self.motion.left:+.1f} cm, turn "
                f"{math.degrees(self.motion.rotation):+.1f} degrees in {self.trajectory.duration:.2f} s (joints up to "
                f"{speed:.2f} rad/s)"
            )
        if self.motion.closed is not None:
            parts.append("close" if self.motion.closed else "open")
        joints = ", ".join(f"{joint:.3f}" for joint in self.end)
        return f"{'; '.join(parts) or 'no motion'}; joints at the end: {joints} rad"


class DryRunWorld(World):
    """A world that looks at the cell once, and then imagines what its motions would do; nothing is commanded.

    Args:
        cell: of which the camera and the states are read.
        perception: interprets its first frames.
        kinematics: of the arm.
        action_space: of the actions.
        imagine: the state after a motion, by the planner's model: a function of (scene, state, action).
        arm_limits, watchdog, motion, look, robot_mask: as of :class:`~visualrhp.embodiment.robot_world.RobotWorld`.

    Attributes:
        motions: those that were checked.
        latencies: as of RobotWorld; of the first look only.
        last_sight: the only view.
    """

    def __init__(
        self,
        cell: RobotCell,
        perception: Perceiver,
        kinematics: Kinematics,
        action_space: ActionSpace,
        imagine: Callable[[Scene, State, Action], State],
        *,
        arm_limits: ArmLimits | None = None,
        watchdog: WatchdogLimits | None = None,
        motion: MotionLimits | None = None,
        look: LookLimits | None = None,
        robot_mask: RobotMask | None = None,
    ) -> None:
        self.motions: list[PlannedMotion] = []
        self.latencies = [StepLatency()]
        self.last_sight: Sight | None = None
        self._read_only = ReadOnlyCell(cell)
        self._cell = WatchedCell(self._read_only, CELL_GRIPPER.stroke, watchdog, arm_limits)
        self._looker = Looker(self._cell, perception, look, robot_mask)
        self._kinematics, self._space, self._imagine = kinematics, action_space, imagine
        self._motion_limits = motion or MotionLimits()
        self._seen: tuple[Scene, State] | None = None
        self._joints = np.zeros(0)

    def observe(self) -> tuple[Scene, State]:
        if self._seen is None:
            sight = self.last_sight = self._looker.look(None, False, self.latencies[0])
            self._seen, self._joints = (sight.view.scene, sight.view.state), sight.arm.positions
        return self._seen

    def act(self, action: Action) -> None:
        """Check the motion from where the arm would be. Raises UnreachableError where it is refused."""
        motion = self._space.motion(action)
        scene, state = self.observe()
        trajectory, end = None, self._joints
        if not motion.forward == motion.left == motion.rotation == 0.0:
            arm = ArmState(self._joints, np.zeros_like(self._joints), 0.0)
            trajectory = self._kinematics.path(self._joints, motion)
            limits = self._motion_limits, self._cell.arm_limits
            check_trajectory(trajectory, arm, motion, self._kinematics, *limits)
            end = trajectory.positions[-1]
        state = self._imagine(scene, state, action)
        self.motions.append(PlannedMotion(motion, trajectory, self._joints, end, state))
        self._seen, self._joints = (scene, state), end

    def close(self) -> None:
        """Release the cell, without a command."""
        self._read_only.release()


class ReadOnlyCell(RobotCell):
    """A cell that is read and never commanded.

    Args:
        cell: the cell.
    """

    def __init__(self, cell: RobotCell) -> None:
        self._cell: Any = cell

    def now(self) -> float:
        return self._cell.now()

    def wait(self, duration_s: float) -> None:
        self._cell.wait(duration_s)

    def frame(self):
        return self._cell.frame()

    def arm(self) -> ArmState:
        return self._cell.arm()

    def gripper(self):
        return self._cell.gripper()

    def follow(self, trajectory: JointTrajectory) -> None:
        raise CellFault("this is a dry run: the arm is not commanded")

    def move_gripper(self, opening: float) -> None:
        raise CellFault("this is a dry run: the gripper is not commanded")

    def stop(self) -> None:
        """Nothing moves that could be stopped."""

    def close(self) -> None:
        """As :meth:`stop`."""

    def release(self) -> None:
        """Close the cell."""
        self._cell.close()
