import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.embodiment.simulated_cell.cells import APPLE, BOX, CUP, LYING_BOTTLE, ORANGE
from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.simulated_cell.cell import BACKGROUND, ROBOT, SimulatedCell
from visualrhp.embodiment.simulated_cell.looks import CellLook, Light
from visualrhp.embodiment.simulated_cell.objects import CellObject
from visualrhp.embodiment.simulated_cell.rendering import expose
from visualrhp.embodiment.simulated_cell.solids import box
from visualrhp.embodiment.simulated_cell.task import CellTask
from visualrhp.scene.scene import TargetRegion

PLAIN = CellLook(noise=0.0, blur=0.0, lights=(Light((0.0, 0.0, -1.0), 0.5, casts_shadow=False),))
CAMERA = Camera.above((0.01, -0.008, 1.4), 985.0, look_at=(0.02, 0.01, 0.0), distortion=(0.04, -0.01, 1e-3, -5e-4, 0.0))
THINGS = (APPLE, BOX, CUP, LYING_BOTTLE)
POSES = np.array([[0.1, 0.12, 0.0], [-0.02, 0.17, 0.5], [0.0, -0.15, 0.0], [0.15, -0.05, 1.3]])


@pytest.fixture(scope="module")
def cell():
    made = SimulatedCell(CellTask(THINGS, POSES, TargetRegion(np.array([-0.1, -0.1])), camera=CAMERA, look=PLAIN))
    yield made
    made.close()


def test_points_are_seen_where_the_camera_model_says() -> None:
    """Small flat markers all over the table, found in the instance mask.

    With a principal point that is not the centre of the image, and with a lens that moves markers by 3 pixels.
    """
    markers = [(x, y) for x in (-0.23, 0.0, 0.23) for y in (-0.23, 0.0, 0.23)][1:]
    thing = CellObject(Kind.BOX, box(0.008, 0.008, 0.004), mass=0.05)
    poses = np.array([(*marker, 0.0) for marker in markers])
    shifted = Camera(CAMERA.intrinsics + [[0, 0, 4.0], [0, 0, -7.0], [0, 0, 0]], np.zeros(5), CAMERA.pose)
    curved = replace(CAMERA, distortion=np.array([-0.3, 0.1, 2e-3, -1e-3, 0.0]))
    for camera in (CAMERA, shifted, curved):
        cell = SimulatedCell(
            CellTask((thing,) * len(markers), poses, camera=camera, look=PLAIN, gripper_pose=(-0.22, 0.0, 0.0))
        )
        mask = cell.instance_mask()
        expected = camera.project([(*marker, 0.002) for marker in markers])
        for number, pixel in enumerate(expected):
            rows, columns = np.nonzero(mask == number)
            if len(rows) > 100:  # whole, not hidden by the arm
                assert (columns.mean(), rows.mean()) == pytest.approx(pixel, abs=0.7)
        assert np.mean([np.count_nonzero(mask == number) > 100 for number in range(len(markers))]) > 0.6
        cell.close()


def test_frames_have_the_size_of_the_camera_and_the_time_of_the_clock(cell) -> None:
    cell.wait(0.05)
    frame = cell.frame()
    assert frame.image.shape == (480, 640, 3)
    assert frame.image.dtype == np.uint8
    assert frame.time_s == cell.now()
    assert 40.0 < frame.image.mean() < 220.0
    assert cell.side_view().shape == (480, 640, 3)
    assert cell.side_view().std() > 20.0
    assert cell.camera == CAMERA


def test_masks_are_silhouettes(cell) -> None:
    """The mask of an object holds its outline at its height, and little more than parallax adds."""
    truth, mask = cell.truth(), cell.instance_mask()
    assert set(np.unique(mask)) == {BACKGROUND, ROBOT, 0, 1, 2, 3}
    heights = (0.9 * 0.034, 0.0, 0.09, 0.032)
    for number, (outline, height) in enumerate(zip(truth.outlines, heights, strict=True)):
        ring = cell.camera.project(np.column_stack([outline, np.full(len(outline), height)]))
        seen = shapely.Polygon(ring)
        rows, columns = np.nonzero(mask == number)
        inside = shapely.contains_xy(seen.buffer(1.0), columns, rows)
        assert len(rows) >= 0.97 * seen.area, "all of the outline is seen"
        if number in (0, 3):  # round
            assert inside.mean() > 0.97


