"""The configurations of the pipelines that make our segmentation network."""

from __future__ import annotations

from pipelines.config.common import PipelineConfig
from pipelines.config.execution import SimulatedCellConfig
from visualrhp.embodiment.segmentation.configs import FrameSampling, NetworkConfig, SegmenterTrainingConfig
from visualrhp.parameters import Count, parameters


@parameters
class GenerateFramesConfig(PipelineConfig):
    """``python -m pipelines.generate_frames``.

    Attributes:
        cell: random cells of which frames are taken.
        sampling: how frames are taken of a cell.
        num_cells: number of cells.
    """

    cell: SimulatedCellConfig
    sampling: FrameSampling
    num_cells: Count


@parameters
class TrainSegmenterConfig(PipelineConfig):
    """``python -m pipelines.train_segmenter``.

    Attributes:
        network: its size.
        learner: parameters of the training.
        frames: folder with the labelled frames, made by ``generate_frames``.
    """

    network: NetworkConfig
    learner: SegmenterTrainingConfig
    frames: str


@parameters
class EvaluateSegmenterConfig(PipelineConfig):
    """``python -m pipelines.evaluate_segmenter``.

    Attributes:
        cell: random cells of which frames are taken; they are others than those of the training.
        sampling: how frames are taken of a cell.
        num_cells: number of cells.
        network: ONNX file of the network; null for the released one.
    """

    cell: SimulatedCellConfig
    sampling: FrameSampling
    num_cells: Count
    network: str | None
