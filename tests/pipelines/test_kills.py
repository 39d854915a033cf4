"""SIGKILL at random moments: the same bytes, and finished work is kept (50 of them: ``kills.py``)."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from pipelines import generate_demos
from pipelines.config import GenerateDemosConfig
from pipelines.workflow.app import compose
from pipelines.workflow.publishing import MARK
from pipelines.workflow.tracking import open_run

sys.path.insert(0, str(Path(__file__).parent))
import kills

OVERRIDES = ["demonstrations.count=100", "demonstrations.shard_size=40", "video.num_scenes=0"]


def test_killed_at_random_moments_it_makes_the_same_bytes(tmp_path: Path) -> None:
    """Killed in the middle, wherever that is: some hundredths of a second after some number of blocks is there."""
    interrupted, whole = tmp_path / "interrupted", tmp_path / "whole"
    rng = random.Random(2)

    def moment(num_blocks: int) -> Callable[[float], bool]:
        delay = rng.uniform(0.0, 0.1)

        def is_time(seconds: float) -> bool:
            if len(kills.finished_blocks(interrupted)) < num_blocks:
                return False
            time.sleep(delay)
            return True

        return is_time

    moments = [moment(rng.randrange(first, first + 4)) for first in (1, 5, 9)]
    tally = kills.kill_until_done(interrupted, OVERRIDES, moments, most=3)
    assert tally.kills == tally.with_progress == 3
    found = kills.content(interrupted)
    config = compose("generate_demos", GenerateDemosConfig, kills.command(whole, *OVERRIDES)[3:])
    with open_run(config, "generate_demos", "test") as run:
        folder = generate_demos.generate(config, whole, run)
    found.pop(MARK)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == found


def test_workers_end_with_the_process_that_was_killed(tmp_path: Path) -> None:
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    arguments = kills.command(tmp_path, "demonstrations.count=5000")
    process = subprocess.Popen(arguments, cwd=kills.REPOSITORY, env=environment, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60.0
        while not kills.finished_blocks(tmp_path) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert kills.finished_blocks(tmp_path)
        workers = psutil.Process(process.pid).children(recursive=True)
    finally:
        process.kill()
        process.wait()
    assert len(workers) >= 2
    _, alive = psutil.wait_procs(workers, timeout=20.0)
    for worker in alive:
        worker.kill()
    assert not alive
