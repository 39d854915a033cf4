"""Outline of the two-finger gripper seen from above, modelled after the Robotiq 2F-85 (paper, footnote 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from visualrhp.errors import SceneError
from visualrhp.scene.contours import is_number
from visualrhp.scene.geometry import to_world
from visualrhp.types import FloatArray

MAX_STROKE = 0.1
"""Largest stroke [m] that the mechanism which opens and closes the simulated fingers can span."""


@dataclass(frozen=True, slots=True)
class Gripper:
    """Geometry of palm and fingers in the gripper frame: x forward, y left, origin between the finger pads. Metres.

    Attributes:
        stroke: largest opening between the inner faces of the fingers.
        finger_reach: x of the fingertips.
        finger_length: from the palm to the fingertips.
        finger_thickness: lateral.
        palm_length: longitudinal.
        palm_front_width: width of the palm at the fingers.
        palm_back_width: width of the palm at the wrist.

    Raises:
        SceneError: a length is not positive, or the stroke is larger than :data:`MAX_STROKE`.
    """

    stroke: float = 0.085
    finger_reach: float = 0.02
    finger_length: float = 0.05
    finger_thickness: float = 0.012
    palm_length: float = 0.06
    palm_front_width: float = 0.10
    palm_back_width: float = 0.075

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not (is_number(getattr(self, name)) and getattr(self, name) > 0.0):
                raise SceneError(f"the gripper's {name} is {getattr(self, name)!r:.100}; it must be positive [m]")
        if self.stroke > MAX_STROKE:
            raise SceneError(f"the gripper's stroke is {self.stroke} m; it can be at most {MAX_STROKE} m")

    def opening_fault(self, opening: float) -> str | None:
        """Why the fingers cannot be ``opening`` [m] apart; None if they can."""
        if 0.0 <= opening <= self.stroke:
            return None
        return f"is {opening} m; it ranges from 0 to the stroke of the gripper, {self.stroke} m"

    @property
    def palm(self) -> FloatArray:
        """[4, 2] outline of the palm in the gripper frame, counter-clockwise."""
        front = self.finger_reach - self.finger_length
        back = front - self.palm_length
        wide, narrow = self.palm_front_width / 2.0, self.palm_back_width / 2.0
        return np.array([[back, -narrow], [front, -wide], [front, wide], [back, narrow]])

    def finger(self, side: int) -> FloatArray:
        """[4, 2] outline of a finger, its inner face on the x axis, counter-clockwise; ``side`` is 1 left, -1 right."""
        front, back = self.finger_reach, self.finger_reach - self.finger_length
        low, high = sorted((0.0, side * self.finger_thickness))
        return np.array([[back, low], [front, low], [front, high], [back, high]])

    def outlines(self, pose: npt.ArrayLike, opening: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Palm, left and right finger, each [4, 2] in the world frame, for a ``pose`` [3] and an ``opening`` [m]."""
        shift = np.array([0.0, opening / 2.0])
        return (
            to_world(self.palm, pose),
            to_world(self.finger(1) + shift, pose),
            to_world(self.finger(-1) - shift, pose),
        )


GripperName = Literal["paper", "cell"]

GRIPPERS: Final[dict[GripperName, Gripper]] = {
    "paper": Gripper(),
    "cell": Gripper(
        stroke=0.085,
        finger_reach=0.02,
        finger_length=0.065,
        finger_thickness=0.0315,
        palm_length=0.112,
        palm_front_width=0.12,
        palm_back_width=0.085,
    ),
}
"""``paper``: that of footnote 3; ``cell``: the 2F-85 of the robot cell, seen from above: fingers with their linkages,
and the base with the bracket that holds it level (docs/execution.md)."""
