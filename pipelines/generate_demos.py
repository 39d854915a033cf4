"""Generate demonstrations: kinodynamic RRT on random task instances (Sec. 6.1). ``python -m pipelines.generate_demos``.

Task instances are attempted in blocks of consecutive indices, in parallel; finished blocks are kept in the work
folder, so that a killed run loses at most the blocks in flight. The set consists of the first ``demonstrations.count``
solved instances by index; an instance without a plan is recorded as a failure and replaced by the next index. So the
set depends on the configuration and the seed alone. It is published with a metrics file (counts, nothing that depends
on the speed of the machine), a table of lengths, a contact sheet and a video.

The command looks at what an earlier run of it published: shards that have been damaged since are named and made again,
a whole set is left as it is.
"""

from __future__ import annotations

import errno
import itertools
import json
import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.app import app
from pipelines.config import GenerateDemosConfig, VideoConfig
from pipelines.tracking import Run

if TYPE_CHECKING:
    from visualrhp.learning.demonstrations import Arrays, DemonstrationSet
    from visualrhp.rendering.video import Frame

_log = logging.getLogger(__name__)

STAGE = "generate_demos"

_BLOCK_SIZE = 8
"""Attempts per task of a worker."""

_NUM_TRIALS = 200
"""Attempts before a planner that solves next to nothing is given up."""

_LITTLE_SPACE = 1 << 16
"""Free bytes of a disk that is as good as full."""

_NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}

_SHEET_ROWS, _SHEET_COLUMNS, _SHEET_SIZE_PX = 8, 8, 160
_VIDEO_FPS = 12.0


@app(STAGE, GenerateDemosConfig)
def main(config: GenerateDemosConfig) -> None:
    from pipelines.tracking import open_run
    from pipelines.work import discard, git_commit, publish, work_folder

    # Blocks that other code has made are not taken up: they might not replay.
    work = work_folder(config, STAGE, {"commit": git_commit() or ""})
    with a_full_disk_explained(work):
        published = Path(config.paths.artefact)
        if mend(config, published, work):
            discard(work)
            return
        with open_run(config, STAGE, f"demonstrations {config.action_space.name}", work) as run:
            folder = generate(config, work, run)
            for path in sorted(folder.iterdir()):
                if not path.name.startswith("shard"):
                    run.log_artifact(path)
            publish(folder, published)
        discard(work)


def generate(config: GenerateDemosConfig, work: Path, run: Run) -> Path:
    """Make the demonstration set in ``work``; return its folder.

    Raises:
        ConfigError: the planner's parameters are out of range, or it solves next to nothing.
    """
    from pipelines.work import card
    from visualrhp.files import write_json, write_text
    from visualrhp.learning.demonstrations import DemonstrationSet, DemonstrationWriter

    folder = work / "set"
    _remove_unfinished_files(folder)
    _remove_unfinished_files(work / "blocks")
    count = config.demonstrations.count
    # Shards of an earlier start are written over, one by one, by the same bytes.
    writer = DemonstrationWriter(folder, config.action_space.name, count, config.demonstrations.shard_size)
    statistics = _Statistics()
    for arrays in _blocks_in_order(config, work / "blocks", writer, run):
        statistics.add(arrays, writer.num_missing)
        writer.add(arrays)
        if writer.num_attempts >= _NUM_TRIALS and count - writer.num_missing < 0.1 * writer.num_attempts:
            raise _hopeless(config, count - writer.num_missing, writer.num_attempts)
    writer.finish(**card(config, STAGE))
    metrics = statistics.metrics()
    run.log_metrics(metrics)
    run.log_metrics(statistics.timings())
    write_json(folder / "metrics.json", metrics)
    write_text(folder / "lengths.csv", statistics.length_table())
    demonstrations = DemonstrationSet.open(folder, config.action_space.name)
    _write_pictures(folder, demonstrations, statistics.lengths(), config.video)
    return folder


