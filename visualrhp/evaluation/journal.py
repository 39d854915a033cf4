"""A file of finished results, from which a killed run resumes."""

from __future__ import annotations

import json
import os
import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from visualrhp.documents import FileKind, brief, conform, parse_json
from visualrhp.files import write_text

JOURNAL: Final = FileKind(
    "a journal of finished results (JSON lines)",
    "delete this file and rerun the command: all results are computed again",
)
_START: Final = b'["'
_LINE: Final = replace(
    JOURNAL, remedy="delete this line to compute its result again, or the file to compute all, and rerun the command"
)


class Journal(Mapping[str, Any]):
    """Finished results by key, one JSON line each (key, result, checksum), in the order of completion.

    An incomplete last line, left by a kill, is ignored when the file is read. Results consist of dicts, lists and
    scalars; NaN is kept.

    Args:
        path: of the file; it is created with the first result.
        schema: of a result (:mod:`visualrhp.documents`).

    Attributes:
        path: as given.

    Raises:
        DataError: the file cannot be read, a line of it is damaged, or a result does not match the schema; the message
            says what to delete.
    """

    def __init__(self, path: Path, schema: Any = Any) -> None:
        self.path = path
        self._results: dict[str, Any] = {}
        content = self._read()
        lines = content.split(b"\n")
        kept = []
        for number, line in enumerate(lines, start=1):
            if not line.strip():
                continue
            try:
                key, result = _parse(line, schema)
            except ValueError as error:
                if number == len(lines) and line.startswith(_START[: len(line)]):  # it was cut short
                    break
                raise _LINE.damaged(path, f"line {number} is not as it was written ({brief(error)})") from error
            self._results[key] = result
            kept.append(line + b"\n")
        if (complete := b"".join(kept)) != content:
            write_text(path, complete.decode())

    def append(self, key: str, result: Any) -> None:
        """Record a result; it is in the file when this returns."""
        body = json.dumps([key, result])
        with self.path.open("a", encoding="utf-8") as file:
            file.write(f"{body[:-1]}, {zlib.crc32(body.encode())}]\n")
        self._results[key] = result

    def _read(self) -> bytes:
        try:
            if not os.path.lexists(self.path) or (self.path.is_file() and not self.path.stat().st_size):
                return b""
            JOURNAL.require(self.path)
            return self.path.read_bytes()
        except OSError as error:
            raise JOURNAL.unreadable(self.path, error) from error

    def __getitem__(self, key: str) -> Any:
        return self._results[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._results)

    def __len__(self) -> int:
        return len(self._results)


def _parse(line: bytes, schema: Any) -> tuple[str, Any]:
    """Key and result in a line.

    Raises:
        ValueError: the line was altered, or is of another version.
    """
    head, _, tail = line.strip().rpartition(b", ")
    body = head + b"]"
    if not re.fullmatch(rb"[0-9]{1,10}\]", tail) or int(tail[:-1]) != zlib.crc32(body):
        raise ValueError("its checksum is missing or differs")
    content = parse_json(body.decode(), allow_nan=True)
    if not isinstance(content, list) or len(content) != 2 or not isinstance(content[0], str):
        raise ValueError("it is not a key and a result")
    if schema is not Any:
        conform(schema, content[1])
    return content[0], content[1]
