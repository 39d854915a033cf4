"""SIGKILL at random moments: the same results, and finished work is kept (many: ``python -m tests.torture kills``)."""

from __future__ import annotations

import itertools
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.torture.kills import REPOSITORY, STAGES, contents, make_inputs, torture


def generation(outputs: Path, count: int) -> subprocess.Popen[bytes]:
    """A started generation of demonstrations, on two workers."""
    settings = ("scale=smoke", "tracking=none", "executor.num_workers=2", "scene.num_objects=[1,7]")
    overrides = (f"demonstrations.count={count}", "demonstrations.shard_size=40", "video.num_scenes=0")
    arguments = [sys.executable, "-m", "pipelines.generate_demos", *settings, *overrides, f"paths.outputs={outputs}"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.Popen(arguments, cwd=REPOSITORY, env=environment, stderr=subprocess.DEVNULL)


def finished_blocks(outputs: Path) -> dict[str, tuple[int, int]]:
    """Name of every finished block -> its inode and time: another file is another attempt at the same work."""
    return {
        path.name: (path.stat().st_ino, path.stat().st_mtime_ns)
        for path in outputs.glob("work/generate_demos/*/blocks/block-*")
    }


def wait_for_blocks(outputs: Path, number: int, process: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + 60.0
    while len(finished_blocks(outputs)) < number and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.002)


def test_finished_blocks_are_not_made_again(tmp_path: Path) -> None:
    """Killed in the middle, wherever that is: some hundredths of a second after some number of blocks is there."""
    interrupted, whole = tmp_path / "interrupted", tmp_path / "whole"
    rng = random.Random(2)
    before: dict[str, tuple[int, int]] = {}
    for first in (1, 5, 9):
        process = generation(interrupted, 100)
        wait_for_blocks(interrupted, rng.randrange(first, first + 4), process)
        time.sleep(rng.uniform(0.0, 0.1))
        process.kill()  # the process that writes; its workers are to notice by themselves
        process.wait()
        after = finished_blocks(interrupted)
        assert after and before.items() <= after.items()
        before = after
    for outputs in (interrupted, whole):
        assert generation(outputs, 100).wait() == 0
    first, second = (contents(outputs / "generate_demos" / "continuous") for outputs in (interrupted, whole))
    assert first == second


def test_workers_end_with_the_process_that_was_killed(tmp_path: Path) -> None:
    process = generation(tmp_path, 5000)
    try:
        wait_for_blocks(tmp_path, 1, process)
        assert finished_blocks(tmp_path)
        workers = psutil.Process(process.pid).children(recursive=True)
    finally:
        process.kill()
        process.wait()
    assert len(workers) >= 2
    _, alive = psutil.wait_procs(workers, timeout=20.0)
    for worker in alive:
        worker.kill()
    assert not alive


@pytest.mark.parametrize(("number", "kills"), [(1, 1), (5, 2)])
def test_killed_stages_give_the_same_results_and_runs(tmp_path: Path, number: int, kills: int) -> None:
    """A training and an evaluation, tracked by MLflow."""
    inputs = make_inputs(tmp_path / "inputs", STAGES[:1]) if number == 1 else tmp_path
    tally = torture(STAGES[number], inputs, tmp_path, kills, random.Random(number))
    assert tally.kills == kills
    assert tally.differences == []


NOT_KILLED = {"calibrate_camera"}
"""It takes a second."""


def test_the_stages_of_the_harness_are_all_pipelines() -> None:
    pipelines = {path.stem for path in (REPOSITORY / "pipelines").glob("*.py") if "@app(" in path.read_text()}
    assert {stage.name for stage in STAGES} == pipelines - NOT_KILLED
    assert len(set(itertools.chain.from_iterable([stage.artefact] for stage in STAGES))) == len(STAGES)
