"""What is true of a simulated cell instead of what its camera shows, to tell what each part of perception costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.robot_cell import ArmState, CameraFrame, GripperState
from visualrhp.embodiment.segmentation.detection import Detection
from visualrhp.scene.scene import Scene
from visualrhp.types import State


@dataclass(frozen=True)
class TrueView:
    """The true scene and state.

    Attributes:
        scene: the desired object first.
        state: of the gripper and the objects.
    """

    scene: Scene
    state: State


class TruePerception:
    """The true state instead of the camera's image.

    Args:
        truth: returns the true scene and state of the cell.
        desired: index of the desired object in them; it becomes the first.
    """

    needs_camera = False

    def __init__(self, truth: Callable[[], tuple[Scene, State]], desired: int = 0) -> None:
        self._truth = truth
        self._desired = desired

    def perceive(self, frame: CameraFrame, arm: ArmState, gripper: GripperState, closed: bool) -> TrueView:
        """The true scene and state; ``closed`` is the commanded state of the gripper."""
        return desired_first(*self._truth(), self._desired, closed)


class TrueSegmenter:
    """The true masks instead of a network.

    Args:
        detections: returns those of the image that the camera takes now.
    """

    def __init__(self, detections: Callable[[], list[Detection]]) -> None:
        self._detections = detections

    def segment(self, image: npt.NDArray[np.uint8]) -> list[Detection]:
        """The objects that the camera sees now, whatever ``image`` is."""
        return self._detections()


def desired_first(scene: Scene, state: State, desired: int, closed: bool) -> TrueView:
    """The view in which object ``desired`` comes first, the others in their order, and the gripper state is given."""
    order = [desired, *(number for number in range(scene.num_objects) if number != desired)]
    objects = tuple(scene.objects[number] for number in order)
    poses = state.object_poses[order]
    return TrueView(
        Scene(scene.target, objects, scene.edges, scene.gripper),
        State.create(state.gripper_pose, state.gripper_opening, closed, poses),
    )
