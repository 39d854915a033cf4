"""Work in progress and finished artefacts: where they are, how they are named, how the first becomes the second.

A stage works in a folder named by everything that its result depends on, and moves the finished artefact into place in
one step. So a killed stage goes on where it was when it is started again with the same configuration, another
configuration never meets its half-done work, and DVC, which deletes the outputs of a stage before it runs it, deletes
no checkpoint.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from pipelines.config import PipelineConfig

# What a result never depends on. The scale is only a source of values that are in the other keys, too.
_NOT_PART_OF_THE_RESULT = ("scale", "paths", "executor", "tracking")


def anchored_outputs(config: PipelineConfig) -> Path:
    """Absolute path of the outputs of the repository itself, also when DVC runs an experiment in a copy of it.

    Work in progress and the tracking database live there: a copy is deleted when its experiment ends.
    """
    return (Path(os.environ.get("DVC_ROOT") or Path.cwd()) / config.paths.outputs).resolve()


def result_config(config: PipelineConfig) -> dict[str, Any]:
    """The part of the configuration that the result depends on, as nested dicts."""
    return {key: value for key, value in asdict(config).items() if key not in _NOT_PART_OF_THE_RESULT}


def content_hash(content: Any) -> str:
    """SHA-256 of ``content``, which consists of dicts, lists and scalars."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()


def work_folder(config: PipelineConfig, stage: str, inputs: Mapping[str, str] | None = None) -> Path:
    """The folder, made if need be, for the unfinished work of ``stage`` with this configuration.

    Args:
        config: the stage's configuration.
        stage: its name.
        inputs: hashes of the artefacts that the stage reads (from their cards), so that work on other data is not
            taken up.
    """
    # Inputs count by their content; where they are (and where the artefact goes) does not matter.
    key = content_hash({"config": _without_locations(config), "inputs": dict(inputs or {})})
    folder = anchored_outputs(config) / "work" / stage / key[:16]
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def publish(folder: Path, destination: str | os.PathLike[str]) -> None:
    """Move the finished ``folder`` to ``destination`` in one step; what was there before is replaced."""
    target = Path(destination).absolute()
    target.parent.mkdir(parents=True, exist_ok=True)
    # Beside the target, so that the last step is a rename within one file system whatever the first one was.
    with tempfile.TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as aside:
        arrived = Path(aside) / "new"
        shutil.move(folder, arrived)
        if target.exists():
            target.rename(Path(aside) / "old")
        arrived.rename(target)


def discard(folder: Path) -> None:
    """Delete a work folder whose artefact was published."""
    shutil.rmtree(folder, ignore_errors=True)


def card(config: PipelineConfig, stage: str, **content: Any) -> dict[str, Any]:
    """What is known about an artefact, for the JSON card beside it: configuration, commit, versions and ``content``.

    Holds no time, host or path outside of the repository, so that the same configuration gives the same bytes.
    """
    return {
        "stage": stage,
        "seed": config.seed,
        "scale": config.scale["name"],
        "config": _without_locations(config),
        "commit": git_commit(),
        "versions": {name: _version(name) for name in ("visualrhp", "torch", "numpy", "pymunk")},
        **content,
    }


@lru_cache(maxsize=1)
def git_commit() -> str | None:
    """Commit of the checkout, with ``-dirty`` if files that git knows were changed; None outside of a repository."""
    try:
        commit = _git("rev-parse", "HEAD")
        return f"{commit}-dirty" if _git("status", "--porcelain", "--untracked-files=no") else commit
    except (OSError, subprocess.CalledProcessError):
        return None


def dvc_stage() -> str | None:
    """Name of the DVC stage that runs this process, if one does."""
    return os.environ.get("DVC_STAGE")


def _without_locations(config: PipelineConfig) -> dict[str, Any]:
    content = result_config(config)
    outputs = config.paths.outputs
    return {
        key: value
        for key, value in content.items()
        if not (isinstance(value, str) and (value == outputs or value.startswith(f"{outputs}/")))
    }


def _git(*arguments: str) -> str:
    command = ["git", *arguments]
    folder = Path(__file__).parent
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, timeout=20).stdout.strip()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
