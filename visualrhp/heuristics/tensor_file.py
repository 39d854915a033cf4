"""One file of named tensors with a JSON document in its header: safetensors, written atomically, checked when read.

Nothing read from such a file can run code (no pickle). The document travels in the same file as the tensors, so that a
kill between two writes cannot leave a pair that does not match.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from visualrhp.errors import CheckpointError
from visualrhp.files import atomic_path

_HEADER_KEY = "visualrhp"


def write_tensor_file(
    path: str | os.PathLike[str], tensors: Mapping[str, torch.Tensor], document: Mapping[str, Any]
) -> None:
    """Write ``tensors`` and a JSON ``document`` to ``path`` atomically; the same content gives the same bytes.

    Raises:
        TypeError, ValueError: the document holds something that JSON has no word for.
    """
    # safetensors refuses tensors that share memory or are not contiguous (channels last).
    copies = {
        name: tensor.detach().to("cpu", copy=True, memory_format=torch.contiguous_format)
        for name, tensor in tensors.items()
    }
    text = json.dumps(dict(document), sort_keys=True, allow_nan=False)
    # One metadata entry only: safetensors writes several of them in any order.
    header = json.dumps({"checksum": _checksum(copies, text), "document": text})
    content = save(copies, metadata={_HEADER_KEY: header})
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def read_tensor_file(path: str | os.PathLike[str]) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read back the tensors and the document of :func:`write_tensor_file`.

    Raises:
        CheckpointError: the file is missing, damaged (every bit is checked), or was not written by
            :func:`write_tensor_file`.
    """
    path = Path(path)
    if not path.is_file():
        raise CheckpointError(f"{path} does not exist; it should be a checkpoint (a safetensors file)")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise CheckpointError(f"{path} is damaged: it is no readable safetensors file ({error})") from error
    if _HEADER_KEY not in metadata:
        raise CheckpointError(f"{path} is damaged, or not of visualrhp: its header has no {_HEADER_KEY!r} entry")
    try:
        header = json.loads(metadata[_HEADER_KEY])
        checksum, text = header["checksum"], header["document"]
        document = json.loads(text)
    except (ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"{path} is damaged: the document in its header is not what was written") from error
    if checksum != _checksum(tensors, text):
        raise CheckpointError(f"{path} is damaged: the checksum of its content is not the one in its header")
    return tensors, document


def _checksum(tensors: Mapping[str, torch.Tensor], text: str) -> int:
    checksum = zlib.crc32(text.encode())
    for name in sorted(tensors):
        checksum = zlib.crc32(name.encode(), checksum)
        checksum = zlib.crc32(tensors[name].reshape(-1).view(torch.uint8).numpy().data, checksum)
    return checksum
