"""A camera is found again from what it sees, and bad points are refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.embodiment.seen_bodies import top_camera
from visualrhp.embodiment.calibration import (
    Board,
    KnownPoints,
    Lens,
    calibrate_lens,
    calibrate_pose,
    read_image,
    read_points,
)
from visualrhp.embodiment.camera import Camera
from visualrhp.errors import ConfigError, DataError, PerceptionError

CAMERA = top_camera(look_at=(0.05, -0.02, 0.0), distortion=(0.08, -0.05, 0.001, -0.002, 0.01))
LENS = Lens(CAMERA.intrinsics, CAMERA.width, CAMERA.height, CAMERA.distortion)
CORNERS = np.array([[-0.2, -0.2, 0.0], [0.2, -0.2, 0.0], [0.2, 0.2, 0.0], [-0.2, 0.2, 0.0]])


def seen(world, noise: float = 0.0) -> KnownPoints:
    pixels = CAMERA.project(world)
    return KnownPoints(world, pixels + np.random.default_rng(0).normal(0.0, noise, pixels.shape) if noise else pixels)


def test_four_corners_of_the_table_give_the_pose() -> None:
    found = calibrate_pose(LENS, seen(CORNERS))
    assert found.camera.pose == pytest.approx(CAMERA.pose, abs=1e-6)
    assert found.error < 1e-4 and found.num_points == 4 and found.intrinsics_error is None


def test_points_at_different_heights_give_the_pose() -> None:
    world = np.concatenate([CORNERS, CORNERS * 0.7 + (0.02, 0.0, 0.1)])
    assert calibrate_pose(LENS, seen(world)).camera.pose == pytest.approx(CAMERA.pose, abs=1e-6)


def test_clicks_that_are_a_little_off_give_an_error_of_their_size() -> None:
    world = np.random.default_rng(1).uniform(-0.25, 0.25, (40, 3)) * (1.0, 1.0, 0.0)
    found = calibrate_pose(LENS, seen(world, 0.5))
    assert 0.4 < found.error < 0.9 and found.worst > found.error
    assert np.abs(found.camera.position - CAMERA.position).max() < 0.02


def test_points_that_are_refused() -> None:
    with pytest.raises(PerceptionError, match="3 known points are too few"):
        KnownPoints(CORNERS[:3], np.zeros((3, 2)))
    line = np.linspace(0.0, 0.4, 6)[:, None] * (1.0, 0.5, 0.0)
    with pytest.raises(PerceptionError, match="lie on a line"):
        seen(line)
    with pytest.raises(PerceptionError, match="not finite"):
        KnownPoints(CORNERS, np.full((4, 2), np.nan))
    with pytest.raises(PerceptionError, match=r"not \[4, 2\] and \[4, 2\]"):
        KnownPoints(CORNERS[:, :2], np.zeros((4, 2)))


def test_points_that_do_not_fit_are_refused() -> None:
    pixels = CAMERA.project(CORNERS)
    pixels[2] += 40.0
    with pytest.raises(PerceptionError, match=r"error of [\d.]+ px, more than 1 px"):
        calibrate_pose(LENS, KnownPoints(CORNERS, pixels))


def test_a_mirrored_table_is_refused() -> None:
    with pytest.raises(PerceptionError, match="no pose above the table"):
        calibrate_pose(LENS, KnownPoints(CORNERS * (-1.0, 1.0, 1.0), CAMERA.project(CORNERS)))


@pytest.fixture(scope="module")
def board_views() -> tuple[Board, list[KnownPoints]]:
    """The corners of a board that is held in front of the camera in eight orientations."""
    board = Board(columns=7, rows=5, square=0.05)
    rng = np.random.default_rng(3)
    views = []
    for _ in range(8):
        turn = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
        world = (board.corners - board.corners.mean(axis=0)) @ turn.T + (0.0, 0.0, 0.15) + rng.uniform(-0.05, 0.05, 3)
        views.append(KnownPoints(board.corners, CAMERA.project(world)))
    return board, views


def test_views_of_a_board_give_the_intrinsics(board_views) -> None:
    _, views = board_views
    lens = calibrate_lens(views, CAMERA.width, CAMERA.height)
    assert lens.error is not None and lens.error < 0.01 and lens.num_views == 8
    assert lens.intrinsics == pytest.approx(CAMERA.intrinsics, rel=0.01, abs=1.0)
    found = calibrate_pose(lens, seen(CORNERS))
    assert found.camera.position == pytest.approx(CAMERA.position, abs=5e-3)
    assert found.intrinsics_error == lens.error and found.num_views == 8


def test_two_views_are_too_few(board_views) -> None:
    with pytest.raises(PerceptionError, match="2 images show at least 6 corners"):
        calibrate_lens(board_views[1][:2], CAMERA.width, CAMERA.height)


@pytest.mark.parametrize("pattern", ["charuco", "checkerboard"])
def test_a_printed_board_is_found(pattern: str) -> None:
    board = Board(pattern=pattern, columns=7, rows=6, square=0.05)
    drawing = np.pad(board.drawing(1500.0), 60, constant_values=255)
    shift = np.array([[1.0, 0.02, 4.0], [-0.03, 0.95, 20.0]])
    image = cv2.warpAffine(drawing, shift, (700, 600), borderValue=(255.0,))
    points = board.find(np.repeat(image[:, :, None], 3, axis=2))
    drawn = points.world[:, :2] * 1500.0 + 60.0 - 0.5
    assert len(points.world) == 30
    assert np.abs(points.pixels - (drawn @ shift[:, :2].T + shift[:, 2])).max() < 0.6
    with pytest.raises(PerceptionError, match="board"):
        board.find(np.full((100, 100, 3), 255, dtype=np.uint8))


def test_a_board_that_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"marker=0\.05 should be smaller"):
        Board(square=0.04, marker=0.05)
    with pytest.raises(ConfigError, match="DICT_5X5_100"):
        Board(dictionary="DICT_NONE")
    with pytest.raises(ConfigError, match="at least 3"):
        Board(columns=2)
    with pytest.raises(ConfigError, match="an even and an odd number"):
        Board(pattern="checkerboard", columns=8, rows=6)


def test_a_board_on_the_table_gives_the_pose() -> None:
    board = Board(columns=7, rows=5, square=0.05)
    # Its first corner is at the upper left, seen from above.
    left_upper = board.on_table(KnownPoints(board.corners, np.zeros((24, 2))), -0.15, 0.12, 0.0).world
    assert left_upper[0] == pytest.approx([-0.10, 0.07, 0.0]) and left_upper[-1] == pytest.approx([0.15, -0.08, 0.0])
    turned = board.on_table(KnownPoints(board.corners, np.zeros((24, 2))), -0.1, 0.15, -0.3, 0.003).world
    assert turned[:, 2] == pytest.approx(0.003)
    found = calibrate_pose(LENS, seen(turned))
    assert found.camera.pose == pytest.approx(CAMERA.pose, abs=1e-6)


def test_points_from_a_file(tmp_path) -> None:
    path = tmp_path / "points.csv"
    rows = np.column_stack([CORNERS, CAMERA.project(CORNERS)])
    path.write_text("x,y,z,column,row\n" + "\n".join(",".join(map(repr, map(float, row))) for row in rows))
    assert read_points(path).pixels == pytest.approx(CAMERA.project(CORNERS))
    path.write_text("x,y,z,column\n0,0,0,1\n")
    with pytest.raises(DataError, match="the column row is missing"):
        read_points(path)
    path.write_text("x,y,z,column,row\n0,0,zero,1,2\n")
    with pytest.raises(DataError, match="line 2 has an entry that is no number"):
        read_points(path)


def test_images_from_files(tmp_path) -> None:
    image = np.zeros((4, 5, 3), dtype=np.uint8)
    image[..., 0] = 200
    cv2.imwrite(str(tmp_path / "red.png"), image[..., ::-1])
    assert np.array_equal(read_image(tmp_path / "red.png"), image)
    (tmp_path / "none.png").write_text("no image")
    with pytest.raises(DataError, match="cannot decode"):
        read_image(tmp_path / "none.png")


def test_a_calibrated_camera_survives_its_file(tmp_path) -> None:
    camera = calibrate_pose(LENS, seen(CORNERS)).camera
    camera.save(tmp_path / "camera.json")
    assert Camera.load(tmp_path / "camera.json") == camera
