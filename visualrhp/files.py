"""Atomic writing of files: neither a concurrent reader nor a killed run leaves or finds a partial file."""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from visualrhp.errors import DataError

_LITTLE_SPACE = 1 << 16
"""A disk with fewer free bytes counts as full."""


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the folder of ``path``; the file there replaces ``path`` when the block succeeds.

    The temporary file keeps the suffix of ``path``, since writers such as ``numpy.savez`` and OpenCV choose their
    format by it, and its name starts with a dot. Missing folders are created. The content is flushed to the disk
    before the rename. When the block raises (``KeyboardInterrupt`` included), the temporary file is removed and
    the file at ``path`` is unchanged.

    Raises:
        DataError: the block ended without having written the file.
    """
    destination = Path(path)
    destination.parent.mkdir(parents=True, exist_ok=True)
    # Only the name is used: several writers reject, or do not truncate, an existing file.
    with tempfile.NamedTemporaryFile(
        prefix=f".{destination.stem}.", suffix=f".tmp{destination.suffix}", dir=destination.parent, delete=True
    ) as reserved:
        temporary = Path(reserved.name)
    try:
        yield temporary
        if not temporary.is_file():
            raise DataError(f"nothing was written for {destination}; a writer has to use the path that it was given")
        _flush(temporary)
        os.replace(temporary, destination)
        _flush(destination.parent)
    finally:
        temporary.unlink(missing_ok=True)


def remove_unfinished_files(folder: Path) -> None:
    """Remove the temporary files of :func:`atomic_path` that a killed process left in ``folder``."""
    for pattern in (".*.tmp.*", ".*.tmp"):
        for path in folder.glob(pattern):
            if path.is_file():
                path.unlink()


@contextmanager
def detect_full_disk(folder: Path) -> Iterator[None]:
    """Detect a full disk after a writer that does not report it (OpenCV ignores it, or fails in another way).

    Raises:
        OSError: the disk of ``folder`` is full.
    """
    try:
        yield
    finally:
        if shutil.disk_usage(folder).free < _LITTLE_SPACE:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write ``text`` (UTF-8) to ``path``, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | os.PathLike[str], content: Any) -> None:
    """Write ``content`` to ``path`` as indented JSON with sorted keys, atomically: the same bytes for the same content.

    Raises:
        ValueError: ``content`` holds NaN or an infinity, which JSON cannot represent.
    """
    write_text(path, json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n")


def _flush(path: Path) -> None:
    """Have the operating system write a file, or the entries of a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
