"""Scores by hand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import shapely

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation.detection import Detection
from visualrhp.embodiment.segmentation.scores import SeenObject, matches, score_frame, summary

CAMERA = Camera.above((0.0, 0.0, 1.0), 500.0, 320, 240)


def disc(x: float, y: float, radius: float) -> np.ndarray:
    mask = np.zeros((240, 320), np.uint8)
    cv2.circle(mask, (round(x), round(y)), round(radius), 1, -1)
    return mask.astype(bool)


def seen(x: float, y: float, kind: Kind = Kind.BOX, **more: bool) -> SeenObject:
    """A disc; its outline is that on the table below the camera's pixel."""
    centre = CAMERA.back_project(np.array([[x, y]]), 0.0)[0]
    return SeenObject(kind, False, disc(x, y, 20), shapely.Point(*centre).buffer(0.04), **more)


def detected(x: float, y: float, kind: Kind = Kind.BOX, is_lying: bool = False) -> Detection:
    return Detection(kind, is_lying, disc(x, y, 20))


def test_a_perfect_answer() -> None:
    objects = [seen(100, 80), seen(200, 120, Kind.CUP)]
    score = score_frame([detected(200, 120, Kind.CUP), detected(100, 80)], objects, CAMERA)
    assert (score.num_required, score.num_found, score.num_invented, score.num_kinds) == (2, 2, 0, 2)
    assert (score.num_with_posture, score.num_postures) == (1, 1)
    assert score.mask_overlaps == (1.0, 1.0)
    metrics = summary([score])
    assert metrics["found_rate"] == metrics["kind_rate"] == 1.0 and metrics["invented_rate"] == 0.0


def test_mistakes_are_counted() -> None:
    """One is missed, one is of another kind, one is invented."""
    objects = [seen(60, 60), seen(160, 120, Kind.APPLE), seen(260, 180)]
    score = score_frame([detected(160, 120, Kind.ORANGE), detected(260, 180), detected(60, 180)], objects, CAMERA)
    assert (score.num_required, score.num_found, score.num_detections) == (3, 2, 3)
    assert (score.num_invented, score.num_kinds) == (1, 1)
    metrics = summary([score, score])
    assert metrics["found_rate"] == pytest.approx(2 / 3) and metrics["invented_rate"] == pytest.approx(1 / 3)
    assert metrics["kind_rate"] == 0.5


def test_what_is_hidden_need_not_be_found_and_is_not_invented() -> None:
    objects = [seen(100, 100, is_required=False, is_whole=False)]
    assert score_frame([], objects, CAMERA).num_required == 0
    for x in (100, 112):
        score = score_frame([detected(x, 100)], objects, CAMERA)
        assert (score.num_required, score.num_found, score.num_invented) == (0, 0, 0)


def test_distances_are_those_on_the_table() -> None:
    """A box is projected between 0 and 7 cm; a disc below the camera shrinks, and its centre stays."""
    (error,) = score_frame([detected(159.5, 119.5)], [seen(159.5, 119.5)], CAMERA).centre_errors
    assert error < 0.002
    moved = seen(159.5, 119.5)
    outline = shapely.affinity.translate(moved.outline, 0.01, 0.0)
    moved = SeenObject(moved.kind, False, moved.mask, outline)
    (error,) = score_frame([detected(159.5, 119.5)], [moved], CAMERA).centre_errors
    assert error == pytest.approx(0.01, abs=0.002)


def test_one_detection_is_of_one_object() -> None:
    objects = [seen(100, 100), seen(104, 100)]
    assert len(matches([detected(102, 100)], objects)) == 1
    assert matches([], objects) == {} and matches([detected(1, 1)], []) == {}
