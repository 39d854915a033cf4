"""Any YOLO segmentation network in ONNX, in the layout of Ultralytics' versions 8 and 11, by ONNX Runtime.

Input ``[1, 3, h, w]``: RGB in [0, 1], the image scaled to fit and padded with grey (114). Outputs: of each of N
candidates ``[1, 4 + C + K, N]`` the box (centre x, y, width, height, in pixels of the input), the scores of C classes
and K coefficients; and ``[1, K, h / 4, w / 4]``, prototypes of masks. A mask is the sigmoid of the prototypes weighted
by the coefficients, within the box.
"""

from __future__ import annotations

import ast
import os
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.documents import FileKind
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.segmentation.coco import COCO_NAMES, KINDS_BY_NAME
from visualrhp.embodiment.segmentation.detection import Detection, Mask, seems_lying
from visualrhp.errors import CheckpointError
from visualrhp.types import FloatArray

NETWORK: Final = FileKind(
    "a YOLO segmentation network (an ONNX file)",
    "export it again, as ONNX with its task set to segment",
    CheckpointError,
)

_GREY: Final = 114
_MOST: Final = 300  # candidates after the threshold


class YoloSegmenter:
    """Finds objects with a YOLO segmentation network.

    Bottles and cups that lie are told from those that stand by their silhouettes
    (:func:`~visualrhp.embodiment.segmentation.detection.seems_lying`).

    Args:
        path: of the ONNX file. Names of classes are read from its metadata (``names``), else those of COCO.
        least_score: of a detection.
        most_overlap: intersection over union of two boxes of one class above which the less certain one is left out.
        nadir: pixel (column, row) that shows the point below the camera; None for the centre of the image.
        num_threads: of the inference.

    Raises:
        CheckpointError: the file is missing or damaged, is another network, or has none of the classes.
        ConfigError: ONNX Runtime is not installed.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        least_score: float = 0.4,
        most_overlap: float = 0.6,
        nadir: tuple[float, float] | None = None,
        num_threads: int = 1,
    ) -> None:
        NETWORK.require(path)
        runtime = robot_package("onnxruntime")
        options = runtime.SessionOptions()
        options.intra_op_num_threads = num_threads
        options.log_severity_level = 3
        try:
            self._session: Any = runtime.InferenceSession(
                Path(path).read_bytes(), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # of ONNX Runtime, whose errors have no common class
            raise NETWORK.damaged(path, f"ONNX Runtime cannot read it ({error})") from error
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        shapes = [list(output.shape) for output in outputs]
        if len(inputs) != 1 or len(outputs) != 2 or [len(shape) for shape in shapes] != [3, 4]:
            raise NETWORK.unusable(
                path, f"is no YOLO segmentation network of version 8 or 11: its outputs have the shapes {shapes}"
            )
        self._input = inputs[0].name
        # Axes that are dynamic have names; 640 is Ultralytics' default.
        self._height, self._width = (side if isinstance(side, int) else 640 for side in inputs[0].shape[2:])
        names = _names(self._session.get_modelmeta().custom_metadata_map.get("names"))
        self._kinds = {index: KINDS_BY_NAME[name] for index, name in names.items() if name in KINDS_BY_NAME}
        if not self._kinds:
            shown = ", ".join(list(names.values())[:8])
            raise NETWORK.unusable(path, f"has none of the classes {', '.join(KINDS_BY_NAME)}, but {shown}")
        self._num_classes = len(names)
        self._least_score, self._most_overlap, self._nadir = least_score, most_overlap, nadir

    def segment(self, image: npt.NDArray[np.uint8]) -> list[Detection]:
        """The objects in ``image``, [H, W, 3] uint8, RGB; the most certain first.

        Raises:
            CheckpointError: the outputs do not have the number of classes that the names have.
        """
        height, width = image.shape[:2]
        batch, scale, (left, top) = _letterbox(image, self._height, self._width)
        candidates, prototypes = self._session.run(None, {self._input: batch})
        rows, prototypes = candidates[0].T.astype(np.float32), prototypes[0]
        if rows.shape[1] != 4 + self._num_classes + len(prototypes):
            raise CheckpointError(
                f"the YOLO network has {rows.shape[1] - 4 - len(prototypes)} classes, and {self._num_classes} names"
            )
        classes = np.array(sorted(self._kinds))
        scores = rows[:, 4 + classes]
        best = scores.argmax(axis=1)
        confidence = scores[np.arange(len(rows)), best]
        kept = np.flatnonzero(confidence > self._least_score)
        kept = kept[np.argsort(-confidence[kept])][:_MOST]
        boxes = rows[kept, :4].astype(np.float64)
        boxes[:, :2] -= 0.5 * boxes[:, 2:]
        # Two kinds at one place are two readings of one object, so that classes compete.
        chosen = cv2.dnn.NMSBoxes(boxes.tolist(), confidence[kept].tolist(), self._least_score, self._most_overlap)
        detections = []
        for number in np.asarray(chosen, dtype=int).ravel():
            row = rows[kept[number]]
            logits = np.tensordot(row[4 + self._num_classes :], prototypes, axes=1)
            mask = self._mask(logits, boxes[number], (height, width), scale, (left, top))
            if not mask.any():
                continue
            kind = self._kinds[int(classes[best[kept[number]]])]
            lies = seems_lying(kind, mask, self._nadir)
            detections.append(Detection(kind, lies, mask, float(confidence[kept[number]])))
        return detections

    def _mask(
        self,
        logits: npt.NDArray[np.float32],
        box: FloatArray,
        size: tuple[int, int],
        scale: float,
        offset: tuple[int, int],
    ) -> Mask:
        """[H, W] of the image: where the logits [h / 4, w / 4] are positive, within a box (x, y, width, height)."""
        full = cv2.resize(logits, (self._width, self._height), interpolation=cv2.INTER_LINEAR)
        height, width = size
        inner = full[offset[1] : offset[1] + round(height * scale), offset[0] : offset[0] + round(width * scale)]
        image = cv2.resize(inner, (width, height), interpolation=cv2.INTER_LINEAR) > 0.0
        x, y = (box[:2] - offset) / scale
        end_x, end_y = (box[:2] + box[2:] - offset) / scale
        inside = np.zeros(size, dtype=bool)
        inside[max(round(y), 0) : max(round(end_y), 0), max(round(x), 0) : max(round(end_x), 0)] = True
        return image & inside


def _letterbox(
    image: npt.NDArray[np.uint8], height: int, width: int
) -> tuple[npt.NDArray[np.float32], float, tuple[int, int]]:
    """The network's input [1, 3, height, width], the scale, and the first column and row of the image in it."""
    scale = min(height / image.shape[0], width / image.shape[1])
    inner = round(image.shape[0] * scale), round(image.shape[1] * scale)
    top, left = (height - inner[0]) // 2, (width - inner[1]) // 2
    padded = np.full((height, width, 3), _GREY, dtype=np.uint8)
    resized = cv2.resize(image, (inner[1], inner[0]), interpolation=cv2.INTER_LINEAR)
    padded[top : top + inner[0], left : left + inner[1]] = resized
    batch = np.ascontiguousarray(padded.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255.0)
    return batch, scale, (left, top)


def _names(text: str | None) -> dict[int, str]:
    """Names of the classes, from the metadata of the file (a Python dictionary as text)."""
    if text:
        try:
            found = ast.literal_eval(text)
            entries = found.items() if isinstance(found, dict) else enumerate(found)
            return {int(index): str(name) for index, name in entries}
        except (ValueError, SyntaxError, TypeError):
            pass
    return dict(enumerate(COCO_NAMES))
