"""What a stage needs of the machine, and failures of it in one sentence: disks, permissions, devices."""

from __future__ import annotations

import errno
import os
import platform
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from visualrhp.errors import ConfigError, StorageError, VisualRHPError

_NO_SPACE: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_ADVICE: Final = {
    errno.EACCES: "make it accessible for this user, or choose another folder",
    errno.EPERM: "make it accessible for this user, or choose another folder",
    errno.EROFS: "choose a folder that is writable, such as paths.outputs=<folder>",
    errno.ENOTDIR: "move the file away, or choose another folder",
    errno.EEXIST: "move it away, or choose another folder",
    errno.EISDIR: "move the folder away, or name a file",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOENT: "check the path",
    errno.ELOOP: "check the symbolic links",
    errno.EIO: "check the disk",
    errno.EMFILE: "allow more open files (ulimit -n), or use fewer workers",
    errno.ENFILE: "close other programs, or use fewer workers",
    errno.ENOMEM: "free memory, or use fewer workers",
}
# Libraries that write files without Python report the system's error as text.
_ERROR_NUMBER = re.compile(r"\bos error (\d+)\b|\[errno (\d+)\]|\berrno[ =]+(\d+)", re.IGNORECASE)
_FULL_DATABASE = "database or disk is full"


@contextmanager
def explain_storage(work: Path) -> Iterator[None]:
    """Report failures of the disk in the block in one sentence.

    Args:
        work: folder of unfinished work.

    Raises:
        StorageError: a file could not be written or read.
    """
    try:
        yield
    except Exception as error:
        explained = storage_error(error, work)
        if explained is None:
            raise
        raise explained from error


def storage_error(error: BaseException, work: Path | None = None) -> StorageError | None:
    """The sentence for an error that comes from a disk or a file system; None for other errors."""
    if isinstance(error, StorageError) or (found := _system_error(error)) is None:
        return None
    number, text, path = found
    if number in _NO_SPACE:
        place = f"the disks of {work} and of paths.artefact" if work is not None else "the disk"
        return StorageError(
            f"There is no space left on a disk ({text}): free space on {place}, and rerun the command to resume; "
            "finished work is kept."
        )
    place = f"{path}: " if path else ""
    return StorageError(f"{place}{text}; {_ADVICE.get(number, 'check the file system')}, and rerun the command.")


def check_device(device: str) -> None:
    """Check that networks can be trained on ``device``, before any work.

    Raises:
        ConfigError: the device is not there.
    """
    if device == "cpu":
        return
    import torch

    kind, _, index = device.partition(":")
    if kind == "mps":
        if not torch.backends.mps.is_available():
            raise ConfigError("device=mps needs a Mac with Metal, which PyTorch does not find; set device=cpu.")
        return
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if count == 0:
        reason = "this PyTorch was built without it" if torch.version.cuda is None else "PyTorch finds no card"
        raise ConfigError(f"device={device} needs CUDA, but {reason}; set device=cpu, or install PyTorch with CUDA.")
    if index and int(index) >= count:
        raise ConfigError(f"device={device} does not exist: PyTorch finds {count} cards, cuda:0 to cuda:{count - 1}.")


def machine() -> str:
    """The processor and its number of cores, for a table with times."""
    model = platform.processor() or platform.machine()
    with suppress(OSError):  # Linux names the architecture only
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model)
    return f"{model}, {os.cpu_count()} cores"


def _system_error(error: BaseException) -> tuple[int, str, str] | None:
    """Number, text and path of the system's error that caused ``error``; None if there is none."""
    if isinstance(error, OSError) and error.errno is not None and error.errno not in _NO_SPACE:
        return error.errno, error.strerror or os.strerror(error.errno), _paths_of(error)
    explained = isinstance(error, VisualRHPError)
    seen: BaseException | None = error
    is_cause = True
    while seen is not None:
        found = _number_of(seen)
        # Any error may follow from a full disk, such as that of closing a file; others have to be the stated cause.
        if found is not None and (found in _NO_SPACE or (is_cause and not explained)):
            return found, os.strerror(found), _paths_of(seen)
        is_cause = is_cause and seen.__cause__ is not None
        seen = seen.__cause__ or seen.__context__
    return None


def _number_of(error: BaseException) -> int | None:
    if isinstance(error, OSError):
        return error.errno
    if _FULL_DATABASE in str(error):
        return errno.ENOSPC
    match = _ERROR_NUMBER.search(str(error))
    number = int(next(group for group in match.groups() if group)) if match else None
    return number if number in (*_NO_SPACE, *_ADVICE) else None


def _paths_of(error: BaseException) -> str:
    names = [getattr(error, name, None) for name in ("filename", "filename2")]
    return " -> ".join(str(name) for name in names if name)
