"""Publication of finished artefacts, which replaces nothing but earlier artefacts of the same stage.

Every published folder has a mark: a file with the name of the stage that made it and a checksum of every file. A folder
without a mark, with the mark of another stage, or with a file that was added or changed since belongs to the user; a
stage refuses to replace it, before it starts to work.
"""

from __future__ import annotations

import glob
import hashlib
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from visualrhp.documents import FileKind, document
from visualrhp.errors import DataError, StorageError
from visualrhp.files import atomic_path, remove_unfinished_files, write_json

MARK: Final = ".visualrhp.json"
"""Name of the mark of an artefact."""

_OF_THE_DESKTOP = (".DS_Store", "Thumbs.db", "desktop.ini")
"""Files that file managers add to folders that they show."""

_KIND: Final = FileKind("a document of an artefact (JSON)", "make the artefact again")
_MOST_NAMED = 3
_MOST_COPIES = 5
_UNFINISHED = shutil.ignore_patterns(".*.visualrhp-new", ".*.visualrhp-old", ".*.tmp", ".*.tmp.*")


def check_destination(
    destination: str | os.PathLike[str], stage: str, identity: str | None = None, reserved: Sequence[Path] = ()
) -> None:
    """Check that ``stage`` can publish an artefact at ``destination``.

    Args:
        destination: folder of the artefact.
        stage: the pipeline.
        identity: what the artefact is, where artefacts of one stage must not replace each other.
        reserved: folders and files of the pipelines themselves, which an artefact must not contain or be in.

    Raises:
        StorageError: something that ``stage`` did not make is there, or the folder cannot be made.
    """
    target = _absolute(destination)
    for own in reserved:
        if target.is_relative_to(own) or own.is_relative_to(target):
            raise StorageError(
                f"paths.artefact={destination} cannot hold an artefact, since {own} belongs to the pipelines. Choose "
                "another folder with paths.artefact."
            )
    if reason := _objection(target, stage, identity):
        raise StorageError(
            f"paths.artefact={destination} {reason}. Nothing was changed. Choose another folder with paths.artefact, "
            "or move this one away."
        )
    check_writable(target.parent)


