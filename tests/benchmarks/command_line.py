"""Start-up time of the command line, relative to `import hydra`."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

from tests.benchmarks.timing import Effort, compare, show_title, timed

REPOSITORY = Path(__file__).resolve().parents[2]
_PIPELINES = ("generate_demos", "train_il", "train_rl", "evaluate", "report")


def _answer(*arguments: str) -> None:
    subprocess.run([sys.executable, *arguments], cwd=REPOSITORY, check=True, capture_output=True)


def run(effort: Effort) -> None:
    show_title("Command line")
    repetitions = max(1, effort.repetitions // 3)
    for pipeline in _PIPELINES if effort.repetitions > 1 else _PIPELINES[:1]:
        for question in (("--help",), ("--cfg", "job")):
            arguments = ("-m", f"pipelines.{pipeline}", *question)
            compare(
                f"python {' '.join(arguments)}",
                timed(lambda a=arguments: _answer(*a), clock=time.perf_counter),
                timed(lambda: _answer("-c", "import hydra"), clock=time.perf_counter),
                "python -c 'import hydra'",
                repetitions,
            )
