"""Our segmentation network on cells that it has not seen (Sec. 5.1): ``python -m pipelines.evaluate_segmenter``.

Detections are compared with the cell's truth: objects found and invented, their kinds, masks, and outlines on the
table. Cells are simulated in parallel, and finished ones are kept in a journal. The artefact is a folder with
``metrics.json``, ``frames.csv``, one row a frame, and ``worst.png``, the frames with the most mistakes.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.workflow.app import app
from pipelines.workflow.tracking import Run

if TYPE_CHECKING:
    from pipelines.config import EvaluateSegmenterConfig

STAGE = "evaluate_segmenter"

_JOURNAL = "cells.jsonl"
_NETWORK, _TRUTH = "network", "true_masks"
_OUTLINES = ("centre", "outline")
"""Metrics that would not be perfect with true masks: an outline on the table is found with the height of its kind."""
_SHOWN = 6


@app(STAGE)
def main(config: EvaluateSegmenterConfig) -> None:
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work
    from visualrhp.embodiment.segmentation.frame_set import file_hash
    from visualrhp.embodiment.segmentation.onnx_segmenter import OnnxSegmenter

    path = network_path(config)
    OnnxSegmenter(path)  # a file that is none is found before any work
    inputs = {"network": file_hash(path)}
    with open_work(config, STAGE, inputs) as work, open_run(config, STAGE, "segmentation network", work) as run:
        publish(evaluate(config, inputs["network"], work, run), config.paths.artefact, STAGE)


def network_path(config: EvaluateSegmenterConfig) -> Path:
    """The file of the network."""
    from visualrhp.embodiment.segmentation.onnx_segmenter import released_segmenter_path

    return released_segmenter_path() if config.network is None else Path(config.network)


def evaluate(config: EvaluateSegmenterConfig, network: str, work: Path, run: Run) -> Path:
    """Score the cells that the journal in ``work`` lacks; return the folder of the artefact."""
    import pandas as pd
    from tqdm import tqdm

    from pipelines.workflow.artefacts import card
    from pipelines.workflow.executor import run_tasks
    from pipelines.workflow.workspace import empty_folder
    from visualrhp.embodiment.segmentation.scores import FrameScore, summary
    from visualrhp.evaluation.journal import Journal
    from visualrhp.files import atomic_path, write_json
    from visualrhp.rendering.pictures import write_picture

    journal = Journal(work / _JOURNAL, dict[str, list[FrameScore]])
    missing = [index for index in range(config.num_cells) if str(index) not in journal]
    tasks = run_tasks(functools.partial(score_cell, config), missing, config.executor)
    for index, scores in tqdm(tasks, total=len(missing), desc="Cells", unit="cell"):
        journal.append(str(index), scores)
    rows = [
        (index, number, FrameScore.of(content))
        for index in range(config.num_cells)
        for number, content in enumerate(journal[str(index)][_NETWORK])
    ]
    metrics = summary([score for *_, score in rows])
    perfect = [FrameScore.of(content) for index in range(config.num_cells) for content in journal[str(index)][_TRUTH]]
    metrics |= {f"{_TRUTH}/{name}": value for name, value in summary(perfect).items() if name.startswith(_OUTLINES)}
    folder = empty_folder(work / "artefact")
    write_json(folder / "metrics.json", metrics)
    write_json(folder / "card.json", card(config, STAGE, metrics=metrics, network=network))
    table = pd.DataFrame([{"cell": index, "frame": number, **score.row()} for index, number, score in rows])
    with atomic_path(folder / "frames.csv") as path:
        table.to_csv(path, index=False, float_format="%.5g")
    worst = sorted(rows, key=lambda row: -row[2].badness)[:_SHOWN]
    write_picture(folder / "worst.png", pictures(config, [(index, number) for index, number, _ in worst]))
    run.log_metrics(metrics)
    for path in sorted(folder.iterdir()):
        run.log_artifact(path)
    return folder


def score_cell(config: EvaluateSegmenterConfig, index: int) -> tuple[int, dict[str, list[dict[str, Any]]]]:
    """The scores of the frames of a cell, and those that true masks have; also return its index, since cells finish in
    any order."""
    from dataclasses import asdict

    from visualrhp.embodiment.segmentation.cell_frames import seen_objects, visits
    from visualrhp.embodiment.segmentation.onnx_segmenter import OnnxSegmenter
    from visualrhp.embodiment.segmentation.scores import score_frame
    from visualrhp.streams import Split

    segmenter = OnnxSegmenter(network_path(config))
    scores: dict[str, list[dict[str, Any]]] = {_NETWORK: [], _TRUTH: []}
    for cell in visits(index, config.cell, config.sampling, config.seed, Split.EVALUATION):
        objects = seen_objects(cell)
        for name, detections in ((_NETWORK, segmenter.segment(cell.frame().image)), (_TRUTH, cell.detections())):
            scores[name].append(asdict(score_frame(detections, objects, cell.camera)))
    return index, scores


def pictures(config: EvaluateSegmenterConfig, frames: list[tuple[int, int]]) -> Any:
    """[H, W, 3] uint8: frames (cell, number) with outlines and kinds of detections, and masks of objects that were
    missed."""
    import numpy as np

    from visualrhp.embodiment.segmentation.cell_frames import seen_objects, visits
    from visualrhp.embodiment.segmentation.onnx_segmenter import OnnxSegmenter
    from visualrhp.embodiment.segmentation.overlays import overlay
    from visualrhp.streams import Split

    segmenter = OnnxSegmenter(network_path(config))
    shown = []
    for index, wanted in frames:
        for number, cell in enumerate(visits(index, config.cell, config.sampling, config.seed, Split.EVALUATION)):
            image = cell.frame().image
            if number == wanted:
                shown.append(overlay(image, segmenter.segment(image), seen_objects(cell)))
                break
    shown += [np.zeros_like(shown[0])] * (-len(shown) % 2)
    rows = [np.concatenate(shown[start : start + 2], axis=1) for start in range(0, len(shown), 2)]
    return np.concatenate(rows)


if __name__ == "__main__":
    main()
