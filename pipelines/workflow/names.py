"""Names of folders and metrics, made from texts of the user: valid, bounded, and different for different texts."""

from __future__ import annotations

import hashlib
import posixpath
import re
from typing import Final

MAX_LENGTH: Final = 120
"""Most characters of a name. File systems allow 255 bytes, and suffixes are added; MLflow allows 250."""

_NUM_DIGITS = 8
_ENDS_IN_DIGEST: Final = re.compile(rf"-[0-9a-f]{{{_NUM_DIGITS}}}$")
"""Such a text could be the name of another one."""


def path_name(text: str) -> str:
    """A name of a file or folder: ``text`` itself if it is short and has letters, digits and ``_.,=+-[]`` only.

    Otherwise, the other characters are replaced by underscores, and a digest of ``text`` is appended.
    """
    clean = re.sub(r"[^\w.,=+\[\]-]", "_", text, flags=re.ASCII)
    if not clean.strip("."):
        clean = f"_{clean}"
    return _distinct(clean, text, clean == text and not _ENDS_IN_DIGEST.search(text))


def metric_name(text: str) -> str:
    """A name of a metric in MLflow: "rate/VisualRHP+ 3x3" -> "rate/VisualRHP plus 3x3".

    If other characters must be replaced, or the name is long, a digest of ``text`` is appended.
    """
    clean = re.sub(r"[^\w\-. :/]", "_", text.replace("+", " plus"), flags=re.ASCII)
    if posixpath.normpath(clean) != clean or clean.startswith((".", "/")):  # MLflow takes a name for a path
        clean = "_" + clean.replace("/", "_").replace("..", "__")
    is_plain = " plus" not in text and clean.replace(" plus", "+") == text and not _ENDS_IN_DIGEST.search(text)
    return _distinct(clean, text, is_plain)


def digest(text: str) -> str:
    """A few hexadecimal digits that differ for different texts."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:_NUM_DIGITS]


def _distinct(clean: str, text: str, is_plain: bool) -> str:
    """``clean`` if it stands for no other text than ``text``, otherwise with a digest of ``text``."""
    if is_plain and len(clean) <= MAX_LENGTH:
        return clean
    return f"{clean[: MAX_LENGTH - _NUM_DIGITS - 1]}-{digest(text)}"
