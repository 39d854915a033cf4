"""What the execution phase needs of a robot cell: the protocol that a real one and a simulated one implement.

A cell has a camera above the table, an arm, a two-finger gripper and a clock. Commands return at once; motions take
place while time passes. Frames: see :mod:`visualrhp.embodiment.robot_model`. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from visualrhp.types import FloatArray

NUM_JOINTS = 6


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """An image of the camera.

    Attributes:
        image: [H, W, 3] uint8, RGB.
        time_s: when it was exposed, on the clock of the cell [s].
    """

    image: npt.NDArray[np.uint8]
    time_s: float


@dataclass(frozen=True, slots=True)
class ArmState:
    """What the controller of the arm reports.

    Attributes:
        positions: [6] joint positions [rad], from base to wrist 3.
        velocities: [6] joint velocities [rad/s].
        time_s: when they were measured, on the clock of the cell [s].
        fault: why the arm does not follow commands (a protective or an emergency stop); None if it does.
    """

    positions: FloatArray
    velocities: FloatArray
    time_s: float
    fault: str | None = None


@dataclass(frozen=True, slots=True)
class GripperState:
    """What the gripper reports.

    Attributes:
        opening: distance between the finger pads [m].
        is_moving: whether the fingers are moving.
        time_s: when it was measured, on the clock of the cell [s].
        fault: why the gripper does not follow commands; None if it does.
    """

    opening: float
    is_moving: bool
    time_s: float
    fault: str | None = None


@dataclass(frozen=True)
class JointTrajectory:
    """A motion of the arm: joint positions at given times, linear in between.

    Attributes:
        times: [K] since the start of the motion [s], from 0, increasing.
        positions: [K, 6] joint positions [rad]; the first are those of the arm at rest.
    """

    times: FloatArray
    positions: FloatArray

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.times[-1])


@dataclass(frozen=True, slots=True)
class ArmLimits:
    """Limits that no commanded motion exceeds.

    Attributes:
        lower: [6] joint positions [rad].
        upper: [6] joint positions [rad].
        velocity: [6] joint speeds [rad/s].
        acceleration: [6] joint accelerations [rad/s^2].
    """

    lower: FloatArray = field(default_factory=lambda: np.array([-1, -1, -0.5, -1, -1, -1]) * 2.0 * np.pi)
    upper: FloatArray = field(default_factory=lambda: np.array([1, 1, 0.5, 1, 1, 1]) * 2.0 * np.pi)
    velocity: FloatArray = field(default_factory=lambda: np.full(NUM_JOINTS, np.pi))
    acceleration: FloatArray = field(default_factory=lambda: np.full(NUM_JOINTS, 4.0 * np.pi))


class RobotCell(Protocol):
    """A camera, an arm, a gripper and a clock.

    A real cell implements this in one class (docs/your_own_robot.md). No method waits for a motion to end but
    :meth:`wait`.
    """

    def now(self) -> float:
        """Time of the cell's clock [s]; it never goes back."""
        ...

    def wait(self, duration_s: float) -> None:
        """Let time pass: a real cell sleeps, a simulated one simulates."""
        ...

    def frame(self) -> CameraFrame:
        """The newest image of the camera.

        Raises:
            CellFault: the camera gives no image.
        """
        ...

    def arm(self) -> ArmState:
        """The state of the arm.

        Raises:
            CellFault: the controller does not answer.
        """
        ...

    def gripper(self) -> GripperState:
        """The state of the gripper.

        Raises:
            CellFault: the gripper does not answer.
        """
        ...

    def follow(self, trajectory: JointTrajectory) -> None:
        """Start a motion of the arm, which is at rest; replaces one that is in progress.

        Raises:
            CellFault: the controller refuses.
        """
        ...

    def move_gripper(self, opening: float) -> None:
        """Start moving the fingers until they are ``opening`` [m] apart or hold something.

        Raises:
            CellFault: the gripper refuses.
        """
        ...

    def stop(self) -> None:
        """Bring arm and gripper to rest at once, and keep them there until the next command; never raises."""
        ...

    def close(self) -> None:
        """Stop, and release the devices; closing twice has no effect."""
        ...
