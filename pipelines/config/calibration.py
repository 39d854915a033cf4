"""The configuration of the calibration of a camera."""

from __future__ import annotations

from typing import Annotated

from pipelines.config.common import PipelineConfig
from visualrhp.embodiment.calibration import Board
from visualrhp.errors import ConfigError
from visualrhp.parameters import AsTuple, Field, NonNegative, Positive, parameters

Coordinate = Annotated[float, Field(allow_inf_nan=False)]


@parameters
class BoardPlaceConfig:
    """Where the board lies on the table.

    Attributes:
        x: of its first corner, the upper left one of the drawing [m], world frame.
        y: of the same [m].
        yaw: direction of its rows [rad]; 0 along the world's x axis.
        height: of its surface above the table [m].
    """

    x: Coordinate
    y: Coordinate
    yaw: Coordinate
    height: NonNegative


@parameters
class CalibrateCameraConfig(PipelineConfig):
    """``python -m pipelines.calibrate_camera``.

    The intrinsics are found from ``images``, or taken from ``lens``. The pose is found from ``points``, or from
    ``table_image``, in which the board lies on the table.

    Attributes:
        board: the printed pattern.
        images: files with the board in different orientations.
        lens: file of a camera that was calibrated before.
        table_image: file with the board on the table.
        place: of the board in it.
        points: file with known points (CSV with the columns x, y, z in metres and column, row in pixels).
        max_error: largest root mean square reprojection error [px].
    """

    board: Board
    images: Annotated[tuple[str, ...], AsTuple]
    lens: str | None
    table_image: str | None
    place: BoardPlaceConfig
    points: str | None
    max_error: Positive

    def check_sources(self) -> None:
        """Check that there is one source of the intrinsics, and one of the pose.

        Raises:
            ConfigError: there is none, or there are two.
        """
        if bool(self.images) == (self.lens is not None):
            raise ConfigError(
                "images and lens: one of them is needed, for the intrinsics: images=[a.png,b.png,c.png] of a board, or "
                "lens=camera.json of a camera that was calibrated before."
            )
        if (self.points is None) == (self.table_image is None):
            raise ConfigError(
                "points and table_image: one of them is needed, for the pose: points=points.csv, or "
                "table_image=table.png of the board on the table."
            )
