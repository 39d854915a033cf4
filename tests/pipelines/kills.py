"""Generation killed by SIGKILL at random moments and started again, until it is done.

``python tests/pipelines/kills.py --kills 50`` takes some minutes; the tests run a few.
"""

from __future__ import annotations

import argparse
import itertools
import json
import operator
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


@dataclass
class Tally:
    """The result of one set.

    Attributes:
        kills: starts that were killed.
        with_progress: of these, those that found or left some but not all of the work done.
        seconds: of the whole.
    """

    kills: int = 0
    with_progress: int = 0
    seconds: float = 0.0


def command(outputs: Path, *overrides: str) -> list[str]:
    """Generate a small set in ``outputs``, on two workers."""
    settings = ("scale=smoke", "tracking=none", "executor.num_workers=2", "scene.num_objects=[1,7]")
    return [sys.executable, "-m", "pipelines.generate_demos", *settings, f"paths.outputs={outputs}", *overrides]


def run(arguments: list[str], is_time_to_kill: Callable[[float], bool] = lambda seconds: False) -> bool:
    """Whether the command succeeded before ``is_time_to_kill``, which is asked again and again how long it has run.

    Raises:
        RuntimeError: it failed.
    """
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    begun = time.monotonic()
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            arguments, cwd=REPOSITORY, env=environment, stdout=subprocess.DEVNULL, stderr=errors, text=True
        )
        try:
            while process.poll() is None:
                if is_time_to_kill(time.monotonic() - begun):
                    return False
                time.sleep(0.002)
        finally:
            process.kill()  # SIGKILL, to the process that writes; its workers are to notice by themselves
            process.wait()
        if process.returncode:
            errors.seek(0)
            raise RuntimeError(f"exit code {process.returncode}: {errors.read()[-2000:]}")
    return True


def content(outputs: Path) -> dict[str, bytes]:
    """Every file of the finished set."""
    (folder,) = (outputs / "generate_demos").iterdir()
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def finished_blocks(outputs: Path) -> dict[str, tuple[int, int]]:
    """Name of every finished block -> its inode and time: another file is another attempt at the same work."""
    return {
        path.name: (path.stat().st_ino, path.stat().st_mtime_ns)
        for path in outputs.glob("work/generate_demos/*/blocks/block-*")
    }


def kill_until_done(
    outputs: Path, overrides: list[str], moments: Iterable[Callable[[float], bool]], most: int
) -> Tally:
    """Make a set in ``outputs``, killing up to ``most`` starts, each when it is time to (see :func:`run`).

    Raises:
        RuntimeError: a start failed, or made finished work again.
    """
    tally, begun = Tally(), time.perf_counter()
    before: dict[str, tuple[int, int]] = {}
    for is_time_to_kill in itertools.islice(moments, most):
        if run(command(outputs, *overrides), is_time_to_kill):
            break
        tally.kills += 1
        after = finished_blocks(outputs)
        again = [name for name, identity in before.items() if name in after and after[name] != identity]
        if again:
            raise RuntimeError(f"finished blocks were made again: {again}")
        tally.with_progress += bool(after)
        before = after
    else:
        run(command(outputs, *overrides))
    tally.seconds = time.perf_counter() - begun
    return tally


def main() -> None:
    """Sets of seeds 0, 1, ..., each once without and once with interruptions, until there were enough kills."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--count", type=int, default=400, help="demonstrations of a set")
    parser.add_argument("--share", type=float, default=0.4, help="of the time without interruption: latest moment")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    rng = random.Random(options.seed)
    total, seed = 0, 0
    while total < options.kills:
        with tempfile.TemporaryDirectory() as folder:
            overrides = [
                f"demonstrations.count={options.count}",
                "demonstrations.shard_size=100",
                f"action_space={('continuous', 'discrete')[seed % 2]}",
                f"seed={seed}",
            ]
            begun = time.perf_counter()
            run(command(Path(folder) / "whole", *overrides))
            seconds = time.perf_counter() - begun
            expected = content(Path(folder) / "whole")
            interrupted = Path(folder) / "interrupted"
            moments = (partial(operator.lt, rng.uniform(0.0, options.share * seconds)) for _ in itertools.count())
            tally = kill_until_done(interrupted, overrides, moments, options.kills - total)
            found = content(interrupted)
            different = sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
            leftovers = [path.name for path in interrupted.glob("generate_demos/.*")]
            total += tally.kills
            print(
                json.dumps(
                    {"seed": seed, "uninterrupted_s": round(seconds, 1), **vars(tally), "total_kills": total}
                    | {"different_files": different, "leftovers": leftovers}
                ),
                flush=True,
            )
            if different:
                sys.exit(f"seed {seed}: {', '.join(different)} differ")
        seed += 1
    print(f"{total} kills, {seed} sets: byte-identical to those made without interruption.")


if __name__ == "__main__":
    main()
