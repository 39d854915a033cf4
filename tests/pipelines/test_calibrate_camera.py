"""The camera is calibrated from files, at the command line's function and its refusals."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipelines.calibrate_camera import calibrate
from pipelines.config import CalibrateCameraConfig
from pipelines.workflow.app import compose
from tests.embodiment.seen_bodies import top_camera
from visualrhp.embodiment.calibration import Board
from visualrhp.embodiment.camera import Camera
from visualrhp.errors import ConfigError, DataError, PerceptionError

CAMERA = top_camera(focal_length=1000.0)
BOARD = Board()


def configure(outputs: Path, *overrides: str) -> CalibrateCameraConfig:
    return compose("calibrate_camera", CalibrateCameraConfig, [f"paths.outputs={outputs}", *overrides])


def picture(path: Path, to_world: np.ndarray, origin: np.ndarray) -> Path:
    """What the camera sees of the board, whose frame [3, 2] (x, y axes) and origin [3] are given in the world."""
    scale = 3000.0
    drawing = np.pad(BOARD.drawing(scale), 100, constant_values=255)
    corners = np.array([[0.0, 0.0], [0.32, 0.0], [0.32, 0.24], [0.0, 0.24]])
    seen = CAMERA.project(origin + corners @ to_world.T)
    drawn = corners * scale + 99.5
    transform = cv2.getPerspectiveTransform(drawn.astype(np.float32), seen.astype(np.float32))
    # Twice as fine, then averaged: the drawing is finer than the image.
    fine = np.diag([2.0, 2.0, 1.0]) @ transform
    large = cv2.warpPerspective(drawing, fine, (1280, 960), flags=cv2.INTER_AREA, borderValue=(200.0,))
    cv2.imwrite(str(path), cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA))
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images of a board that is held in different ways, and of one that lies on the table."""
    folder = tmp_path_factory.mktemp("images")
    flat = np.array([[1.0, 0.0], [0.0, -1.0], [0.0, 0.0]])
    rng = np.random.default_rng(2)
    for number in range(6):
        turn = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
        centre = np.array([0.0, 0.0, 0.2]) + rng.uniform(-0.04, 0.04, 3)
        picture(folder / f"{number}.png", turn @ flat, centre - turn @ flat @ (0.16, 0.12))
    picture(folder / "table.png", flat, np.array([-0.16, 0.12, 0.0]))
    points = np.array([[x, y, 0.0] for x in (-0.2, 0.0, 0.2) for y in (-0.15, 0.15)])
    rows = np.column_stack([points, CAMERA.project(points)])
    lines = [",".join(str(float(value)) for value in row) for row in rows]
    (folder / "points.csv").write_text("x,y,z,column,row\n" + "\n".join(lines))
    CAMERA.save(folder / "camera.json")
    return folder


def test_known_points_and_a_lens(tmp_path: Path, files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = calibrate(configure(tmp_path, f"lens={files}/camera.json", f"points={files}/points.csv"))
    found = Camera.load(folder / "camera.json")
    assert found.pose == pytest.approx(CAMERA.pose, abs=1e-6)
    card = json.loads((folder / "card.json").read_text())
    assert card["error_px"] < 1e-3 and card["points"] == 6 and card["intrinsics_error_px"] is None
    assert "Pose: reprojection error 0.000 px" in capsys.readouterr().out
    assert cv2.imread(str(folder / "board.png")) is not None


def test_images_of_a_board(tmp_path: Path, files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = ",".join(str(files / f"{number}.png") for number in range(6))
    folder = calibrate(configure(tmp_path, f"images=[{images}]", f"table_image={files}/table.png"))
    found = Camera.load(folder / "camera.json")
    table = np.array([[x, y, 0.0] for x in (-0.2, 0.2) for y in (-0.15, 0.15)])
    assert np.abs(found.project(table) - CAMERA.project(table)).max() < 2.0
    assert found.position == pytest.approx(CAMERA.position, abs=0.04)
    said = capsys.readouterr().out
    assert "in 6 images" in said and json.loads((folder / "card.json").read_text())["images"] == 6


def test_files_that_are_refused(tmp_path: Path, files: Path) -> None:
    with pytest.raises(DataError, match=r"none\.csv does not exist"):
        calibrate(configure(tmp_path, f"lens={files}/camera.json", f"points={files}/none.csv"))
    blank = files / "blank.png"
    cv2.imwrite(str(blank), np.full((480, 640, 3), 255, dtype=np.uint8))
    with pytest.raises(PerceptionError, match="shows 0 corners of the ChArUco board"):
        calibrate(configure(tmp_path, f"lens={files}/camera.json", f"table_image={blank}"))
    small = files / "small.png"
    cv2.imwrite(str(small), np.full((100, 100, 3), 255, dtype=np.uint8))
    with pytest.raises(PerceptionError, match="take all images with the same settings"):
        calibrate(configure(tmp_path, f"lens={files}/camera.json", f"table_image={small}"))


def test_an_error_that_is_too_large_writes_nothing(tmp_path: Path, files: Path) -> None:
    text = (files / "points.csv").read_text().replace("0.2,0.15,0.0,", "0.2,0.10,0.0,")
    (files / "wrong.csv").write_text(text)
    with pytest.raises(PerceptionError, match="more than 1 px"):
        calibrate(configure(tmp_path, f"lens={files}/camera.json", f"points={files}/wrong.csv"))
    assert not (tmp_path / "calibrate_camera").exists()


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="images and lens: one of them is needed"):
        calibrate(configure(tmp_path))
    with pytest.raises(ConfigError, match="points and table_image: one of them is needed"):
        calibrate(configure(tmp_path, "lens=camera.json"))
