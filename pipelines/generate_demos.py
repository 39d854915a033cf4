"""Generate demonstrations: kinodynamic RRT on random task instances (Sec. 6.1). ``python -m pipelines.generate_demos``.

Task instances are attempted in blocks, in parallel; finished blocks are kept in the work folder, so that a killed run
can be resumed. The set is published with metrics (independent of the speed of the machine), a table of lengths, a
contact sheet and a video.

A set that an earlier run published is verified: damaged shards are named and generated again; an intact set is not
changed.
"""

from __future__ import annotations

import functools
import json
import logging
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.app import app
from pipelines.workflow.tracking import Run

if TYPE_CHECKING:
    from pipelines.config import GenerateDemosConfig
    from visualrhp.demonstrations.blocks import BlockStore
    from visualrhp.demonstrations.dataset import DemonstrationSet
    from visualrhp.demonstrations.shards import Arrays
    from visualrhp.types import IntArray

_log = logging.getLogger(__name__)

STAGE = "generate_demos"

_VIDEO_FPS = 12.0
_NUM_ROWS = 50
"""Number of rows of metrics that are tracked."""


@app(STAGE)
def main(config: GenerateDemosConfig) -> None:
    from pipelines.workflow.publishing import check_destination, check_writable, publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work, reserved_paths

    published = Path(config.paths.artefact)
    # A damaged set is repaired rather than replaced.
    with open_work(config, STAGE, check=lambda: check_writable(published.parent)) as work:
        if is_published(config, published, work):
            return
        check_destination(published, STAGE, reserved=reserved_paths(config))
        with open_run(config, STAGE, f"demonstrations {config.action_space.name}", work) as run:
            folder = generate(config, work, run)
            for path in sorted(folder.iterdir()):
                if not path.name.startswith("shard"):
                    run.log_artifact(path)
            publish(folder, published, STAGE)


def generate(config: GenerateDemosConfig, work: Path, run: Run) -> Path:
    """Generate the demonstration set in ``work``; return its folder.

    Raises:
        ConfigError: the planner solves hardly any task instance.
    """
    from pipelines.workflow.artefacts import card
    from visualrhp.demonstrations.blocks import write_set
    from visualrhp.demonstrations.dataset import DemonstrationSet
    from visualrhp.demonstrations.writer import DemonstrationWriter
    from visualrhp.files import remove_unfinished_files, write_json, write_text

    folder = work / "set"
    remove_unfinished_files(folder)
    # Shards of an interrupted run are overwritten with the same bytes.
    demonstrations = config.demonstrations
    writer = DemonstrationWriter(folder, config.action_space.name, demonstrations.count, demonstrations.shard_size)
    statistics = write_set(block_store(config, work, run), writer)
    writer.finish(**card(config, STAGE))
    metrics = statistics.metrics()
    run.log_metrics(metrics)
    run.log_metrics(statistics.timings())
    write_json(folder / "metrics.json", metrics)
    write_text(folder / "lengths.csv", statistics.length_table())
    write_pictures(config, folder, DemonstrationSet.open(folder, config.action_space.name), statistics.lengths())
    return folder


def is_published(config: GenerateDemosConfig, folder: Path, work: Path) -> bool:
    """Whether ``folder`` holds the set of ``config``, after repairing damaged shards.

    A set of other code or of another configuration is not repaired.
    """
    from pipelines.workflow.artefacts import card
    from pipelines.workflow.publishing import differing_files, read_mark
    from visualrhp.demonstrations.blocks import repair_set
    from visualrhp.demonstrations.dataset import damaged_shards, read_card
    from visualrhp.errors import DataError

    mark = read_mark(folder)
    if mark is not None and any(not name.startswith("shard") for name in differing_files(folder, mark)):
        return False
    try:
        found = read_card(folder)
    except DataError:
        return False
    about = json.loads(json.dumps(card(config, STAGE)))  # in the form in which it is read
    if any(found.get(key) != value for key, value in about.items()) or not about["commit"]:
        return False
    if about["commit"].endswith("-dirty") and not damaged_shards(folder, found):
        return False  # the code may have changed since then
    repaired = repair_set(folder, found, block_store(config, work), work)
    if repaired is None:
        _log.info("%s already holds these %d demonstrations.", folder, found["num_demonstrations"])
    elif repaired:
        _log.info("The damaged shards of %s were generated again, bit-exactly.", folder)
    return repaired is not False


def block_store(config: GenerateDemosConfig, work: Path, run: Run | None = None) -> BlockStore:
    """The blocks of attempts in the work folder; missing ones are generated by the workers of the executor."""
    from tqdm import tqdm

    from pipelines.workflow.executor import run_tasks
    from visualrhp.demonstrations.blocks import BLOCK_SIZE, BlockStore
    from visualrhp.demonstrations.generate import generate_block

    task = functools.partial(
        generate_block,
        distribution=config.scene,
        action_space=config.action_space.name,
        planner=config.planner,
        seed=config.seed,
        physics=config.physics,
    )
    label = f"Demonstrations, {config.action_space.name}"
    started = [0.0]

    def attempt(ranges: Sequence[range]) -> Iterator[Arrays]:
        started[0] = time.perf_counter()
        results = run_tasks(task, ranges, config.executor)
        with tqdm(total=len(ranges) * BLOCK_SIZE, desc=label, unit="task", smoothing=0.0) as progress:
            for arrays in results:
                yield arrays
                progress.update(BLOCK_SIZE)

    def track(numbers: range, finished: int, arrays: Arrays) -> None:
        if run is None or (finished % max(1, len(numbers) // _NUM_ROWS) and finished < len(numbers)):
            return
        attempted = (numbers.start + finished) * BLOCK_SIZE
        solved = arrays["solved"]
        metrics = {
            "progress/attempts": attempted,
            "progress/attempts_per_s": finished * BLOCK_SIZE / (time.perf_counter() - started[0]),
            "progress/mean_actions": float(arrays["length"][solved].mean()) if solved.any() else None,
        }
        run.log_metrics(metrics, step=attempted)

    return BlockStore(work / "blocks", attempt, track)


def write_pictures(
    config: GenerateDemosConfig, folder: Path, demonstrations: DemonstrationSet, lengths: IntArray
) -> None:
    """Write the contact sheet, the video and the histogram of lengths to ``folder``."""
    from visualrhp.demonstrations import pictures
    from visualrhp.files import atomic_path
    from visualrhp.rendering.pictures import write_picture
    from visualrhp.rendering.video import write_video

    write_picture(folder / "contact_sheet.png", pictures.contact_sheet(demonstrations))
    if config.video.num_scenes:
        frames = pictures.demonstration_frames(
            demonstrations,
            config.physics,
            config.video.num_scenes,
            config.video.size_px,
            frames_per_action=round(_VIDEO_FPS / 2),
            hold=round(_VIDEO_FPS),
        )
        write_video(folder / "demonstrations.webm", frames, _VIDEO_FPS)
    with atomic_path(folder / "lengths.png") as path:
        pictures.length_histogram(lengths.tolist(), demonstrations.action_space).savefig(path, dpi=120)


if __name__ == "__main__":
    main()
