"""Sets of labelled frames: a folder with files of frames, and a card that lists them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from visualrhp.documents import FileKind, document
from visualrhp.embodiment.segmentation.frames import FRAMES, LabelledFrames, join, read_frames
from visualrhp.errors import DataError
from visualrhp.files import write_json
from visualrhp.parameters import Count

CARD_NAME: Final = "card.json"

CARD: Final = FileKind(
    "the card of a set of labelled frames (JSON)", "generate the set again: python -m pipelines.generate_frames"
)


@document
class FrameFile:
    """A file of a set. Attributes: ``file``, its name; ``num_frames``; ``sha256`` of its content."""

    file: str
    num_frames: Count
    sha256: str


@document
class FrameCard:
    """The card of a set. Attributes: ``content_hash``, of all frames; ``files``, in order."""

    content_hash: str
    files: tuple[FrameFile, ...]

    def __post_init__(self) -> None:
        if not self.files:
            raise ValueError("files is empty; it should list the files of the set")
        if any(Path(entry.file).name != entry.file for entry in self.files):
            raise ValueError("files should hold names of files in the folder of the card")


def write_card(folder: Path, files: Sequence[Path], **about: Any) -> dict[str, Any]:
    """Write the card of a set whose files are in ``folder``; return its content.

    Args:
        folder: of the set.
        files: of frames, in order.
        about: further content: how the set was made.

    Raises:
        DataError: a file is damaged.
    """
    rows = [{"file": path.name, "num_frames": len(read_frames(path)), "sha256": file_hash(path)} for path in files]
    content = {**about, "content_hash": _content_hash([row["sha256"] for row in rows]), "files": rows}
    write_json(folder / CARD_NAME, content)
    return content


def read_card(folder: str | Path) -> FrameCard:
    """Read the card of a set.

    Raises:
        DataError: it is missing or damaged.
    """
    path = Path(folder) / CARD_NAME
    card: FrameCard = CARD.read(path, FrameCard)
    if card.content_hash != _content_hash([entry.sha256 for entry in card.files]):
        raise CARD.damaged(path, "content_hash is not that of its files")
    return card


def load_frame_set(folder: str | Path) -> LabelledFrames:
    """All frames of a set, in order.

    Raises:
        DataError: the card or a file is missing or damaged.
    """
    parts = []
    for entry in read_card(folder).files:
        path = Path(folder) / entry.file
        frames = read_frames(path)
        if file_hash(path) != entry.sha256 or len(frames) != entry.num_frames:
            raise FRAMES.damaged(path, "its content is not that which is on the card of its set")
        parts.append(frames)
    if len({part.images.shape[1] for part in parts}) > 1:
        raise DataError(f"the frames in {folder} differ in size; generate the set again")
    return join(parts)


def file_hash(path: Path) -> str:
    """SHA-256 of the content of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _content_hash(hashes: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()
