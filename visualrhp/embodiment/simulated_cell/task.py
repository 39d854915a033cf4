"""Tasks of the simulated cell: everything that makes one cell differ from another, as a frozen description."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.robot_model import Mounting
from visualrhp.embodiment.simulated_cell.looks import CellLook
from visualrhp.embodiment.simulated_cell.objects import CellObject
from visualrhp.errors import SceneError
from visualrhp.scene.scene import TargetRegion
from visualrhp.types import FloatArray

TABLE_SIDE: float = 0.5
"""Side of the table's square surface [m] (paper, Sec. 7)."""

CAMERA_HEIGHT: float = 1.4
"""Nominal height of the camera above the table [m]."""

FOCAL_LENGTH: float = 980.0
"""Nominal focal length [px]: the table and 9 cm around it fill the height of an image of 480 px."""

IMAGE_SIZE: tuple[int, int] = (640, 480)
"""Width and height of the camera's image [px]."""


def nominal_camera() -> Camera:
    """The camera above the centre of the table, without errors of its mounting."""
    return Camera.above((0.0, 0.0, CAMERA_HEIGHT), FOCAL_LENGTH, *IMAGE_SIZE)


def miscalibrated(camera: Camera, position_std: float, angle_std: float, rng: np.random.Generator) -> Camera:
    """What a calibration with errors takes for ``camera``.

    Args:
        camera: the true one.
        position_std: standard deviation of the error of its place [m], each of three coordinates.
        angle_std: standard deviation of the error of its orientation [rad], about each of three axes.
        rng: source of the errors.
    """
    pose = camera.pose.copy()
    pose[:3, 3] += position_std * rng.standard_normal(3)
    pose[:3, :3] = pose[:3, :3] @ cv2.Rodrigues(angle_std * rng.standard_normal(3))[0]
    return Camera(camera.intrinsics, camera.distortion, pose, camera.width, camera.height)


@dataclass(frozen=True, eq=False)
class CellTask:
    """A cell and where everything in it starts. Random ones: :func:`~.sampling.sample_cell`.

    Attributes:
        objects: the desired object first.
        poses: [m, 3] x, y [m] of every body frame's origin (the middle of an object's axis), and its yaw [rad]: of a
            lying object, the direction of its axis.
        target: the printed target disc.
        gripper_pose: (x [m], y [m], theta [rad]) of the gripper frame.
        camera: the true camera.
        look: light and textures.
        mounting: of the arm.
        table_friction: Coulomb coefficient that the table adds to objects that are more slippery.
        pad_friction: Coulomb coefficient of the finger pads.
        seed: of the camera's noise.

    Raises:
        SceneError: there are no objects, or their number is not that of the poses.
    """

    objects: tuple[CellObject, ...]
    poses: FloatArray
    target: TargetRegion = field(default_factory=lambda: TargetRegion(np.zeros(2)))
    gripper_pose: tuple[float, float, float] = (-0.2, 0.0, 0.0)
    camera: Camera = field(default_factory=nominal_camera)
    look: CellLook = field(default_factory=CellLook)
    mounting: Mounting = field(default_factory=Mounting)
    table_friction: float = 0.15
    pad_friction: float = 0.8
    seed: int = 0

    def __post_init__(self) -> None:
        poses = np.array(self.poses, dtype=np.float64).reshape(-1, 3)
        if not self.objects:
            raise SceneError("a cell has no objects; the desired object comes first")
        if len(poses) != len(self.objects):
            raise SceneError(f"a cell has {len(self.objects)} objects and {len(poses)} poses")
        if not np.isfinite(poses).all():
            raise SceneError(f"the poses of a cell's objects must be finite, not {poses.tolist()!s:.200}")
        poses.setflags(write=False)
        object.__setattr__(self, "poses", poses)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, CellTask):
            return NotImplemented
        mine, theirs = ({**vars(task), "poses": task.poses.tolist()} for task in (self, other))
        return mine == theirs

    def __hash__(self) -> int:
        return hash((self.objects, self.poses.tobytes(), self.gripper_pose, self.seed))
