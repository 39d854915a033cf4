"""The exported network answers as the trained one, and other files are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.embodiment.segmentation.painter import painted_image
from visualrhp.embodiment.segmentation.configs import NetworkConfig
from visualrhp.embodiment.segmentation.export import export_onnx
from visualrhp.embodiment.segmentation.frame_set import file_hash
from visualrhp.embodiment.segmentation.frames import Region, network_input
from visualrhp.embodiment.segmentation.network import OFFSET_UNIT, SegmentationNetwork
from visualrhp.embodiment.segmentation.onnx_segmenter import OnnxSegmenter
from visualrhp.errors import CheckpointError, PerceptionError

onnxruntime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")


@pytest.fixture(scope="module")
def network() -> SegmentationNetwork:
    made = SegmentationNetwork(NetworkConfig((4, 6, 8), (1, 1), 6, 4), seed=3)
    with torch.no_grad():  # statistics of normalization that are none of a new network
        for _ in range(3):
            made(torch.randint(0, 256, (2, 120, 120, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)))
    return made


@pytest.fixture(scope="module")
def path(network: SegmentationNetwork, tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("network") / "segmenter.onnx"
    export_onnx(network, found, 120)
    assert network.training  # as before
    network.eval()
    return found


def test_the_file_answers_as_the_network(path: Path, network: SegmentationNetwork) -> None:
    image = painted_image(np.random.default_rng(0), 3)[0]
    batch = network_input(image, Region.centred(*image.shape[:2]), 120)[None]
    probabilities, centres, offsets = onnxruntime.InferenceSession(str(path)).run(None, {"images": batch})
    with torch.inference_mode():
        output = network(torch.from_numpy(batch))
    np.testing.assert_allclose(probabilities, output.probabilities(), atol=1e-5)
    np.testing.assert_allclose(centres, output.centres.sigmoid(), atol=1e-5)
    np.testing.assert_allclose(offsets, output.offsets * OFFSET_UNIT, atol=1e-4)


def test_masks_have_the_size_of_the_image(path: Path) -> None:
    image = painted_image(np.random.default_rng(0), 3)[0]
    for detection in OnnxSegmenter(path).segment(image):
        assert detection.mask.shape == image.shape[:2] and detection.mask.dtype == bool
        assert not detection.mask[:, :40].any() and not detection.mask[:, -40:].any()  # outside the region


@pytest.mark.parametrize("content", [b"", b"no network"])
def test_damaged_files_are_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "segmenter.onnx"
    file.write_bytes(content)
    with pytest.raises(CheckpointError, match=r"segmenter\.onnx.*train_segmenter"):
        OnnxSegmenter(file)


def test_a_file_that_is_not_that_of_its_card_is_refused(path: Path, tmp_path: Path) -> None:
    copy = tmp_path / "segmenter.onnx"
    copy.write_bytes(path.read_bytes())
    copy.with_suffix(".json").write_text(json.dumps({"sha256": file_hash(copy)}))
    OnnxSegmenter(copy)
    copy.with_suffix(".json").write_text(json.dumps({"sha256": "0"}))
    with pytest.raises(CheckpointError, match=r"checksum is not that on its card"):
        OnnxSegmenter(copy)


def test_another_network_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "other.onnx"
    onnx = pytest.importorskip("onnx")
    value = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1, 3])
    answer = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [1, 3])
    node = onnx.helper.make_node("Identity", ["x"], ["y"])
    opset = [onnx.helper.make_opsetid("", 18)]
    graph = onnx.helper.make_graph([node], "identity", [value], [answer])
    file.write_bytes(onnx.helper.make_model(graph, opset_imports=opset, ir_version=9).SerializeToString())
    with pytest.raises(CheckpointError, match="is another network"):
        OnnxSegmenter(file)


@pytest.mark.parametrize(
    "image", [np.zeros((10, 10), np.uint8), np.zeros((10, 10, 3)), np.zeros((10, 10, 4), np.uint8)]
)
def test_what_is_no_image_is_refused(path: Path, image: np.ndarray) -> None:
    with pytest.raises(PerceptionError, match="it should be uint8"):
        OnnxSegmenter(path).segment(image)


def test_an_image_without_the_region_is_refused(path: Path) -> None:
    with pytest.raises(PerceptionError, match="does not hold the region"):
        OnnxSegmenter(path, Region(0, 0, 100)).segment(np.zeros((80, 120, 3), np.uint8))