def check_writable(folder: Path) -> None:
    """Check that files can be written to ``folder``, or that it can be made.

    Raises:
        StorageError: it cannot.
    """
    existing = folder
    while not os.path.lexists(existing):
        existing = existing.parent
    if not existing.is_dir():
        raise StorageError(f"The folder {folder} cannot be made, since {existing} is not a folder.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise StorageError(f"{existing} is not writable, and {folder} is to be written there.")


def publish(folder: Path, destination: str | os.PathLike[str], stage: str, identity: str | None = None) -> None:
    """Move the finished ``folder`` to ``destination``, in place of an earlier artefact of ``stage``.

    The move is a rename. If the process is killed between its two steps, :func:`recover` restores the earlier artefact.

    Raises:
        StorageError: see :func:`check_destination`.
    """
    target = _absolute(destination)
    check_destination(target, stage, identity)
    remove_unfinished_files(folder)
    write_json(folder / MARK, {"stage": stage, "identity": identity, "files": _checksums(folder)})
    target.parent.mkdir(parents=True, exist_ok=True)
    with _publication(target):
        _recover(target)
        arrived, previous = _asides(target)
        # In the same folder as the target, so that the last steps are renames within one file system.
        shutil.move(folder, arrived)
        if target.exists():
            target.rename(previous)
        arrived.rename(target)
        _remove(previous)


def check_files(folder: str | os.PathLike[str], names: Sequence[str], stage: str) -> None:
    """Check that ``stage`` can publish files in a folder that it shares with others.

    Args:
        folder: their folder.
        names: of the files; one of them is a JSON document that names the stage.
        stage: the pipeline.

    Raises:
        StorageError: a file of this name was not made by ``stage``, or the folder cannot be made.
    """
    existing = [Path(folder) / name for name in names if os.path.lexists(Path(folder) / name)]
    if existing and not any(_names_stage(Path(folder) / name, stage) for name in names if name.endswith(".json")):
        raise StorageError(
            f"{existing[0]} was not made by pipelines.{stage}, so it is not replaced. Choose another folder with "
            "paths.artefact, or move the file away."
        )
    check_writable(Path(folder).absolute())


def publish_files(folder: Path, destination: str | os.PathLike[str], names: Sequence[str], stage: str) -> None:
    """Move finished files to a shared folder, the document last, each in place of the earlier one of its name.

    Raises:
        StorageError: see :func:`check_files`.
    """
    check_files(destination, names, stage)
    target = Path(destination)
    target.mkdir(parents=True, exist_ok=True)
    for name in sorted(names, key=lambda name: name.endswith(".json")):
        for unfinished in target.glob(f".{glob.escape(Path(name).stem)}.*.tmp{Path(name).suffix}"):
            unfinished.unlink()  # of a killed process
        with atomic_path(target / name) as temporary:
            shutil.move(folder / name, temporary)


def recover(destination: str | os.PathLike[str]) -> None:
    """Undo a publication that was killed.

    Raises:
        StorageError: what it left cannot be deleted.
    """
    target = _absolute(destination)
    if any(os.path.lexists(path) for path in (*_asides(target), _lock_file(target))):
        with _publication(target):
            _recover(target)


def _recover(target: Path) -> None:
    arrived, previous = _asides(target)
    if previous.is_dir():
        if target.exists():
            _remove(previous)
        else:
            previous.rename(target)
    if arrived.is_dir():
        _remove(arrived)


def _remove(folder: Path) -> None:
    if not folder.is_dir():
        return
    try:
        shutil.rmtree(folder)
    except OSError as error:
        raise StorageError(f"{folder}, which an earlier run left, cannot be deleted ({error}); delete it.") from error


@contextmanager
def _publication(target: Path) -> Iterator[None]:
    """Let one process at a time publish at ``target``."""
    from filelock import FileLock

    with FileLock(_lock_file(target)) as lock:
        try:
            yield
        finally:  # a process that waits for it finds that it is gone, and makes another
            Path(lock.lock_file).unlink(missing_ok=True)


def copy_artefacts(source: Path, into: Path) -> Path:
    """Copy a folder of artefacts that other stages may publish at the same time, without mixing old and new files.

    Args:
        source: the folder.
        into: parent of the copy; created if missing.

    Returns:
        The copy: a folder of the same name in ``into``.

    Raises:
        DataError: the folder is missing, contains ``into``, or cannot be read, or artefacts in it keep changing.
    """
    source = _absolute(source)
    if not source.is_dir():
        raise DataError(f"{source} does not exist; it should be a folder with artefacts")
    if into.resolve().is_relative_to(source.resolve()):
        raise DataError(f"{source} contains the outputs of this stage; it should be the folder of an artefact")
    copy = into / source.name
    for _ in range(_MOST_COPIES):
        shutil.rmtree(copy, ignore_errors=True)
        marks = _marks(source)
        try:
            shutil.copytree(source, copy, ignore=_UNFINISHED)
        except (shutil.Error, OSError) as error:
            if _marks(source) == marks:
                first = error.args[0][0] if isinstance(error, shutil.Error) and error.args[0] else None
                reason = f"{first[0]}: {first[2]}" if first else str(error)
                message = f"{source} cannot be copied ({reason}); it should be the folder of an artefact"
                raise DataError(message) from error
            continue
        if _marks(source) == marks:
            return copy
    raise DataError(f"artefacts in {source} are being replaced while they are read; run this command when it is over")


def _marks(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(folder.rglob(MARK)) if path.is_file()}


@document
class Mark:
    """The mark of an artefact.

    Attributes:
        stage: that made it.
        identity: what it is, where artefacts of one stage must not replace each other.
        files: relative path -> SHA-256.
    """

    stage: str
    identity: str | None
    files: dict[str, str]


def read_mark(folder: Path) -> Mark | None:
    """The mark of an artefact; None if the folder has none."""
    try:
        return _KIND.read(folder / MARK, Mark)
    except DataError:
        return None


def changed_files(folder: Path, mark: Mark) -> list[str]:
    """Names of the files that were added to an artefact, or changed, since it was published."""
    return [name for name in differing_files(folder, mark) if os.path.lexists(folder / name)]


def differing_files(folder: Path, mark: Mark) -> list[str]:
    """Names of the files that were added, changed or deleted."""
    found, expected = _checksums(folder), mark.files
    return sorted(name for name in found.keys() | expected if expected.get(name) != found.get(name))


def _names_stage(path: Path, stage: str) -> bool:
    try:
        content = _KIND.read_content(path)
    except DataError:
        return False
    return isinstance(content, dict) and content.get("stage") == stage


def _objection(target: Path, stage: str, identity: str | None) -> str | None:
    """Why ``target`` cannot be replaced; None if it can."""
    if target.is_symlink():
        return "is a symbolic link"
    if not target.exists():
        return None
    if not target.is_dir():
        return "is a file, but the artefact is a folder"
    if os.path.ismount(target):
        return "is a mount point, which cannot be replaced; name a folder in it"
    if any(not os.access(folder, os.W_OK | os.X_OK) for folder, _, _ in os.walk(target)):
        return "is not writable, so it is not replaced"
    try:
        if not any(target.iterdir()):
            return None
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    mark = read_mark(target)
    if mark is None:
        return f"is not empty and was not made by this version of pipelines.{stage}, so it is not replaced"
    if mark.stage != stage:
        return f"was made by pipelines.{mark.stage}, so pipelines.{stage} does not replace it"
    if mark.identity != identity:
        return f"holds another export ({mark.identity}), which is not replaced by this one ({identity})"
    if changed := changed_files(target, mark):
        more = f" and {len(changed) - _MOST_NAMED} more" if len(changed) > _MOST_NAMED else ""
        return (
            f"has files that were added or changed since it was made ({', '.join(changed[:_MOST_NAMED])}{more}), so it "
            "is not replaced"
        )
    return None


def _checksums(folder: Path) -> dict[str, str]:
    """SHA-256 of every file in a folder but the mark, by relative path; other links by their target."""
    checksums = {}
    for parent, folders, files in os.walk(folder):
        for name in [*files, *(name for name in folders if (Path(parent) / name).is_symlink())]:
            path = Path(parent) / name
            if name in _OF_THE_DESKTOP or path == folder / MARK:
                continue
            if path.is_file():  # also by a link, as those of DVC's cache
                content = path.read_bytes()
            else:
                content = f"link to {os.readlink(path)}".encode() if path.is_symlink() else b"not a file"
            checksums[path.relative_to(folder).as_posix()] = hashlib.sha256(content).hexdigest()
    return dict(sorted(checksums.items()))


def _lock_file(target: Path) -> Path:
    return target.with_name(f".{target.name}.visualrhp-lock")


def _asides(target: Path) -> tuple[Path, Path]:
    """Where a new artefact arrives, and where the previous one is until it is replaced."""
    return target.with_name(f".{target.name}.visualrhp-new"), target.with_name(f".{target.name}.visualrhp-old")


def _absolute(path: str | os.PathLike[str]) -> Path:
    return Path(os.path.abspath(path))  # without "..", so that it has a name
