"""Calibrate the camera from known points, and say how well the result explains them.

*Pose*: with known intrinsics, one image of at least four points of the world that are not on a line. *Intrinsics*: from
several images of a board (a ChArUco or a checkerboard pattern) in different orientations; the pose of the camera then
follows from the image in which the board lies in a known place on the table.

The error of a calibration is the root mean square distance between where points are seen and where the calibrated
camera would see them; it is compared with a limit.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.documents import FileKind
from visualrhp.embodiment.camera import Camera
from visualrhp.errors import ConfigError, PerceptionError
from visualrhp.parameters import Count, Positive, parameters
from visualrhp.scene import geometry
from visualrhp.types import FloatArray

MAX_ERROR: Final = 1.0
"""Largest root mean square reprojection error that is accepted [px]; a good calibration has 0.1 to 0.5."""

MIN_VIEWS: Final = 3
"""Fewest images of a board from which intrinsics are found."""

POINTS_FILE: Final = FileKind(
    "a table of known points (CSV with the columns x, y, z in metres and column, row in pixels)", "write it again"
)

_COLUMNS: Final = ("x", "y", "z", "column", "row")
_MIN_POINTS: Final = 4
_LEAST_SPREAD: Final = 0.02
"""Least extent of the points across the line that fits them best [m]."""


@dataclass(frozen=True, eq=False)
class KnownPoints:
    """Points whose place in the world and in an image is known.

    Attributes:
        world: [N, 3] world frame, or the frame of a board [m].
        pixels: [N, 2] where they are seen (column, row).

    Raises:
        PerceptionError: fewer than four points, other shapes, numbers that are not finite, or points on one line.
    """

    world: FloatArray
    pixels: FloatArray

    def __post_init__(self) -> None:
        world, pixels = np.array(self.world, dtype=np.float64), np.array(self.pixels, dtype=np.float64)
        if world.ndim != 2 or world.shape[1:] != (3,) or pixels.shape != (len(world), 2):
            raise PerceptionError(
                f"known points are places [N, 3] and pixels [N, 2], not {list(world.shape)} and {list(pixels.shape)}"
            )
        if not (np.isfinite(world).all() and np.isfinite(pixels).all()):
            raise PerceptionError("a known point has a number that is not finite")
        if len(world) < _MIN_POINTS:
            raise PerceptionError(f"{len(world)} known points are too few: at least {_MIN_POINTS} are needed")
        spreads = np.linalg.svd(world - world.mean(axis=0), compute_uv=False) / np.sqrt(len(world))
        if spreads[1] < _LEAST_SPREAD:
            raise PerceptionError(
                f"the known points lie on a line (they extend {1e3 * spreads[1]:.1f} mm across it, and at least "
                f"{1e3 * _LEAST_SPREAD:.0f} mm are needed); use points in the corners of the surface"
            )
        object.__setattr__(self, "world", world)
        object.__setattr__(self, "pixels", pixels)


@dataclass(frozen=True)
class Calibration:
    """A calibrated camera and how well it explains the points.

    Attributes:
        camera: the result.
        error: root mean square reprojection error of the points that give the pose [px].
        worst: largest reprojection error of these [px].
        num_points: that give the pose.
        intrinsics_error: root mean square reprojection error of the images that gave the intrinsics [px]; None if they
            were given.
        num_views: images that gave the intrinsics.
    """

    camera: Camera
    error: float
    worst: float
    num_points: int
    intrinsics_error: float | None = None
    num_views: int = 0


@dataclass(frozen=True)
class Lens:
    """Intrinsics without a pose.

    Attributes:
        intrinsics: [3, 3] camera matrix [px].
        distortion: [5] k1, k2, p1, p2, k3.
        width: of the image [px].
        height: of the image [px].
        error: root mean square reprojection error [px]; None if they were not calibrated here.
        num_views: images that gave them.
    """

    intrinsics: FloatArray
    width: int
    height: int
    distortion: FloatArray = field(default_factory=lambda: np.zeros(5))
    error: float | None = None
    num_views: int = 0


@parameters
class Board:
    """A printed calibration pattern.

    Attributes:
        pattern: a ChArUco board, of which parts may be hidden, or a checkerboard.
        columns: squares of a row.
        rows: squares of a column.
        square: side of a square [m].
        marker: side of a marker of a ChArUco board [m].
        dictionary: of its markers, a name of OpenCV.
    """

    pattern: Literal["charuco", "checkerboard"] = "charuco"
    columns: Count = 8
    rows: Count = 6
    square: Positive = 0.04
    marker: Positive = 0.03
    dictionary: str = "DICT_5X5_100"

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3:
            raise ValueError(f"columns={self.columns} and rows={self.rows} should both be at least 3.")
        if self.pattern == "charuco" and self.marker >= self.square:
            raise ValueError(f"marker={self.marker} should be smaller than square={self.square}.")
        if self.pattern == "checkerboard" and (self.columns + self.rows) % 2 == 0:
            raise ValueError(
                f"columns={self.columns} and rows={self.rows} should be an even and an odd number: otherwise, half a "
                "turn of a checkerboard cannot be seen."
            )
        if not self.dictionary.startswith("DICT_") or not hasattr(cv2.aruco, self.dictionary):
            raise ValueError(f"dictionary={self.dictionary} is none of OpenCV's: it should be like DICT_5X5_100.")

    @property
    def corners(self) -> FloatArray:
        """[N, 3] inner corners in the frame of the board [m]: origin at its first corner as printed, x along rows, y
        along columns downwards, z into the board."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return self.square * np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float64)

    def on_table(self, points: KnownPoints, x: float, y: float, yaw: float, height: float = 0.0) -> KnownPoints:
        """Corners of the board in the world frame, when it lies on the table.

        Args:
            points: of :meth:`find`.
            x: of the board's first corner, the origin of its frame [m].
            y: of the same [m].
            yaw: direction of its rows [rad]; 0 along the world's x axis.
            height: of its surface above the table [m].
        """
        flipped = points.world[:, :2] * (1.0, -1.0)
        placed = geometry.to_world(flipped, (x, y, yaw))
        return KnownPoints(np.column_stack([placed, np.full(len(placed), height)]), points.pixels)

    def drawing(self, pixels_per_metre: float) -> npt.NDArray[np.uint8]:
        """[H, W] the pattern, to be printed."""
        side = round(self.square * pixels_per_metre)
        if self.pattern == "charuco":
            return np.asarray(self._charuco().generateImage((self.columns * side, self.rows * side)), dtype=np.uint8)
        row, column = np.indices((self.rows, self.columns))
        return np.kron(np.where((row + column) % 2, 255, 0), np.ones((side, side), dtype=np.int64)).astype(np.uint8)

    def find(self, image: npt.NDArray[np.uint8]) -> KnownPoints:
        """The corners of the board that an image [H, W, 3] (RGB) shows, in the frame of the board.

        Raises:
            PerceptionError: the board is not found, or too few of its corners.
        """
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
        if self.pattern == "charuco":
            corners, numbers = cv2.aruco.CharucoDetector(self._charuco()).detectBoard(grey)[:2]
            if numbers is None or len(numbers) < _MIN_POINTS:
                raise PerceptionError(
                    f"the image shows {0 if numbers is None else len(numbers)} corners of the ChArUco board; at least "
                    f"{_MIN_POINTS} are needed: is it the board that is described, flat, sharp and lit?"
                )
            order = numbers.ravel().astype(np.int64)
            return KnownPoints(self.corners[order], corners.reshape(-1, 2).astype(np.float64))
        size = (self.columns - 1, self.rows - 1)
        found, corners = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE)
        if not found:
            raise PerceptionError(
                f"the image does not show a checkerboard of {self.columns} x {self.rows} squares, all of them"
            )
        pixels = corners.reshape(-1, 2).astype(np.float64)
        # A checkerboard looks alike after half a turn but for its colours: the first square is black.
        first, last = (_square_brightness(grey, pixels.reshape(self.rows - 1, -1, 2)[turn]) for turn in _BOTH_WAYS)
        return KnownPoints(self.corners, pixels if first <= last else pixels[::-1])

    def _charuco(self) -> cv2.aruco.CharucoBoard:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)


