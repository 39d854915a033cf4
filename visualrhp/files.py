"""Writing files so that a reader, or a run that was killed, never meets half of one."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from visualrhp.errors import DataError


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; what was written there replaces ``path`` when the block succeeds.

    The temporary file keeps the suffix of ``path``, since writers such as ``numpy.savez`` and OpenCV choose their
    format by it, and its name starts with a dot. Missing folders are created. The content is flushed to the disk
    before the rename. When the block raises (``KeyboardInterrupt`` included), the temporary file is removed and
    whatever was at ``path`` stays as it was.

    Raises:
        DataError: the block ended without having written the file.
    """
    destination = Path(path)
    destination.parent.mkdir(parents=True, exist_ok=True)
    # A name is all we want from tempfile: several writers reject, or fail to truncate, a file that exists already.
    with tempfile.NamedTemporaryFile(
        prefix=f".{destination.stem}.", suffix=f".tmp{destination.suffix}", dir=destination.parent, delete=True
    ) as reserved:
        temporary = Path(reserved.name)
    try:
        yield temporary
        if not temporary.is_file():
            raise DataError(f"nothing was written for {destination}; a writer has to fill the path that it was given")
        _flush(temporary)
        os.replace(temporary, destination)
        _flush(destination.parent)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write ``text`` (UTF-8) to ``path``, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | os.PathLike[str], content: Any) -> None:
    """Write ``content`` to ``path`` as indented JSON with sorted keys, atomically: the same bytes for the same content.

    Raises:
        ValueError: ``content`` holds NaN or an infinity, which JSON has no word for.
    """
    write_text(path, json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n")


def read_json(path: str | os.PathLike[str]) -> Any:
    """Read a JSON file.

    Raises:
        DataError: the file is missing or is not JSON.
    """
    source = Path(path)
    try:
        return json.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{source} cannot be read ({error.strerror}); it should be a JSON file") from error
    except ValueError as error:
        raise DataError(f"{source} is damaged: it should be JSON, but {error}") from error


def _flush(path: Path) -> None:
    """Have the operating system write a file, or the entries of a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