def mend(config: GenerateDemosConfig, folder: Path, work: Path) -> bool:
    """Whether ``folder`` holds the set that ``config`` describes, after shards that are damaged were made again.

    What other code or another configuration has made is not mended; nor is a set that, made again, is another one.
    """
    from pipelines.work import card
    from visualrhp.errors import DataError
    from visualrhp.files import atomic_path
    from visualrhp.learning.demonstrations import (
        between,
        concatenate,
        damaged_shards,
        file_hash,
        read_card,
        write_arrays,
    )

    try:
        found = read_card(folder)
    except DataError:
        return False
    about = json.loads(json.dumps(card(config, STAGE)))  # as it is read
    if any(found.get(key) != value for key, value in about.items()) or not about["commit"]:
        return False
    damages = damaged_shards(folder, found)
    if not damages and about["commit"].endswith("-dirty"):
        return False  # the code may have changed since
    for number, damage in damages.items():
        _log.warning("%s", damage)
        shard = found["shards"][number]
        first, stop = shard["first_index"], shard["first_index"] + shard["num_attempts"]
        blocks = range(first // _BLOCK_SIZE, -(-stop // _BLOCK_SIZE))
        arrays = concatenate(list(_blocks(config, work / "blocks", blocks, None)))
        del arrays["search_time_s"]
        again = work / shard["file"]
        write_arrays(again, between(arrays, first - blocks.start * _BLOCK_SIZE, stop - blocks.start * _BLOCK_SIZE))
        if file_hash(again) != shard["sha256"]:
            _log.warning("%s, made again, is another one: the whole set is made anew.", shard["file"])
            return False
        with atomic_path(folder / shard["file"]) as path:
            path.write_bytes(again.read_bytes())
    if damages:
        _log.info("%d shards of %s were made again, to the bit.", len(damages), folder)
    else:
        _log.info("%s holds these %d demonstrations already.", folder, found["num_demonstrations"])
    return True


def _remove_unfinished_files(folder: Path) -> None:
    """Remove what a killed process was writing (see ``visualrhp.files.atomic_path``)."""
    for path in folder.glob(".*.tmp.*"):
        path.unlink()


@contextmanager
def a_full_disk_explained(work: Path) -> Iterator[None]:
    """Turn the error of a disk that is full into a sentence.

    Raises:
        DataError: a file could not be written for want of space.
    """
    from visualrhp.errors import DataError

    try:
        yield
    except (OSError, ValueError) as error:
        cause: BaseException | None = error  # zipfile closes the file while the error is on its way, and fails again
        while cause is not None and getattr(cause, "errno", None) not in _NO_SPACE:
            cause = cause.__cause__ or cause.__context__
        if not isinstance(cause, OSError):
            raise
        finished = len(list((work / "blocks").glob("block-*")))
        raise DataError(
            f"There is no space left to write demonstrations ({cause.strerror}): free some on the disk of {work} and "
            f"of paths.artefact, and start the same command again. It goes on from here: {finished} finished blocks "
            f"of {_BLOCK_SIZE} attempts and all finished shards are kept."
        ) from error


def _blocks_in_order(config: GenerateDemosConfig, folder: Path, writer: Any, run: Run) -> Iterator[Arrays]:
    """Blocks of attempts by index, until ``writer`` is complete."""
    first = 0
    while not writer.is_complete:
        last = first + -(-writer.num_missing // _BLOCK_SIZE)  # enough, if none of them fails
        for arrays in _blocks(config, folder, range(first, last), run):
            yield arrays
            if writer.is_complete:
                return
        first = last


def _blocks(config: GenerateDemosConfig, folder: Path, numbers: range, run: Run | None) -> Iterator[Arrays]:
    """The blocks with these ``numbers``, in order: those on the disk are read, the others generated first."""
    from visualrhp.errors import DataError
    from visualrhp.learning.demonstrations import read_arrays

    _generate_missing(config, folder, numbers, run)
    for number in numbers:
        try:
            arrays = read_arrays(_block_path(folder, number))
        except DataError as damage:  # since it was written
            _log.warning("%s", damage)
            _block_path(folder, number).unlink(missing_ok=True)
            _generate_missing(config, folder, range(number, number + 1), run)
            arrays = read_arrays(_block_path(folder, number))
        yield arrays


def _generate_missing(config: GenerateDemosConfig, folder: Path, numbers: range, run: Run | None) -> None:
    """Generate the blocks with these ``numbers`` that are not on the disk yet."""
    import functools
    import time

    from tqdm import tqdm

    from pipelines.execution import run_tasks
    from visualrhp.learning.demonstrations import generate_block, write_arrays

    missing = [number for number in numbers if not _block_path(folder, number).is_file()]
    if not missing:
        return
    task = functools.partial(generate_block, **_ingredients(config))
    indices = [range(number * _BLOCK_SIZE, (number + 1) * _BLOCK_SIZE) for number in missing]
    finished = (len(numbers) - len(missing)) * _BLOCK_SIZE
    label = f"Demonstrations, {config.action_space.name}"
    begun, step = time.perf_counter(), max(1, len(missing) // 50)
    with tqdm(total=len(numbers) * _BLOCK_SIZE, initial=finished, desc=label, unit="task", smoothing=0.0) as progress:
        for done, arrays in enumerate(run_tasks(task, indices, config.executor), start=1):
            # The parent alone writes; a block is there wholly or not at all.
            write_arrays(_block_path(folder, int(arrays["index"][0]) // _BLOCK_SIZE), arrays)
            progress.update(_BLOCK_SIZE)
            if run is not None and (done % step == 0 or done == len(missing)):
                rate = done * _BLOCK_SIZE / (time.perf_counter() - begun)
                attempted = numbers.start * _BLOCK_SIZE + finished + done * _BLOCK_SIZE
                run.log_metrics(
                    {
                        "progress/attempts": attempted,
                        "progress/attempts_per_s": rate,
                        "progress/mean_actions": float(arrays["length"][arrays["solved"]].mean())
                        if arrays["solved"].any()
                        else None,
                    },
                    step=attempted,
                )


def _ingredients(config: GenerateDemosConfig) -> dict[str, Any]:
    """What the library needs to attempt a task instance; checks the ranges."""
    from dataclasses import asdict

    from visualrhp.planning import KinodynamicRRT
    from visualrhp.scene import SceneDistribution
    from visualrhp.simulation import Physics

    planner = asdict(config.planner)
    del planner["algorithm"], planner["name"]
    return {
        "distribution": SceneDistribution(**asdict(config.scene)),
        "action_space": config.action_space.name,
        "planner": KinodynamicRRT(**planner),
        "seed": config.seed,
        "physics": Physics(**asdict(config.physics)),
    }


def _block_path(folder: Path, number: int) -> Path:
    return folder / f"block-{number:06d}.npz"


def _hopeless(config: GenerateDemosConfig, solved: int, attempts: int) -> Exception:
    from visualrhp.errors import ConfigError

    return ConfigError(
        f"The planner solved {solved} of {attempts} task instances, too few to make {config.demonstrations.count} "
        f"demonstrations; raise planner.max_simulations ({config.planner.max_simulations}), or change the scene."
    )


class _Statistics:
    """Numbers about the attempts that make up a set."""

    def __init__(self) -> None:
        self._parts: list[Arrays] = []

    def add(self, arrays: Arrays, num_missing: int) -> None:
        """Take in the attempts of a block up to the one that completes the set."""
        import numpy as np

        needed = int(np.searchsorted(np.cumsum(arrays["solved"]), num_missing)) + 1
        names = ("solved", "length", "num_objects", "num_simulated", "num_nodes", "search_time_s")
        self._parts.append({name: arrays[name][:needed] for name in names})

    def _all(self, name: str) -> Any:
        import numpy as np

        return np.concatenate([part[name] for part in self._parts])

    def lengths(self) -> Any:
        """[D] actions of each demonstration."""
        return self._all("length")[self._all("solved")]

    def metrics(self) -> dict[str, float | int]:
        """Numbers that depend on configuration and seed alone."""
        import numpy as np

        solved, simulated, lengths = self._all("solved"), self._all("num_simulated"), self.lengths()
        num_objects = self._all("num_objects")
        return {
            "demonstrations": int(solved.sum()),
            "attempts": len(solved),
            "failures": int((~solved).sum()),
            "solved_rate": float(solved.mean()),
            "transitions": int(lengths.sum()),
            "actions_mean": float(lengths.mean()),
            "actions_median": float(np.median(lengths)),
            "actions_max": int(lengths.max()),
            "action_efficiency": float((num_objects[solved] / np.maximum(lengths, 1)).mean()),
            "simulated_mean": float(simulated.mean()),
            "simulated_median": float(np.median(simulated)),
            "simulated_p95": float(np.percentile(simulated, 95)),
        }

    def timings(self) -> dict[str, float]:
        """Wall-clock times of a search [s]."""
        import numpy as np

        times = self._all("search_time_s")
        return {
            "search_time_mean_s": float(times.mean()),
            "search_time_median_s": float(np.median(times)),
            "search_time_p95_s": float(np.percentile(times, 95)),
            "search_time_total_s": float(times.sum()),
        }

    def length_table(self) -> str:
        """CSV: how many demonstrations have how many actions, by number of objects."""
        from collections import Counter

        solved = self._all("solved")
        counts = Counter(zip(self._all("num_objects")[solved].tolist(), self.lengths().tolist(), strict=True))
        rows = [f"{m},{length},{number}" for (m, length), number in sorted(counts.items())]
        return "\n".join(["num_objects,actions,demonstrations", *rows]) + "\n"


# ------------------------------------------------------------------------------------------------------------ pictures
def _write_pictures(folder: Path, demonstrations: DemonstrationSet, lengths: Any, video: VideoConfig) -> None:
    import cv2

    from visualrhp.files import atomic_path
    from visualrhp.rendering.video import write_video

    with atomic_path(folder / "contact_sheet.png") as path:
        _, encoded = cv2.imencode(".png", cv2.cvtColor(_contact_sheet(demonstrations), cv2.COLOR_RGB2BGR))
        path.write_bytes(encoded.tobytes())
    if video.num_scenes:
        with _full_disk_noticed(folder):
            write_video(folder / "demonstrations.webm", _video_frames(demonstrations, video), _VIDEO_FPS)
    with atomic_path(folder / "lengths.png") as path:
        _length_histogram(lengths, demonstrations.action_space).savefig(path, dpi=120)


@contextmanager
def _full_disk_noticed(folder: Path) -> Iterator[None]:
    """OpenCV goes on, or fails some other way, where the disk is full.

    Raises:
        OSError: it is.
    """
    import shutil

    try:
        yield
    finally:
        if shutil.disk_usage(folder).free < _LITTLE_SPACE:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _contact_sheet(demonstrations: DemonstrationSet) -> Frame:
    """A demonstration a row: its first state, states in between at equal steps, its last."""
    import numpy as np

    from visualrhp.rendering.frames import render_frame

    rows = []
    for task, episode in itertools.islice(demonstrations, _SHEET_ROWS):
        last = len(episode)
        picked = sorted({round(last * column / (_SHEET_COLUMNS - 1)) for column in range(_SHEET_COLUMNS)})
        pictures = [
            render_frame(task.scene, episode.states[step], size_px=_SHEET_SIZE_PX, trail=episode.states[:step])
            for step in picked
        ]
        blank = np.full_like(pictures[0], pictures[0][0, 0])
        rows.append(np.hstack([*pictures, *[blank] * (_SHEET_COLUMNS - len(pictures))]))
    return np.vstack(rows)


def _video_frames(demonstrations: DemonstrationSet, video: VideoConfig) -> Iterator[Frame]:
    from visualrhp.rendering.frames import episode_frames

    for task, episode in itertools.islice(demonstrations, video.num_scenes):
        yield from episode_frames(
            task.scene,
            episode.states,
            title=f"K.RRT, {demonstrations.action_space}",
            outcome="success",
            size_px=video.size_px,
            frames_per_action=4,
            hold=8,
        )


def _length_histogram(lengths: Sequence[int], action_space: str) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 3.0), layout="constrained")
    axes = figure.add_subplot()
    axes.hist(lengths, bins=range(max(lengths) + 2), align="left", color="#0072b2", rwidth=0.9)
    axes.set_xlabel("Actions of a demonstration")
    axes.set_ylabel("Demonstrations")
    mean = sum(lengths) / len(lengths)
    axes.set_title(f"{len(lengths)} demonstrations, {action_space}: {mean:.1f} actions on average", fontsize="medium")
    axes.spines[["top", "right"]].set_visible(False)
    return figure


if __name__ == "__main__":
    main()
