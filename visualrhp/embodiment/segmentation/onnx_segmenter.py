"""Our segmentation network as a :class:`~visualrhp.embodiment.segmentation.detection.Segmenter`, by ONNX Runtime."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from visualrhp.documents import FileKind, document
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.segmentation.classes import NUM_CLASSES, object_of
from visualrhp.embodiment.segmentation.detection import Detection
from visualrhp.embodiment.segmentation.frames import Region, network_input
from visualrhp.embodiment.segmentation.grouping import GroupingConfig, group
from visualrhp.embodiment.segmentation.mirroring import Maps, mean_over_mirrors
from visualrhp.errors import CheckpointError, PerceptionError

NETWORK: Final = FileKind(
    "our segmentation network (an ONNX file)",
    "make it with python -m pipelines.train_segmenter, or use the released one",
    CheckpointError,
)

INPUT_NAME: Final = "images"
OUTPUT_NAMES: Final = ("probabilities", "centres", "offsets")
"""[1, C, G, G] of the classes; [1, G, G] in [0, 1]; [1, 2, G, G] in cells."""


def released_segmenter_path() -> Path:
    """File of the released network; its card is the JSON file of the same name."""
    return Path(__file__).parents[2] / "pretrained" / "segmenter" / "segmenter.onnx"


@document
class _Card:
    """What is read of the card of a network. Attributes: ``sha256``, of its file."""

    sha256: str


class OnnxSegmenter:
    """Finds objects with our network.

    If a card lies beside the file, a JSON document of the same name, the file's checksum is verified.

    Args:
        path: its file; None for the released one.
        region: part of the image that shows the table; None for the largest square in the middle.
        grouping: when cells are an object.
        num_threads: of the inference.

    Raises:
        CheckpointError: the file is missing or damaged, or is another network.
        ConfigError: ONNX Runtime is not installed.
    """

    def __init__(
        self,
        path: str | os.PathLike[str] | None = None,
        region: Region | None = None,
        grouping: GroupingConfig | None = None,
        num_threads: int = 1,
    ) -> None:
        path = released_segmenter_path() if path is None else Path(path)
        NETWORK.require(path)
        content = path.read_bytes()
        card = path.with_suffix(".json")
        if card.is_file() and NETWORK.read(card, _Card).sha256 != hashlib.sha256(content).hexdigest():
            raise NETWORK.damaged(path, f"its checksum is not that on its card, {card.name}")
        runtime = robot_package("onnxruntime")
        options = runtime.SessionOptions()
        options.intra_op_num_threads = num_threads
        options.log_severity_level = 3
        try:
            self._session: Any = runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # of ONNX Runtime, whose errors have no common class
            raise NETWORK.damaged(path, f"ONNX Runtime cannot read it ({error})") from error
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        if [i.name for i in inputs] != [INPUT_NAME] or tuple(o.name for o in outputs) != OUTPUT_NAMES:
            raise NETWORK.unusable(path, f"is another network: its outputs are {[o.name for o in outputs]}")
        shape = inputs[0].shape
        if len(shape) != 4 or shape[1] != shape[2] or shape[3] != 3 or outputs[0].shape[1] != NUM_CLASSES:
            raise NETWORK.unusable(path, f"is another network: its input is {shape}, of {outputs[0].shape[1]} classes")
        self._size = int(shape[1])
        self._region = region
        self._grouping = grouping or GroupingConfig()

    def segment(self, image: npt.NDArray[np.uint8]) -> list[Detection]:
        """The objects in ``image``, [H, W, 3] uint8, RGB; those with the highest peaks first.

        Raises:
            PerceptionError: the image has another shape or type, or does not hold the region.
        """
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise PerceptionError(
                f"the image is {image.dtype} of shape {list(image.shape)}; it should be uint8 of [height, width, 3]"
            )
        height, width = image.shape[:2]
        region = self._region or Region.centred(height, width)
        if region.x < 0 or region.y < 0 or region.x + region.size > width or region.y + region.size > height:
            raise PerceptionError(f"the image has {width} x {height} pixels and does not hold the region {region}")
        maps = mean_over_mirrors(self._answer, network_input(image, region, self._size))
        detections = []
        for instance in group(*maps, region.size, self._grouping):
            mask = np.zeros((height, width), bool)
            region.of(mask)[...] = instance.mask
            kind, is_lying = object_of(instance.class_index)
            detections.append(Detection(kind, is_lying, mask, instance.score))
        return detections

    def _answer(self, image: npt.NDArray[np.uint8]) -> Maps:
        probabilities, centres, offsets = self._session.run(None, {INPUT_NAME: image[None]})
        return probabilities[0], centres[0], offsets[0]
