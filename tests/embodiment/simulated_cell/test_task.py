import pickle
from dataclasses import replace

import numpy as np
import pytest

from tests.embodiment.simulated_cell.cells import APPLE, BOX
from visualrhp.embodiment.simulated_cell.task import TABLE_SIDE, CellTask, miscalibrated, nominal_camera
from visualrhp.errors import SceneError


def test_a_task_is_made_of_objects_and_poses() -> None:
    task = CellTask((APPLE, BOX), [[0.1, 0.0, 0.0], [0.0, 0.1, 0.5]])  # pyright: ignore[reportArgumentType]
    assert task.poses.shape == (2, 3)
    assert not task.poses.flags.writeable
    assert pickle.loads(pickle.dumps(task)) == task
    assert replace(task, seed=1) != task
    assert replace(task, poses=task.poses + 0.01) != task
    assert task != "a task"


@pytest.mark.parametrize(
    ("objects", "poses", "message"),
    [
        ((), [], "no objects"),
        ((APPLE,), [[0.0, 0.0, 0.0]] * 2, "1 objects and 2 poses"),
        ((APPLE,), [[0.0, np.nan, 0.0]], "finite"),
    ],
)
def test_what_is_no_cell_is_refused(objects, poses, message) -> None:
    with pytest.raises(SceneError, match=message):
        CellTask(objects, poses)


def test_the_camera_sees_the_table_and_what_is_around_it() -> None:
    camera = nominal_camera()
    half = 0.5 * TABLE_SIDE
    pixels = camera.project([[-half, half, 0.0], [half, -half, 0.0]])
    assert pixels.min() > 0.05 * camera.height
    assert (pixels < (camera.width, 0.95 * camera.height)).all()
    assert camera.back_project([[0.5 * camera.width, -0.5]])[0, 1] == pytest.approx(half + 0.09, abs=0.01)


def test_calibration_errors_have_the_given_size() -> None:
    camera, rng = nominal_camera(), np.random.default_rng(0)
    found = [miscalibrated(camera, 0.002, 0.001, rng) for _ in range(300)]
    offsets = np.array([each.position - camera.position for each in found])
    assert offsets.std(axis=0) == pytest.approx([0.002] * 3, rel=0.2)
    angles = [np.arccos(0.5 * (np.trace(each.pose[:3, :3] @ camera.pose[:3, :3].T) - 1.0)) for each in found]
    assert np.sqrt(np.mean(np.square(angles))) == pytest.approx(0.001 * np.sqrt(3.0), rel=0.2)
    assert miscalibrated(camera, 0.0, 0.0, rng) == camera
