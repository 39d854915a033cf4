"""Publication of finished artefacts, which replaces nothing but earlier artefacts of the same stage.

Every published folder has a mark: a file with the name of the stage that made it and a checksum of every file. A folder
without a mark, with the mark of another stage, or with a file that was added or changed since belongs to the user; a
stage refuses to replace it, before it starts to work.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Sequence
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


def check_destination(destination: str | os.PathLike[str], stage: str, identity: str | None = None) -> None:
    """Check that ``stage`` can publish an artefact at ``destination``.

    Args:
        destination: folder of the artefact.
        stage: the pipeline.
        identity: what the artefact is, where artefacts of one stage must not replace each other.

    Raises:
        StorageError: something that ``stage`` did not make is there, or the folder cannot be made.
    """
    target = _absolute(destination)
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
    recover(target)
    arrived, previous = _asides(target)
    # In the same folder as the target, so that the last steps are renames within one file system.
    shutil.move(folder, arrived)
    if target.exists():
        target.rename(previous)
    arrived.rename(target)
    shutil.rmtree(previous, ignore_errors=True)


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
        with atomic_path(target / name) as temporary:
            shutil.move(folder / name, temporary)


def recover(destination: str | os.PathLike[str]) -> None:
    """Undo a publication that was killed."""
    target = _absolute(destination)
    arrived, previous = _asides(target)
    if previous.is_dir():
        if target.exists():
            shutil.rmtree(previous)
        else:
            previous.rename(target)
    if arrived.is_dir():
        shutil.rmtree(arrived)


def copy_artefacts(source: Path, into: Path, *, link: bool = False) -> Path:
    """Copy a folder of artefacts that other stages may publish at the same time, without mixing old and new files.

    Args:
        source: the folder.
        into: parent of the copy; created if missing.
        link: make hard links where the file system can, which is enough, since no stage changes a published file.

    Returns:
        The copy: a folder of the same name in ``into``.

    Raises:
        DataError: the folder is missing or cannot be read, or artefacts in it keep changing.
    """
    copy = into / source.name
    for _ in range(_MOST_COPIES):
        shutil.rmtree(copy, ignore_errors=True)
        marks = _marks(source)
        try:
            shutil.copytree(source, copy, ignore=_UNFINISHED, copy_function=_link if link else shutil.copy2)
        except (shutil.Error, OSError) as error:
            if not source.is_dir():
                raise DataError(f"{source} does not exist; it should be a folder with artefacts") from error
            if _marks(source) == marks:
                raise
            continue
        if _marks(source) == marks:
            return copy
    raise DataError(f"artefacts in {source} are being replaced while they are read; run this command when it is over")


def _link(source: str, destination: str) -> None:
    try:
        os.link(source, destination)
    except OSError:  # another file system, or one without links
        shutil.copy2(source, destination)


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
    found, expected = _checksums(folder), mark.files
    return sorted(name for name, checksum in found.items() if expected.get(name) != checksum)


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
    """SHA-256 of every file in a folder but the mark, by relative path; links by their target."""
    checksums = {}
    for parent, folders, files in os.walk(folder):
        for name in [*files, *(name for name in folders if (Path(parent) / name).is_symlink())]:
            path = Path(parent) / name
            if name in _OF_THE_DESKTOP or path == folder / MARK:
                continue
            if path.is_symlink():
                content = f"link to {os.readlink(path)}".encode()
            else:
                content = path.read_bytes() if path.is_file() else b"not a file"
            checksums[path.relative_to(folder).as_posix()] = hashlib.sha256(content).hexdigest()
    return dict(sorted(checksums.items()))


def _asides(target: Path) -> tuple[Path, Path]:
    """Where a new artefact arrives, and where the previous one is until it is replaced."""
    return target.with_name(f".{target.name}.visualrhp-new"), target.with_name(f".{target.name}.visualrhp-old")


def _absolute(path: str | os.PathLike[str]) -> Path:
    return Path(os.path.abspath(path))  # without "..", so that it has a name