def calibrate_lens(views: Sequence[KnownPoints], width: int, height: int, max_error: float = MAX_ERROR) -> Lens:
    """Intrinsics from images of a board in different orientations.

    Args:
        views: corners of the board in each image; those with fewer than six are left out.
        width: of the images [px].
        height: of the images [px].
        max_error: largest reprojection error [px].

    Raises:
        PerceptionError: too few images, or the reprojection error is too large.
    """
    used = [view for view in views if len(view.world) >= 6]
    if len(used) < MIN_VIEWS:
        raise PerceptionError(
            f"{len(used)} images show at least 6 corners of the board; intrinsics need {MIN_VIEWS}, and 10 to 20 with "
            "the board tilted in different directions are better"
        )
    try:
        error, matrix, distortion, _, _ = cv2.calibrateCamera(
            [view.world.astype(np.float32) for view in used],
            [view.pixels.astype(np.float32) for view in used],
            (width, height),
            np.eye(3),
            np.zeros(5),
        )
    except cv2.error as reason:
        raise PerceptionError(
            f"the intrinsics cannot be found from {len(used)} images ({reason}); tilt the board more"
        ) from reason
    _check_error(error, max_error, "intrinsics")
    return Lens(
        matrix.astype(np.float64),
        width,
        height,
        np.asarray(distortion, dtype=np.float64).ravel()[:5],
        float(error),
        len(used),
    )


