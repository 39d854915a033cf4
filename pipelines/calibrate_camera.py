"""Calibrate the camera above the table: ``python -m pipelines.calibrate_camera``.

Writes ``camera.json``, which ``cell.calibration`` refers to, its card, and ``board.png``, the pattern to print. The
reprojection error is printed; if it is too large, nothing is written (exit code 2).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import CalibrateCameraConfig
    from visualrhp.embodiment.calibration import Calibration, Lens

STAGE = "calibrate_camera"

_DRAWING_SCALE = 5000.0
"""Pixels per metre of the drawing of the board; 127 dots per inch."""


@app(STAGE)
def main(config: CalibrateCameraConfig) -> None:
    calibrate(config)


def calibrate(config: CalibrateCameraConfig) -> Path:
    """Calibrate the camera; return the folder with the result.

    Raises:
        ConfigError: a source of the intrinsics or of the pose is missing.
        DataError: a file is missing or damaged.
        PerceptionError: points or images cannot be used, or the reprojection error is too large.
    """
    import cv2

    from pipelines.workflow.artefacts import card
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.workspace import empty_folder, open_work
    from visualrhp.files import write_json

    config.check_sources()
    with open_work(config, STAGE, _inputs(config)) as work:
        found = calibration(config)
        content = {
            "error_px": found.error,
            "worst_error_px": found.worst,
            "points": found.num_points,
            "intrinsics_error_px": found.intrinsics_error,
            "images": found.num_views,
        }
        if found.intrinsics_error is not None:
            print(f"Intrinsics: reprojection error {found.intrinsics_error:.3f} px in {found.num_views} images.")
        x, y, z = found.camera.position
        print(
            f"Pose: reprojection error {found.error:.3f} px, at most {found.worst:.3f} px, of {found.num_points} "
            f"points; the camera is at ({x:.3f}, {y:.3f}, {z:.3f}) m."
        )
        folder = empty_folder(work / "artefact")
        found.camera.save(folder / "camera.json")
        cv2.imwrite(str(folder / "board.png"), config.board.drawing(_DRAWING_SCALE))
        write_json(folder / "card.json", card(config, STAGE, **content))
        publish(folder, config.paths.artefact, STAGE)
    return Path(config.paths.artefact)


def calibration(config: CalibrateCameraConfig) -> Calibration:
    """The camera of ``config``.

    Raises:
        DataError, PerceptionError: as :func:`calibrate`.
    """
    from visualrhp.embodiment.calibration import calibrate_pose, read_image, read_points
    from visualrhp.errors import PerceptionError

    lens = _lens(config)
    if config.points is not None:
        points = read_points(config.points)
    else:
        assert config.table_image is not None
        image = read_image(config.table_image)
        if image.shape[:2] != (lens.height, lens.width):
            raise PerceptionError(
                f"{config.table_image} has {image.shape[1]} x {image.shape[0]} pixels, and the camera whose intrinsics "
                f"are used has {lens.width} x {lens.height}; take all images with the same settings"
            )
        place = config.place
        points = config.board.on_table(config.board.find(image), place.x, place.y, place.yaw, place.height)
    return calibrate_pose(lens, points, config.max_error)


def _lens(config: CalibrateCameraConfig) -> Lens:
    """The intrinsics, from images or from an earlier calibration."""
    from visualrhp.embodiment.calibration import Lens, calibrate_lens, read_image
    from visualrhp.embodiment.camera import Camera
    from visualrhp.errors import PerceptionError

    if config.lens is not None:
        camera = Camera.load(config.lens)
        return Lens(camera.intrinsics, camera.width, camera.height, camera.distortion)
    views, size = [], None
    for path in config.images:
        image = read_image(path)
        size = size or image.shape
        if image.shape != size:
            raise PerceptionError(f"{path} has the shape {list(image.shape)}, and {config.images[0]} has {list(size)}")
        try:
            views.append(config.board.find(image))
        except PerceptionError as error:
            print(f"{path} is left out: {error}.")
    assert size is not None
    return calibrate_lens(views, size[1], size[0], config.max_error)


def _inputs(config: CalibrateCameraConfig) -> dict[str, str]:
    """Checksums of the files."""
    from visualrhp.demonstrations.dataset import file_hash
    from visualrhp.documents import FileKind

    kind = FileKind("a file of the calibration", "give another path")
    hashes = {}
    for path in (*config.images, config.lens, config.table_image, config.points):
        if path is not None:
            kind.require(path)
            hashes[path] = file_hash(Path(path))
    return hashes


if __name__ == "__main__":
    main()
