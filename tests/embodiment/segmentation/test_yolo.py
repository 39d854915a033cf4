"""A tiny ONNX network in the layout of YOLO, with known outputs."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation.yolo import YoloSegmenter
from visualrhp.errors import CheckpointError

SIDE, COEFFICIENTS = 64, 2
NAMES = {0: "person", 1: "bottle", 2: "orange", 3: "cup"}
IMAGE = np.zeros((48, 64, 3), dtype=np.uint8)


def network(path, candidates, prototypes=None, names=NAMES, side=SIDE):
    """A network that answers with constants: each row of ``candidates`` is [x, y, w, h, scores, coefficients].

    The first prototype is positive everywhere, the second in the left half.
    """
    if prototypes is None:
        prototypes = np.ones((COEFFICIENTS, side // 4, side // 4), dtype=np.float32)
        prototypes[1, :, side // 8 :] = -1.0
    rows = np.array(candidates, dtype=np.float32).T[None]
    parts = {"rows": rows, "prototypes": prototypes[None].astype(np.float32), "nothing": np.zeros(1, np.float32)}
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "nothing"], ["zero"]),
        helper.make_node("Add", ["rows", "zero"], ["output0"]),
        helper.make_node("Add", ["prototypes", "zero"], ["output1"]),
    ]
    graph = helper.make_graph(
        nodes,
        "yolo",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, side, side])],
        [
            helper.make_tensor_value_info("output0", TensorProto.FLOAT, list(rows.shape)),
            helper.make_tensor_value_info("output1", TensorProto.FLOAT, [1, *prototypes.shape]),
        ],
        [numpy_helper.from_array(array, name) for name, array in parts.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if names is not None:
        helper.set_model_props(model, {"names": str(names)})
    onnx.save(model, str(path))
    return path


def test_boxes_classes_and_masks(tmp_path) -> None:
    # The image of 64 x 48 lies in rows 8 to 56 of the input.
    rows = [
        [32.0, 32.0, 20.0, 16.0, 0.0, 0.0, 0.9, 0.1, 1.0, 0.0],  # an orange in the middle, all of its box
        [16.0, 20.0, 32.0, 8.0, 0.0, 0.0, 0.1, 0.8, 0.0, 1.0],  # a cup, of which the mask is the left half
        [50.0, 50.0, 8.0, 8.0, 0.99, 0.0, 0.0, 0.0, 1.0, 0.0],  # a person
        [50.0, 20.0, 8.0, 8.0, 0.0, 0.3, 0.0, 0.0, 1.0, 0.0],  # a bottle that is too uncertain
    ]
    found = YoloSegmenter(network(tmp_path / "yolo.onnx", rows)).segment(IMAGE)
    assert [(each.kind, round(each.score, 3)) for each in found] == [(Kind.ORANGE, 0.9), (Kind.CUP, 0.8)]
    orange = np.zeros((48, 64), dtype=bool)
    orange[16:32, 22:42] = True
    assert np.array_equal(found[0].mask, orange)
    assert found[1].mask[8:16, 0:30].all() and found[1].mask.sum() == pytest.approx(8 * 32, abs=16)


def test_of_two_boxes_at_one_place_the_more_certain_is_kept(tmp_path) -> None:
    rows = [
        [32.0, 32.0, 20.0, 16.0, 0.0, 0.0, 0.7, 0.0, 1.0, 0.0],
        [33.0, 32.0, 20.0, 16.0, 0.0, 0.0, 0.0, 0.8, 1.0, 0.0],
        [52.0, 32.0, 10.0, 16.0, 0.0, 0.0, 0.6, 0.0, 1.0, 0.0],
    ]
    found = YoloSegmenter(network(tmp_path / "yolo.onnx", rows)).segment(IMAGE)
    assert [each.kind for each in found] == [Kind.CUP, Kind.ORANGE]


def test_an_image_of_another_size_is_scaled(tmp_path) -> None:
    rows = [[32.0, 32.0, 16.0, 16.0, 0.0, 0.9, 0.0, 0.0, 1.0, 0.0]]
    segmenter = YoloSegmenter(network(tmp_path / "yolo.onnx", rows))
    found = segmenter.segment(np.zeros((480, 640, 3), dtype=np.uint8))
    rows_seen, columns_seen = np.nonzero(found[0].mask)
    assert (columns_seen.min(), columns_seen.max()) == pytest.approx((240, 399), abs=1)
    assert (rows_seen.min(), rows_seen.max()) == pytest.approx((160, 319), abs=1)
    assert segmenter.segment(IMAGE)[0].mask.shape == (48, 64)


def test_without_names_the_classes_are_those_of_coco(tmp_path) -> None:
    scores = np.zeros(80)
    scores[[39, 47]] = 0.6, 0.9  # bottle, apple
    path = network(tmp_path / "yolo.onnx", [[32.0, 32.0, 20.0, 16.0, *scores, 1.0, 0.0]], names=None)
    assert [each.kind for each in YoloSegmenter(path).segment(IMAGE)] == [Kind.APPLE]


def test_nothing_is_found_in_nothing(tmp_path) -> None:
    rows = [[32.0, 32.0, 20.0, 16.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]]
    assert YoloSegmenter(network(tmp_path / "yolo.onnx", rows)).segment(IMAGE) == []


def test_files_that_are_refused(tmp_path) -> None:
    with pytest.raises(CheckpointError, match="does not exist"):
        YoloSegmenter(tmp_path / "none.onnx")
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(CheckpointError, match="ONNX Runtime cannot read it"):
        YoloSegmenter(tmp_path / "text.onnx")
    row = [32.0, 32.0, 20.0, 16.0, 0.9, 1.0, 0.0]
    with pytest.raises(CheckpointError, match="has none of the classes bottle"):
        YoloSegmenter(network(tmp_path / "other.onnx", [row], names={0: "person"}))
    segmenter = YoloSegmenter(network(tmp_path / "names.onnx", [row]))
    with pytest.raises(CheckpointError, match="1 classes, and 4 names"):
        segmenter.segment(IMAGE)
    flat = network(tmp_path / "flat.onnx", [row], prototypes=np.ones((2, 256), np.float32))
    with pytest.raises(CheckpointError, match="no YOLO segmentation network"):
        YoloSegmenter(flat)
