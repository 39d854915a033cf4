"""Labelled frames of the simulated cell, for our segmentation network: ``python -m pipelines.generate_frames``.

Frames are taken of random cells, in which the arm moves about between them. Cells are simulated in blocks, in parallel;
finished blocks are kept in the work folder, so that a killed run can be resumed. The set has a card, metrics and a
contact sheet.
"""

from __future__ import annotations

import functools
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.app import app
from pipelines.workflow.tracking import Run

if TYPE_CHECKING:
    import numpy as np

    from pipelines.config import GenerateFramesConfig
    from visualrhp.embodiment.segmentation.frames import LabelledFrames

STAGE = "generate_frames"

BLOCK_SIZE = 10
"""Cells of a block, and of a file of the set."""

_SHOWN = 30
"""Frames on the contact sheet."""


@app(STAGE)
def main(config: GenerateFramesConfig) -> None:
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work
    from visualrhp.embodiment.packages import robot_package

    robot_package("mujoco")
    with open_work(config, STAGE) as work, open_run(config, STAGE, "labelled frames", work) as run:
        publish(generate(config, work, run), config.paths.artefact, STAGE)


def generate(config: GenerateFramesConfig, work: Path, run: Run) -> Path:
    """Generate the missing blocks in ``work``; return the folder of the set."""
    from pipelines.workflow.artefacts import card
    from pipelines.workflow.workspace import empty_folder
    from visualrhp.embodiment.segmentation.frame_set import load_frame_set, write_card
    from visualrhp.files import write_json
    from visualrhp.rendering.pictures import write_picture

    blocks = fill(config, work)
    folder = empty_folder(work / "set")
    files = [folder / f"frames-{number:05d}.npz" for number in range(len(blocks))]
    for block, file in zip(blocks, files, strict=True):
        shutil.copyfile(block, file)
    write_card(folder, files, **card(config, STAGE))
    frames = load_frame_set(folder)
    metrics = statistics(frames)
    write_json(folder / "metrics.json", metrics)
    write_picture(folder / "contact_sheet.png", contact_sheet(frames))
    run.log_metrics(metrics)
    for name in ("card.json", "metrics.json", "contact_sheet.png"):
        run.log_artifact(folder / name)
    return folder


def fill(config: GenerateFramesConfig, work: Path) -> list[Path]:
    """Generate the blocks that ``work`` lacks; return the files of all, in order."""
    from tqdm import tqdm

    from pipelines.workflow.executor import run_tasks
    from visualrhp.embodiment.segmentation.frames import read_frames, write_frames
    from visualrhp.errors import DataError

    folder = work / "blocks"
    folder.mkdir(exist_ok=True)
    ranges = [
        range(first, min(first + BLOCK_SIZE, config.num_cells)) for first in range(0, config.num_cells, BLOCK_SIZE)
    ]
    files = [folder / f"block-{number:05d}.npz" for number in range(len(ranges))]
    missing = []
    for number, path in enumerate(files):
        try:
            read_frames(path)
        except DataError:  # missing, or damaged after it was written
            if os.path.lexists(path):
                path.unlink()
            missing.append(ranges[number])
    task = functools.partial(frames_of_block, config)
    with tqdm(total=config.num_cells, desc="Frames", unit="cell", smoothing=0.0) as progress:
        progress.update(config.num_cells - sum(map(len, missing)))
        for cells, frames in run_tasks(task, missing, config.executor):
            write_frames(files[cells.start // BLOCK_SIZE], frames)
            progress.update(len(cells))
    return files


def frames_of_block(config: GenerateFramesConfig, cells: range) -> tuple[range, LabelledFrames]:
    """The frames of a block; also return its cells, since blocks finish in any order."""
    from visualrhp.embodiment.segmentation.cell_frames import generate_frames
    from visualrhp.streams import Split

    return cells, generate_frames(cells, config.cell, config.sampling, config.seed, Split.SEGMENTATION)


def statistics(frames: LabelledFrames) -> dict[str, float]:
    """Number of frames, and visible objects a frame by kind."""
    import numpy as np

    from visualrhp.embodiment.segmentation.classes import FIRST_OBJECT_CLASS, NUM_CLASSES, object_of
    from visualrhp.embodiment.segmentation.frames import FIRST_INSTANCE

    counts = np.zeros(NUM_CLASSES)
    for classes, instances in zip(frames.classes, frames.instances, strict=True):
        seen = np.unique(instances)
        counts += np.bincount(classes[seen[seen >= FIRST_INSTANCE] - FIRST_INSTANCE], minlength=NUM_CLASSES)
    metrics = {"frames": float(len(frames)), "objects_per_frame": float(counts.sum() / len(frames))}
    for index in range(FIRST_OBJECT_CLASS, NUM_CLASSES):
        kind, is_lying = object_of(index)
        metrics[f"objects_per_frame/{kind}{'_lying' if is_lying else ''}"] = float(counts[index] / len(frames))
    return metrics


def contact_sheet(frames: LabelledFrames) -> np.ndarray:
    """[H, W, 3] uint8: some of the frames, outlines of objects in white."""
    import numpy as np

    shown = np.linspace(0, len(frames) - 1, min(_SHOWN, len(frames))).astype(int)
    pictures = []
    for image, labels in zip(frames.images[shown], frames.instances[shown], strict=True):
        picture = image.copy()
        border = np.zeros(labels.shape, bool)
        border[:, 1:] |= labels[:, 1:] != labels[:, :-1]
        border[1:] |= labels[1:] != labels[:-1]
        picture[border] = 255
        pictures.append(picture)
    columns = min(6, len(pictures))
    blank = np.zeros_like(pictures[0])
    pictures += [blank] * (-len(pictures) % columns)
    rows = [np.concatenate(pictures[start : start + columns], axis=1) for start in range(0, len(pictures), columns)]
    return np.concatenate(rows)


if __name__ == "__main__":
    main()
