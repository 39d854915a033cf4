"""Frames as picture files."""

from __future__ import annotations

import os
from pathlib import Path

import cv2

from visualrhp.errors import ConfigError
from visualrhp.files import atomic_path
from visualrhp.rendering.video import Frame

_FORMATS = {".png": [], ".webp": [cv2.IMWRITE_WEBP_QUALITY, 85]}


def encode_picture(frame: Frame, suffix: str) -> bytes:
    """Encode ``frame`` as a ``.png`` or ``.webp`` file.

    Raises:
        ConfigError: the suffix is another one.
    """
    if suffix not in _FORMATS:
        raise ConfigError(
            f"pictures are written as {' or '.join(_FORMATS)}, not as {suffix or 'a file without suffix'}"
        )
    _, data = cv2.imencode(suffix, cv2.cvtColor(frame, cv2.COLOR_RGB2BGR), _FORMATS[suffix])
    return data.tobytes()


def write_picture(path: str | os.PathLike[str], frame: Frame) -> None:
    """Write ``frame`` to a ``.png`` or ``.webp`` file, atomically; errors as :func:`encode_picture`."""
    data = encode_picture(frame, Path(path).suffix)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
