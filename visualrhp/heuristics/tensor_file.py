"""Files of named arrays with a JSON document in the header: safetensors, written atomically, checked when read.

Reading such a file cannot execute code (no pickle). The document is in the same file as the arrays, so that a kill
between two writes cannot leave a mismatched pair.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import safe_open
from safetensors.numpy import save

from visualrhp.documents import FileKind, brief, conform, document, parse_json
from visualrhp.errors import CheckpointError
from visualrhp.files import atomic_path

CHECKPOINT = FileKind("a checkpoint (a safetensors file)", "make it again", CheckpointError)
"""A tensor file of any use; its users have kinds of their own, which say what to do about a damaged one."""

_HEADER_KEY = "visualrhp"


@document
class _Header:
    """The metadata of a file: the document as text, and a checksum of it and of the arrays."""

    checksum: int
    document: str


def write_tensor_file(
    path: str | os.PathLike[str], arrays: Mapping[str, npt.NDArray[Any]], document: Mapping[str, Any]
) -> None:
    """Write ``arrays`` and a JSON ``document`` to ``path`` atomically; the same content gives the same bytes.

    Raises:
        TypeError, ValueError: the document holds a value that JSON cannot represent.
    """
    copies = {name: np.array(array, order="C") for name, array in arrays.items()}
    text = json.dumps(dict(document), sort_keys=True, allow_nan=False)
    # A single metadata entry, since safetensors writes several in arbitrary order.
    header = json.dumps({"checksum": _checksum(copies, text), "document": text})
    content = save(copies, metadata={_HEADER_KEY: header})
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def read_tensor_file(
    path: str | os.PathLike[str], kind: FileKind = CHECKPOINT
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Read back the arrays and the document of :func:`write_tensor_file`.

    Args:
        path: of the file.
        kind: of the file, for the messages.

    Raises:
        CheckpointError: the file is missing or damaged (every bit is checked), or was not written by
            :func:`write_tensor_file`. Its class is that of ``kind``.
    """
    path = Path(path)
    kind.require(path)
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            arrays = {name: np.array(file.get_tensor(name)) for name in file.keys()}  # noqa: SIM118
    except Exception as error:  # the parser of the library meets bytes of any origin
        raise kind.damaged(path, f"it is not a readable safetensors file ({brief(error)})") from error
    if _HEADER_KEY not in metadata:
        raise kind.unusable(path, f"is damaged or not a file of visualrhp: its header has no {_HEADER_KEY!r} entry")
    try:
        header: _Header = conform(_Header, parse_json(metadata[_HEADER_KEY]))
        document = parse_json(header.document)
    except ValueError as error:
        raise kind.damaged(path, f"the document in its header was altered ({brief(error)})") from error
    if not isinstance(document, dict):
        raise kind.damaged(path, "the document in its header is not a group of keys (a JSON object)")
    if header.checksum != _checksum(arrays, header.document):
        raise kind.damaged(path, "the checksum of its content is not the one in its header")
    return arrays, document


def _checksum(arrays: Mapping[str, npt.NDArray[Any]], text: str) -> int:
    checksum = zlib.crc32(text.encode())
    for name in sorted(arrays):
        checksum = zlib.crc32(name.encode(), checksum)
        checksum = zlib.crc32(arrays[name].tobytes(), checksum)
    return checksum
