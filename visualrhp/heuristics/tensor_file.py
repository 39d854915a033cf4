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
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from visualrhp.errors import CheckpointError
from visualrhp.files import atomic_path

_HEADER_KEY = "visualrhp"


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


def read_tensor_file(path: str | os.PathLike[str]) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Read back the arrays and the document of :func:`write_tensor_file`.

    Raises:
        CheckpointError: the file is missing or damaged (every bit is checked), or was not written by
            :func:`write_tensor_file`.
    """
    path = Path(path)
    if not path.is_file():
        raise CheckpointError(f"{path} does not exist; it should be a checkpoint (a safetensors file)")
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            arrays = {name: np.array(file.get_tensor(name)) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise CheckpointError(f"{path} is damaged: it is not a readable safetensors file ({error})") from error
    if _HEADER_KEY not in metadata:
        raise CheckpointError(f"{path} is damaged or not a file of visualrhp: its header has no {_HEADER_KEY!r} entry")
    try:
        header = json.loads(metadata[_HEADER_KEY])
        checksum, text = header["checksum"], header["document"]
        document = json.loads(text)
    except (ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"{path} is damaged: the document in its header was altered") from error
    if checksum != _checksum(arrays, text):
        raise CheckpointError(f"{path} is damaged: the checksum of its content is not the one in its header")
    return arrays, document


def _checksum(arrays: Mapping[str, npt.NDArray[Any]], text: str) -> int:
    checksum = zlib.crc32(text.encode())
    for name in sorted(arrays):
        checksum = zlib.crc32(name.encode(), checksum)
        checksum = zlib.crc32(arrays[name].tobytes(), checksum)
    return checksum
