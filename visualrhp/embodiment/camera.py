"""The camera above the table: a pinhole with lens distortion, and its pose in the world.

Conventions of OpenCV: the camera's frame has x to the right and y downwards in the image, and z along the optical axis;
pixel coordinates are (column, row), and the centre of the first pixel is (0, 0).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Annotated, Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.documents import FileKind, Finite, conform, document
from visualrhp.errors import ConfigError, DataError
from visualrhp.files import write_json
from visualrhp.parameters import Field
from visualrhp.types import FloatArray

CAMERA_FILE: Final = FileKind("a calibrated camera (a JSON file)", "calibrate the camera again")

_FORMAT: Final = 1
_ROTATION_TOLERANCE: Final = 1e-6
_UNDISTORT: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera.

    Attributes:
        intrinsics: [3, 3] camera matrix [px].
        distortion: [5] lens distortion of OpenCV: k1, k2, p1, p2, k3.
        pose: [4, 4] from the camera's frame to the world frame [m].
        width: of the image [px].
        height: of the image [px].

    Raises:
        ConfigError: a shape is wrong, a number is not finite, the focal lengths are not positive, the rotation is none,
            or the camera is not above the table.
    """

    intrinsics: FloatArray
    distortion: FloatArray = field(default_factory=lambda: np.zeros(5))
    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    width: int = 640
    height: int = 480

    def __post_init__(self) -> None:
        for name, shape in (("intrinsics", (3, 3)), ("distortion", (5,)), ("pose", (4, 4))):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise ConfigError(
                    f"a camera's {name} should be finite numbers of the shape {list(shape)}, not "
                    f"{array.tolist()!s:.200} of the shape {list(array.shape)}"
                )
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if not (self.width > 0 and self.height > 0):
            raise ConfigError(f"a camera's image should have pixels, not {self.width} x {self.height}")
        matrix = self.intrinsics
        if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0 and np.array_equal(matrix[2], [0.0, 0.0, 1.0])):
            raise ConfigError(
                "a camera's intrinsics should be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths, "
                f"not {matrix.tolist()}"
            )
        rotation = self.pose[:3, :3]
        is_rotation = np.abs(rotation @ rotation.T - np.eye(3)).max() < _ROTATION_TOLERANCE
        if not (is_rotation and np.linalg.det(rotation) > 0.0 and np.array_equal(self.pose[3], [0.0, 0.0, 0.0, 1.0])):
            raise ConfigError(f"a camera's pose should be a rotation and a translation, not {self.pose.tolist()}")
        if self.pose[2, 3] <= 0.0:
            raise ConfigError(
                f"a camera should be above the table, not at the height {self.pose[2, 3]:.4g} m; the pose is that of "
                "the camera in the world frame, not its inverse"
            )

    @classmethod
    def above(
        cls,
        position: npt.ArrayLike,
        focal_length: float,
        width: int = 640,
        height: int = 480,
        *,
        look_at: npt.ArrayLike = (0.0, 0.0, 0.0),
        distortion: npt.ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0),
    ) -> Camera:
        """A camera above the table whose image has the world's y axis upwards.

        Args:
            position: [3] of the camera [m], world frame.
            focal_length: [px].
            width: of the image [px].
            height: of the image [px].
            look_at: [3] point on the optical axis [m], world frame, not on a level with the camera.
            distortion: [5] see :class:`Camera`.
        """
        start = np.asarray(position, dtype=np.float64)
        forward = np.asarray(look_at, dtype=np.float64) - start
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 1.0, 0.0))
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = start
        centre = (0.5 * (width - 1), 0.5 * (height - 1))
        matrix = np.array([[focal_length, 0.0, centre[0]], [0.0, focal_length, centre[1]], [0.0, 0.0, 1.0]])
        return cls(matrix, np.asarray(distortion, dtype=np.float64), pose, width, height)

    @property
    def position(self) -> FloatArray:
        """[3] of the centre of projection [m], world frame."""
        return self.pose[:3, 3]

    @property
    def nadir(self) -> FloatArray:
        """[2] the point of the table below the centre of projection [m], world frame."""
        return self.pose[:2, 3]

    @property
    def world_to_camera(self) -> FloatArray:
        """[4, 4] the inverse of the pose."""
        inverse = np.eye(4)
        inverse[:3, :3] = self.pose[:3, :3].T
        inverse[:3, 3] = -self.pose[:3, :3].T @ self.pose[:3, 3]
        return inverse

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Where the camera sees points.

        Args:
            points: [N, 3] world frame [m].

        Returns:
            [N, 2] pixels; NaN for points that are not in front of the camera.
        """
        given = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        if not len(given):
            return np.zeros((0, 2))
        transform = self.world_to_camera
        seen = given @ transform[:3, :3].T + transform[:3, 3]
        is_behind = seen[:, 2] <= 0.0
        seen[is_behind] = (0.0, 0.0, 1.0)
        pixels = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), self.intrinsics, self.distortion)[0]
        return np.where(is_behind[:, None], np.nan, pixels.reshape(-1, 2).astype(np.float64))

    def back_project(self, pixels: npt.ArrayLike, height: float = 0.0) -> FloatArray:
        """The points of a horizontal plane that are seen at pixels.

        Args:
            pixels: [N, 2].
            height: of the plane above the table [m], below the camera.

        Returns:
            [N, 2] x, y [m], world frame; NaN where the line of sight does not meet the plane.

        Raises:
            ConfigError: the plane is not below the camera.
        """
        if not height < self.pose[2, 3]:
            raise ConfigError(f"a plane at the height {height} m is not below the camera at {self.pose[2, 3]:.4g} m")
        given = np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        if not len(given):
            return np.zeros((0, 2))
        if self.distortion.any():
            image = cv2.undistortPoints(given, self.intrinsics, self.distortion, criteria=_UNDISTORT).reshape(-1, 2)
        else:
            image = (given[:, 0] - self.intrinsics[:2, 2]) / self.intrinsics[[0, 1], [0, 1]]
            image[:, 0] -= self.intrinsics[0, 1] / self.intrinsics[0, 0] * image[:, 1]
        rays = np.concatenate([image, np.ones((len(image), 1))], axis=1) @ self.pose[:3, :3].T
        falls = np.where(rays[:, 2] < 0.0, rays[:, 2], np.nan)
        return self.nadir + rays[:, :2] * ((height - self.pose[2, 3]) / falls)[:, None]

    def table_homography(self) -> FloatArray:
        """[3, 3] from points (x, y, 1) of the table [m] to homogeneous pixels of an image without distortion."""
        return self.intrinsics @ self.world_to_camera[:3][:, [0, 1, 3]]

    # ------------------------------------------------------------------------------------------------------ documents
    def to_document(self) -> dict[str, Any]:
        """The camera as the content of a JSON file."""
        return {
            "format": _FORMAT,
            "intrinsics": self.intrinsics.tolist(),
            "distortion": self.distortion.tolist(),
            "pose": self.pose.tolist(),
            "width": self.width,
            "height": self.height,
        }

    @classmethod
    def from_document(cls, content: Any) -> Camera:
        """The inverse of :meth:`to_document`.

        Raises:
            DataError: the content does not describe a camera; the message says why.
        """
        try:
            return _camera(content)
        except ValueError as error:
            raise DataError(f"This is no camera: {error}.") from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a JSON file, atomically."""
        write_json(path, self.to_document())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Camera:
        """Read a file of :meth:`save`.

        Raises:
            DataError: it cannot be read or does not describe a camera.
        """
        content = CAMERA_FILE.read_content(path)
        try:
            return _camera(content)
        except ValueError as error:
            raise CAMERA_FILE.damaged(path, error) from error

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Camera) and self.to_document() == other.to_document()

    def __hash__(self) -> int:
        return hash((self.intrinsics.tobytes(), self.pose.tobytes(), self.width, self.height))


@document
class _Document:
    format: int
    intrinsics: list[list[Finite]]
    distortion: list[Finite]
    pose: list[list[Finite]]
    width: Annotated[int, Field(ge=1)]
    height: Annotated[int, Field(ge=1)]

    def __post_init__(self) -> None:
        if self.format != _FORMAT:
            raise ValueError(f"format={self.format} is not known: it should be {_FORMAT}")


def _camera(content: Any) -> Camera:
    """The camera of a document; a ValueError says what is wrong with it."""
    found: _Document = conform(_Document, content)
    try:
        return Camera(found.intrinsics, found.distortion, found.pose, found.width, found.height)  # pyright: ignore[reportArgumentType]
    except ConfigError as error:
        raise ValueError(str(error)) from error