def test_detections_are_the_masks(cell) -> None:
    detections, mask = cell.detections(), cell.instance_mask()
    assert [detection.kind for detection in detections] == [thing.kind for thing in THINGS]
    assert [detection.is_lying for detection in detections] == [False, False, False, True]
    for number, detection in enumerate(detections):
        assert np.array_equal(detection.mask, mask == number)


def test_colours_are_those_of_the_objects(cell) -> None:
    red = CellObject(Kind.BOX, box(0.04, 0.03, 0.05), colour=(0.9, 0.05, 0.05))
    again = SimulatedCell(CellTask((red,), [[0.1, 0.1, 0.0]], camera=CAMERA, look=PLAIN))  # pyright: ignore[reportArgumentType]
    image = again.frame().image[again.instance_mask() == 0].astype(float)
    again.close()
    assert np.median(image[:, 0]) > 3.0 * np.median(image[:, 1])


def test_the_target_is_seen_as_a_green_disc(cell) -> None:
    image = cell.frame().image.astype(float)
    angles = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    centre = np.array([-0.1, -0.1])

    def colours(radius: float) -> np.ndarray:
        points = np.column_stack([centre + radius * np.stack([np.cos(angles), np.sin(angles)], 1), np.zeros(16)])
        columns, rows = np.rint(cell.camera.project(points)).astype(int).T
        return np.median(image[rows, columns], axis=0)

    assert colours(0.04)[1] > 1.5 * colours(0.04)[0], "green"
    assert colours(0.064).max() < 0.5 * colours(0.04)[1], "the ring is dark"
    assert colours(0.08).sum() > 1.5 * colours(0.064).sum(), "the table is not"


def test_noise_depends_on_the_task_and_the_number_of_the_frame() -> None:
    task = CellTask((ORANGE,), [[0.1, 0.1, 0.0]], seed=4)  # pyright: ignore[reportArgumentType]
    cells = [SimulatedCell(task), SimulatedCell(task), SimulatedCell(replace(task, seed=5))]
    first, again, other = ([cell.frame().image for _ in range(2)] for cell in cells)
    for cell in cells:
        cell.close()
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(first, other)


def test_exposure_adds_noise_blur_and_gain() -> None:
    grey = np.full((64, 64, 3), 100, dtype=np.uint8)
    rng = np.random.default_rng(0)
    assert np.array_equal(expose(grey, PLAIN, rng), grey)
    noisy = expose(grey, replace(PLAIN, noise=3.0), rng)
    assert noisy.std() == pytest.approx(3.0, rel=0.05)
    assert expose(grey, replace(PLAIN, gain=(1.1, 1.0, 0.5)), rng)[0, 0].tolist() == [110, 100, 50]
    edge = np.zeros((64, 64, 3), dtype=np.uint8)
    edge[:, 32:] = 200
    blurred = expose(edge, replace(PLAIN, blur=0.8), rng)
    assert 0 < blurred[32, 31, 0] < 100 < blurred[32, 32, 0] < 200


def test_without_an_opengl_library_the_packages_are_named() -> None:
    program = (
        "from tests.embodiment.simulated_cell.cells import APPLE, cell_of\n"
        "cell_of((APPLE, (0.0, 0.0, 0.0)), render=True)\n"
    )
    environment = {**os.environ, "MUJOCO_GL": "disable"}
    run = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    message = run.stderr.strip().splitlines()[-1]
    assert "ConfigError" in message
    assert "libegl1 libegl-mesa0 libgl1-mesa-dri" in message
