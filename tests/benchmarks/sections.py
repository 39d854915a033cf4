"""The sections, each in a separate process, so that its peak memory is measured."""

from __future__ import annotations

import importlib
import multiprocessing
import resource
import sys

from tests.benchmarks.timing import Effort

SECTIONS = (
    "simulation",
    "environment",
    "batched",
    "inference",
    "planning",
    "rrt",
    "rrt_ompl",
    "box2d",
    "kinematics",
    "training",
    "cell",
    "perception",
    "command_line",
    "peers",
)
"""Modules of this package with a function ``run(effort)``."""


def run_section(name: str, effort: Effort) -> None:
    """Run one section in this process."""
    section = importlib.import_module(f"tests.benchmarks.{name}")
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    imported = _peak_memory()
    section.run(effort)
    print(f"peak memory of {name}: {_peak_memory():.0f} MiB; with the imports alone {imported:.0f} MiB", flush=True)


def run_apart(name: str, effort: Effort) -> bool:
    """Run one section in a new process; return whether it succeeded."""
    process = multiprocessing.get_context("spawn").Process(target=run_section, args=(name, effort))
    process.start()
    process.join()
    return process.exitcode == 0


def _peak_memory() -> float:
    """[MiB], of this process."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