def calibrate_pose(lens: Lens, points: KnownPoints, max_error: float = MAX_ERROR) -> Calibration:
    """The camera whose image of points of the world fits best.

    Args:
        lens: the camera's intrinsics.
        points: world frame; at least four, not on a line.
        max_error: largest reprojection error [px].

    Raises:
        PerceptionError: no pose explains the points, the camera would be below the table, or the reprojection error is
            too large.
    """
    flags = cv2.SOLVEPNP_IPPE if _is_flat(points.world) else cv2.SOLVEPNP_SQPNP
    start, frame = _horizontal(points.world)
    try:
        solutions = cv2.solvePnPGeneric(start, points.pixels, lens.intrinsics, lens.distortion, flags=flags)
    except cv2.error as reason:
        raise PerceptionError(f"no pose of the camera explains the known points ({reason})") from reason
    best: tuple[float, float, Camera] | None = None
    for turn, place in zip(*solutions[1:3], strict=True):
        turn, place = cv2.solvePnPRefineLM(start, points.pixels, lens.intrinsics, lens.distortion, turn, place)
        to_camera = np.eye(4)
        to_camera[:3, :3] = cv2.Rodrigues(turn)[0]
        to_camera[:3, 3] = place.ravel()
        pose = np.linalg.inv(to_camera @ frame).astype(np.float64)
        pose[3] = 0.0, 0.0, 0.0, 1.0
        try:
            camera = Camera(lens.intrinsics, lens.distortion, pose, lens.width, lens.height)
        except ConfigError:  # below the table: the mirror image of a plane
            continue
        errors = np.hypot(*(camera.project(points.world) - points.pixels).T)
        error = float(np.sqrt((errors**2).mean()))
        if np.isfinite(error) and (best is None or error < best[0]):
            best = error, float(errors.max()), camera
    if best is None:
        raise PerceptionError(
            "no pose above the table explains the known points; x is to the right, y away from the robot's side and z "
            "upwards, and pixels are (column, row)"
        )
    _check_error(best[0], max_error, "pose")
    return Calibration(best[2], best[0], best[1], len(points.world), lens.error, lens.num_views)


def read_points(path: str | os.PathLike[str]) -> KnownPoints:
    """Read a CSV file with the columns x, y, z [m] and column, row [px].

    Raises:
        DataError: it cannot be read, a column is missing, or an entry is no number.
        PerceptionError: the points cannot be used, see :class:`KnownPoints`.
    """
    reader = csv.DictReader(POINTS_FILE.read_text(path).splitlines())
    missing = [name for name in _COLUMNS if name not in (reader.fieldnames or ())]
    if missing:
        raise POINTS_FILE.damaged(path, f"the column {missing[0]} is missing: it should have {', '.join(_COLUMNS)}")
    rows = []
    for number, row in enumerate(reader, start=2):
        try:
            rows.append([float(row[name]) for name in _COLUMNS])
        except (TypeError, ValueError) as error:
            raise POINTS_FILE.damaged(path, f"line {number} has an entry that is no number ({error})") from error
    table = np.array(rows, dtype=np.float64).reshape(-1, len(_COLUMNS))
    return KnownPoints(table[:, :3], table[:, 3:])


def read_image(path: str | os.PathLike[str]) -> npt.NDArray[np.uint8]:
    """Read an image file: [H, W, 3] uint8, RGB.

    Raises:
        DataError: it cannot be read or is no image.
    """
    kind = FileKind("an image (PNG or JPEG)", "take it again")
    kind.require(path)
    image = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise kind.damaged(path, "OpenCV cannot decode it")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


_BOTH_WAYS: Final = (np.s_[:, :], np.s_[::-1, ::-1])


def _square_brightness(grey: npt.NDArray[Any], corners: FloatArray) -> float:
    """Brightness of the square outside of the first of the inner corners [R, C, 2] of a checkerboard."""
    centre = corners[0, 0] - 0.5 * (corners[0, 1] - corners[0, 0]) - 0.5 * (corners[1, 0] - corners[0, 0])
    column, row = np.clip(np.round(centre), 0, np.array(grey.shape[::-1]) - 1).astype(int)
    return float(grey[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3].mean())


def _check_error(error: float, limit: float, what: str) -> None:
    if not error <= limit:
        raise PerceptionError(
            f"the camera's {what} explains the known points with an error of {error:.2f} px, more than {limit:g} px: "
            "is a point measured or clicked wrongly, or are the units not metres?"
        )


def _is_flat(world: FloatArray) -> bool:
    spreads = np.linalg.svd(world - world.mean(axis=0), compute_uv=False)
    return bool(spreads[2] < 1e-6 * spreads[0])


def _horizontal(world: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points in a frame in which those of a plane have z = 0, which OpenCV's solver of planes needs; and the transform
    [4, 4] from the world to that frame."""
    centre = world.mean(axis=0)
    axes = np.linalg.svd(world - centre)[2]
    if np.linalg.det(axes) < 0.0:
        axes[2] = -axes[2]
    frame = np.eye(4)
    frame[:3, :3] = axes
    frame[:3, 3] = -axes @ centre
    moved = (world - centre) @ axes.T
    if _is_flat(world):
        moved[:, 2] = 0.0
    return moved, frame
