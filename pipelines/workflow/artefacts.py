"""Identity of artefacts: the part of a configuration that a result depends on, its hash, and the card."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
from dataclasses import asdict
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipelines.config import PipelineConfig


# Keys that do not affect the result. The scale only provides values of other keys.
_NOT_PART_OF_THE_RESULT = ("scale", "paths", "executor", "tracking")


def anchored_outputs(config: PipelineConfig) -> Path:
    """Absolute path of the outputs of the original repository, also when DVC runs an experiment in a copy of it.

    It holds unfinished work and the tracking database, since the copy is deleted when its experiment ends.
    """
    return (Path(os.environ.get("DVC_ROOT") or Path.cwd()) / config.paths.outputs).resolve()


def result_config(config: PipelineConfig) -> dict[str, Any]:
    """The part of the configuration that affects the result, as nested dicts."""
    return {key: value for key, value in asdict(config).items() if key not in _NOT_PART_OF_THE_RESULT}


def content_hash(content: Any) -> str:
    """SHA-256 of ``content``, which consists of dicts, lists and scalars."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()


@lru_cache(maxsize=1)
def code_hash() -> str:
    """SHA-256 of the source files of ``visualrhp`` and ``pipelines``: work that other code began is not continued."""
    import visualrhp

    found = hashlib.sha256()
    for folder in (Path(__file__).parents[1], Path(visualrhp.__file__).parent):
        for path in sorted(folder.rglob("*.py")):
            content = path.read_bytes()
            found.update(f"{path.relative_to(folder.parent).as_posix()} {len(content)}\n".encode() + content)
    return found.hexdigest()


def card(config: PipelineConfig, stage: str, **content: Any) -> dict[str, Any]:
    """The content of the JSON card of an artefact: configuration, commit, versions and ``content``.

    It has no time, host or path outside the repository, so that the same configuration gives the same bytes.
    """
    return {
        "stage": stage,
        "seed": config.seed,
        "scale": config.scale["name"],
        "config": result_config_without_locations(config),
        "commit": git_commit(),
        "versions": {name: _version(name) for name in ("visualrhp", "torch", "numpy", "pymunk")},
        **content,
    }


@lru_cache(maxsize=1)
def git_commit() -> str | None:
    """Commit of the checkout, with ``-dirty`` if tracked files were changed; None outside a repository."""
    try:
        commit = _git("rev-parse", "HEAD")
        return f"{commit}-dirty" if _git("status", "--porcelain", "--untracked-files=no") else commit
    except (OSError, subprocess.SubprocessError):  # it is not installed, too slow, or refuses the folder
        return None


def dvc_stage() -> str | None:
    """Name of the DVC stage that runs this process; None if there is none."""
    return os.environ.get("DVC_STAGE")


def result_config_without_locations(config: PipelineConfig) -> dict[str, Any]:
    """:func:`result_config` without the values that name files in the outputs."""
    roots = (config.paths.outputs, str(anchored_outputs(config)))

    def is_location(value: Any) -> bool:
        return isinstance(value, str) and any(value == root or value.startswith(f"{root}/") for root in roots)

    def without(content: dict[str, Any]) -> dict[str, Any]:
        return {
            key: without(value) if isinstance(value, dict) else value
            for key, value in content.items()
            if not is_location(value)
        }

    return without(result_config(config))


def _git(*arguments: str) -> str:
    command = ["git", *arguments]
    folder = Path(__file__).parent
    # Variables such as GIT_DIR would name another repository.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    done = subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, text=True, timeout=20)
    return done.stdout.strip()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
