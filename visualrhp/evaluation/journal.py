"""A file of finished results, from which a killed run resumes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from visualrhp.files import write_text


class Journal(Mapping[str, Any]):
    """Finished results by key, one JSON line each, appended in the order of completion.

    An incomplete last line, left by a kill, is ignored when the file is read. Results consist of dicts, lists and
    scalars; NaN is kept.

    Args:
        path: of the file; it is created with the first result.

    Attributes:
        path: as given.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._results: dict[str, Any] = {}
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        lines = []
        for line in text.splitlines():
            try:
                key, result = json.loads(line)
            except ValueError:
                continue
            self._results[key] = result
            lines.append(f"{line}\n")
        if (complete := "".join(lines)) != text:
            write_text(path, complete)

    def append(self, key: str, result: Any) -> None:
        """Record a result; it is in the file when this returns."""
        line = json.dumps([key, result])
        with self.path.open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")
        self._results[key] = result

    def __getitem__(self, key: str) -> Any:
        return self._results[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._results)

    def __len__(self) -> int:
        return len(self._results)
