"""Train our segmentation network on labelled frames (Sec. 5.1): ``python -m pipelines.train_segmenter``.

The artefact is a folder with ``segmenter.onnx``, which :class:`visualrhp.embodiment.segmentation.onnx_segmenter.
OnnxSegmenter` reads, its card ``segmenter.json``, ``metrics.json`` and ``curves.csv``. A killed training is continued
from its last epoch.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.app import app
from pipelines.workflow.tracking import Run

if TYPE_CHECKING:
    from pipelines.config import TrainSegmenterConfig
    from visualrhp.embodiment.segmentation.training import SegmenterTraining

STAGE = "train_segmenter"

NUM_THREADS = 2
"""Number of threads of torch; it determines the order of sums, and thus the last bits of a result."""

_STATE = "state.safetensors"


@app(STAGE)
def main(config: TrainSegmenterConfig) -> None:
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work
    from visualrhp.embodiment.segmentation.export import check_exporter
    from visualrhp.embodiment.segmentation.frame_set import read_card

    check_exporter()
    inputs = {"frames": read_card(config.frames).content_hash}
    with open_work(config, STAGE, inputs) as work, open_run(config, STAGE, "segmentation network", work) as run:
        publish(train(config, inputs["frames"], work, run), config.paths.artefact, STAGE)


def train(config: TrainSegmenterConfig, content_hash: str, work: Path, run: Run) -> Path:
    """Train in ``work``, or continue there; return the folder of the artefact.

    Raises:
        DataError: the frames were replaced since the stage started, or are damaged.
    """
    import pandas as pd
    from tqdm import tqdm

    from pipelines.workflow.artefacts import card
    from pipelines.workflow.workspace import empty_folder
    from visualrhp.embodiment.segmentation.export import export_onnx
    from visualrhp.embodiment.segmentation.frame_set import file_hash
    from visualrhp.files import atomic_path, write_json

    learner = make_training(config, content_hash)
    state = work / _STATE
    if os.path.lexists(state):
        learner.load(state)
    with tqdm(total=config.learner.epochs, initial=learner.epoch, desc="Segmenter", unit="epoch") as progress:
        for row in learner.run():
            learner.save(state)
            run.log_metrics({name: value for name, value in row.items() if name != "epoch"}, step=int(row["epoch"]))
            progress.update()
            progress.set_postfix({"loss": f"{row['train/loss']:.3f}"})
    folder = empty_folder(work / "artefact")
    table = pd.DataFrame(learner.history).drop(columns="samples_per_s").set_index("epoch")
    table = table.sort_index(axis="columns").reset_index()  # rows from before a restart have another order
    with atomic_path(folder / "curves.csv") as path:
        table.to_csv(path, index=False, float_format="%.5g")
    metrics = {name: float(value) for name, value in table.iloc[-1].items()}
    write_json(folder / "metrics.json", metrics)
    network = folder / "segmenter.onnx"
    export_onnx(learner.network, network)
    about = card(config, STAGE, metrics=metrics, frames=content_hash, sha256=file_hash(network))
    write_json(folder / "segmenter.json", about)
    for path in sorted(folder.iterdir()):
        run.log_artifact(path)
    return folder


def make_training(config: TrainSegmenterConfig, content_hash: str) -> SegmenterTraining:
    """The training, ready to run or to be resumed.

    Raises:
        DataError: the frames are missing or damaged, or are others than those of ``content_hash``.
    """
    import torch

    from visualrhp.embodiment.segmentation.frame_set import load_frame_set, read_card
    from visualrhp.embodiment.segmentation.network import SegmentationNetwork
    from visualrhp.embodiment.segmentation.training import SegmenterTraining
    from visualrhp.errors import DataError
    from visualrhp.streams import TrainingStream

    torch.set_num_threads(NUM_THREADS)
    frames = load_frame_set(config.frames)
    if read_card(config.frames).content_hash != content_hash:
        raise DataError(f"{config.frames} was replaced while this command started; run it again")
    network = SegmentationNetwork(config.network, TrainingStream.SEGMENTER_WEIGHTS.seed(config.seed))
    return SegmenterTraining(network.to(config.device), frames, config.learner, config.seed)


if __name__ == "__main__":
    main()
