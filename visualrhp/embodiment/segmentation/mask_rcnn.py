"""torchvision's Mask R-CNN with the classes of COCO, as in the paper (Sec. 5.1 and 9), from a weights file of the user.

The weights are those of ``torchvision.models.detection.maskrcnn_resnet50_fpn`` (``MaskRCNN_ResNet50_FPN_Weights.
COCO_V1``) as a state dict, in a PyTorch or a safetensors file. Nothing is downloaded.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from visualrhp.documents import FileKind
from visualrhp.embodiment.segmentation.coco import KINDS_OF_COCO
from visualrhp.embodiment.segmentation.detection import Detection, seems_lying
from visualrhp.errors import CheckpointError, ConfigError

WEIGHTS: Final = FileKind(
    "weights of torchvision's maskrcnn_resnet50_fpn (a state dict, .pth or .safetensors)",
    "download them again",
    CheckpointError,
)


class MaskRCNNSegmenter:
    """Finds objects with torchvision's Mask R-CNN.

    Bottles and cups that lie are told from those that stand by their silhouettes
    (:func:`~visualrhp.embodiment.segmentation.detection.seems_lying`).

    Args:
        path: of the weights.
        least_score: of a detection.
        nadir: pixel (column, row) that shows the point below the camera; None for the centre of the image.
        device: of torch.

    Raises:
        ConfigError: torchvision is not installed.
        CheckpointError: the file is missing or damaged, or holds weights of another network.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        least_score: float = 0.5,
        nadir: tuple[float, float] | None = None,
        device: str = "cpu",
    ) -> None:
        WEIGHTS.require(path)
        detection = _detection_models()
        state = _read(Path(path))
        self._network: Any = detection.maskrcnn_resnet50_fpn(weights=None, weights_backbone=None)
        try:
            self._network.load_state_dict(state)
        except (RuntimeError, AttributeError, TypeError) as error:
            raise WEIGHTS.unusable(path, f"holds weights of another network: {error!s:.300}") from error
        self._network.eval().to(device)
        self._device, self._least_score, self._nadir = device, least_score, nadir

    def segment(self, image: npt.NDArray[np.uint8]) -> list[Detection]:
        """The objects in ``image``, [H, W, 3] uint8, RGB; the most certain first."""
        import torch

        batch = torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1).float().div(255.0)
        with torch.inference_mode():
            found = self._network([batch.to(self._device)])[0]
        labels, scores = found["labels"].cpu().numpy(), found["scores"].cpu().numpy()
        detections = []
        for number in np.argsort(-scores, kind="stable"):
            kind = KINDS_OF_COCO.get(int(labels[number]))
            if kind is None or scores[number] < self._least_score:
                continue
            mask = found["masks"][int(number), 0].cpu().numpy() > 0.5
            if mask.any():
                lies = seems_lying(kind, mask, self._nadir)
                detections.append(Detection(kind, lies, mask, float(scores[number])))
        return detections


def _detection_models() -> Any:
    try:
        return importlib.import_module("torchvision.models.detection")
    except ImportError as error:
        raise ConfigError(
            f"segmenter=mask_rcnn needs torchvision, which cannot be imported ({error}): pip install torchvision, in "
            "the version for the installed torch."
        ) from error


def _read(path: Path) -> Any:
    """The state dict of a file."""
    import torch

    try:
        if path.suffix == ".safetensors":
            from safetensors.torch import load_file

            return load_file(path)
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # of torch, pickle, zipfile and safetensors
        raise WEIGHTS.damaged(path, f"it cannot be read ({error!s:.300})") from error
