"""Failures of disks and devices, in one sentence."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
import torch

from pipelines.workflow.surroundings import check_device, explain_storage, storage_error
from visualrhp.errors import ConfigError, DataError, StorageError


class LibraryError(Exception):
    """An error of a library that writes files without Python."""


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "free space on"),
        (errno.EDQUOT, "free space on"),
        (errno.EROFS, "place/file: Read-only file system; choose a folder that is writable"),
        (errno.EACCES, "place/file: Permission denied; make it accessible"),
        (errno.ENOTDIR, "place/file: Not a directory; move the file away"),
        (errno.ENAMETOOLONG, "place/file: File name too long; choose a shorter name"),
        (errno.EBUSY, "place/file: Device or resource busy; check the file system"),
    ],
)
def test_errors_of_the_system_name_the_file_and_what_helps(number: int, words: str) -> None:
    explained = storage_error(OSError(number, os.strerror(number), "place/file"), Path("work"))
    assert isinstance(explained, StorageError)
    assert words in str(explained)


@pytest.mark.parametrize("text", ["Io error: No space left on device (os error 28)", "database or disk is full"])
def test_a_full_disk_is_found_in_the_words_of_libraries(text: str) -> None:
    assert "no space left" in str(storage_error(LibraryError(text)))


def chained(error: Exception, *, is_cause: bool) -> Exception:
    """A KeyError that follows from ``error``, or that happened while it was handled."""
    try:
        try:
            raise error
        except Exception as first:
            if is_cause:
                raise KeyError("a") from first
            raise KeyError("a")  # noqa: B904
    except KeyError as second:
        return second


def test_causes_are_found_and_mere_contexts_are_not() -> None:
    denied, full = PermissionError(errno.EACCES, "denied", "file"), OSError(errno.ENOSPC, "full")
    assert "file: " in str(storage_error(chained(denied, is_cause=True)))
    assert storage_error(chained(denied, is_cause=False)) is None
    assert "no space left" in str(storage_error(chained(full, is_cause=False)))
    assert storage_error(ValueError("no")) is None


def test_errors_that_explain_themselves_are_kept() -> None:
    error = DataError("a.json cannot be read")
    error.__cause__ = PermissionError(errno.EACCES, "denied", "a.json")
    with pytest.raises(DataError, match=r"a\.json cannot be read"), explain_storage(Path("work")):
        raise error


def test_devices_that_are_not_there_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    check_device("cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match=r"device=cuda needs CUDA, but .* set device=cpu"):
        check_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    check_device("cuda:1")
    with pytest.raises(ConfigError, match="cuda:2 does not exist: PyTorch finds 2 cards"):
        check_device("cuda:2")
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    with pytest.raises(ConfigError, match="device=mps"):
        check_device("mps")
