"""Folders of unfinished work.

A stage works in a folder named by a hash of everything that its result depends on, the code included, and moves the
finished artefact into place in one step. A killed stage therefore resumes when it is rerun with the same configuration,
other configurations do not use its unfinished work, and DVC, which deletes the outputs of a stage before it runs it,
does not delete checkpoints. A lock keeps a second process out of the folder.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.artefacts import anchored_outputs, code_hash, content_hash, result_config_without_locations
from pipelines.workflow.publishing import check_destination, check_writable, recover
from pipelines.workflow.surroundings import explain_storage
from visualrhp.errors import StorageError

if TYPE_CHECKING:
    from filelock import BaseFileLock

    from pipelines.config import PipelineConfig

RUNS_SUFFIX = ".runs.json"
"""Suffix of the file beside a work folder with the ids of its runs in the tracker."""
LOCK_SUFFIX = ".lock"
_DISCARDED_SUFFIX = ".discarded"
_PATIENCE_S = 1.0  # longer than the moment in which another process looks whether a folder is locked


@contextmanager
def open_work(
    config: PipelineConfig,
    stage: str,
    inputs: Mapping[str, str] | None = None,
    check: Callable[[], None] | None = None,
) -> Iterator[Path]:
    """Work on the artefact of ``stage`` in the block; yields the folder of its unfinished work.

    The folder is deleted when the block succeeds. Whatever earlier processes left half-written is deleted first.

    Args:
        config: the stage's configuration.
        stage: its name.
        inputs: hashes of the artefacts that the stage reads, so that work on other data is not resumed.
        check: checks that the artefact can be published; by default, that ``paths.artefact`` can be replaced.

    Raises:
        StorageError: the artefact would replace something else; another process works in the folder; a folder is not
            writable; the disk is full.
    """
    if check is None:
        check_destination(config.paths.artefact, stage, reserved=reserved_paths(config))
    else:
        check()
    outputs = anchored_outputs(config)
    check_writable(outputs)
    folder = work_folder(config, stage, inputs)
    if folder.is_symlink():
        raise StorageError(f"{folder} is a symbolic link, but should be a work folder; delete the link.")
    with explain_storage(folder), locked(folder):
        recover(config.paths.artefact)
        _delete(discarded_folder(folder))
        folder.mkdir(exist_ok=True)
        remove_unfinished_files_in(folder)
        yield folder
        discard(folder)


def reserved_paths(config: PipelineConfig) -> tuple[Path, ...]:
    """Folders and files in the outputs that belong to the pipelines themselves."""
    outputs = anchored_outputs(config)
    return tuple(outputs / name for name in ("work", "hydra", "cells", "mlruns", "mlflow.db"))


def work_folder(config: PipelineConfig, stage: str, inputs: Mapping[str, str] | None = None) -> Path:
    """Path of the folder for the unfinished work of ``stage`` with this configuration and these inputs."""
    # The content of inputs counts, not their location, nor that of the artefact.
    content = {"config": result_config_without_locations(config), "inputs": dict(inputs or {}), "code": code_hash()}
    key = content_hash(content)
    return anchored_outputs(config) / "work" / stage / key[:16]


def discard(folder: Path) -> None:
    """Delete a work folder, in such an order that it is whole or gone if this process is killed."""
    discarded = discarded_folder(folder)
    folder.rename(discarded)
    _delete(discarded)
    folder.with_name(folder.name + RUNS_SUFFIX).unlink(missing_ok=True)


def lock_of(folder: Path) -> BaseFileLock:
    """The lock of a work folder."""
    from filelock import FileLock

    return FileLock(folder.with_name(folder.name + LOCK_SUFFIX), timeout=0.0)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes out of a work folder during the block; the system unlocks it if this process is killed.

    Raises:
        StorageError: another process has locked it.
    """
    from filelock import Timeout

    folder.parent.mkdir(parents=True, exist_ok=True)
    lock = lock_of(folder)
    try:
        lock.acquire(timeout=_PATIENCE_S)
    except Timeout as error:
        raise _busy(folder) from error
    try:
        yield
    finally:
        # A process that opened the file before it is deleted finds that it is not there any more, and tries again.
        if not folder.exists():
            Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


def is_locked(folder: Path) -> bool:
    """Whether a process works in a work folder."""
    from filelock import Timeout

    lock = lock_of(folder)
    if not Path(lock.lock_file).exists():
        return False
    try:
        with lock:
            return False
    except Timeout:
        return True


def _busy(folder: Path) -> StorageError:
    return StorageError(
        f"Another process is running pipelines.{folder.parent.name} with this configuration, in {folder}. Wait until "
        "it has finished, or stop it and run the command again, which continues its work."
    )


def remove_unfinished_files_in(folder: Path) -> None:
    """Remove the files that a killed process left half-written in a folder and its subfolders."""
    from visualrhp.files import remove_unfinished_files

    for parent, _, _ in os.walk(folder):
        remove_unfinished_files(Path(parent))


def empty_folder(folder: Path) -> Path:
    """Make an empty folder in a work folder, in place of one that an interrupted run left; return it."""
    _delete(folder)
    folder.mkdir(parents=True)
    return folder


def discarded_folder(folder: Path) -> Path:
    """Where a work folder is while it is deleted."""
    return folder.with_name(folder.name + _DISCARDED_SUFFIX)


def _delete(folder: Path) -> None:
    if folder.is_dir():
        shutil.rmtree(folder)
