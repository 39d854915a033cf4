"""The segmentation network as an ONNX file (torch and onnxscript)."""

from __future__ import annotations

import importlib.util
import logging
import os
import warnings
from typing import cast

import torch
from torch import nn

from visualrhp.embodiment.segmentation.frames import INPUT_SIZE
from visualrhp.embodiment.segmentation.network import OFFSET_UNIT, SegmentationNetwork, SegmentationOutput
from visualrhp.embodiment.segmentation.onnx_segmenter import INPUT_NAME, OUTPUT_NAMES
from visualrhp.errors import ConfigError
from visualrhp.files import atomic_path


class _Inference(nn.Module):
    """The network with outputs as the grouping reads them."""

    def __init__(self, network: SegmentationNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        output = cast("SegmentationOutput", self.network(images))
        return output.probabilities(), output.centres.sigmoid(), output.offsets * OFFSET_UNIT


def check_exporter() -> None:
    """Check that the packages for the export are installed, before any work starts.

    Raises:
        ConfigError: they are not.
    """
    if importlib.util.find_spec("onnxscript") is None:
        raise ConfigError("An ONNX file needs the package onnxscript: pip install 'visualrhp[onnx]'.")


def export_onnx(network: SegmentationNetwork, path: str | os.PathLike[str], size: int = INPUT_SIZE) -> None:
    """Write the network for images of ``size`` x ``size`` pixels, one at a time, to an ONNX file, atomically.

    Raises:
        ConfigError: the packages for the export are not installed.
    """
    check_exporter()
    was_training = network.training
    example = torch.zeros((1, size, size, 3), dtype=torch.uint8)
    level = logging.getLogger("torch.onnx").level
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                _Inference(network).eval(),
                (example,),
                None,
                input_names=[INPUT_NAME],
                output_names=list(OUTPUT_NAMES),
                verbose=False,
            )
    finally:
        logging.getLogger("torch.onnx").setLevel(level)
        network.train(was_training)
    assert program is not None  # since no file was named
    with atomic_path(path) as temporary:
        temporary.write_bytes(program.model_proto.SerializeToString())
