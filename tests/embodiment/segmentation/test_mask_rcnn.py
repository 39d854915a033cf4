"""torchvision is replaced by a module with the same interface: its network is large, and its weights are the user's."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation.mask_rcnn import MaskRCNNSegmenter
from visualrhp.errors import CheckpointError, ConfigError

NAME = "torchvision.models.detection"


class Network(nn.Module):
    """Answers with three masks: as bright parts of the image (orange), its left half (person), its top (cup)."""

    def __init__(self) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.zeros(1))

    def forward(self, images):
        assert not self.training and len(images) == 1
        image = images[0]
        assert image.dtype == torch.float32 and image.shape[0] == 3 and 0.0 <= image.min() <= image.max() <= 1.0
        masks = torch.zeros(4, 1, *image.shape[1:])
        masks[0, 0] = image[0]
        masks[1, 0, :, :10] = 1.0
        masks[2, 0, :5] = 1.0
        masks[3, 0, 5:] = 1.0
        scores = torch.tensor([0.6, 0.99, 0.9, 0.4]) * self.scale
        return [{"labels": torch.tensor([55, 1, 47, 44]), "scores": scores, "masks": masks}]


@pytest.fixture
def torchvision(monkeypatch):
    module = ModuleType(NAME)

    def maskrcnn_resnet50_fpn(weights, weights_backbone):
        assert weights is None and weights_backbone is None  # nothing is downloaded
        return Network()

    module.maskrcnn_resnet50_fpn = maskrcnn_resnet50_fpn
    monkeypatch.setitem(sys.modules, NAME, module)
    return module


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_detections_of_the_task(torchvision, tmp_path, suffix: str) -> None:
    path = tmp_path / f"weights{suffix}"
    (torch.save if suffix == ".pth" else save_file)({"scale": torch.ones(1)}, path)
    image = np.zeros((20, 30, 3), dtype=np.uint8)
    image[8:14, 12:20, 0] = 255
    found = MaskRCNNSegmenter(path).segment(image)
    assert [each.kind for each in found] == [Kind.CUP, Kind.ORANGE]
    assert np.array_equal(found[1].mask, image[..., 0] > 0)
    assert found[1].score == pytest.approx(0.6)
    assert [each.kind for each in MaskRCNNSegmenter(path, least_score=0.95).segment(image)] == []


def test_weights_that_are_refused(torchvision, tmp_path) -> None:
    with pytest.raises(CheckpointError, match="does not exist"):
        MaskRCNNSegmenter(tmp_path / "none.pth")
    (tmp_path / "text.pth").write_text("no weights")
    with pytest.raises(CheckpointError, match="cannot be read"):
        MaskRCNNSegmenter(tmp_path / "text.pth")
    torch.save({"other": torch.ones(1)}, tmp_path / "other.pth")
    with pytest.raises(CheckpointError, match="weights of another network"):
        MaskRCNNSegmenter(tmp_path / "other.pth")
    torch.save(Network(), tmp_path / "pickled.pth")
    with pytest.raises(CheckpointError, match="cannot be read"):
        MaskRCNNSegmenter(tmp_path / "pickled.pth")


def test_torchvision_is_asked_for(monkeypatch, tmp_path) -> None:
    torch.save({"scale": torch.ones(1)}, tmp_path / "weights.pth")
    monkeypatch.setitem(sys.modules, NAME, None)
    with pytest.raises(ConfigError, match="pip install torchvision"):
        MaskRCNNSegmenter(tmp_path / "weights.pth")
