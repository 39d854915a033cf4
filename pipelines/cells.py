"""Finished cells of evaluations: what was measured before is not measured again.

A cell is one setting: a planner on the first task instances of a distribution, at a level of noise. Its name is a hash
of configuration, code and networks. A cell is a table of episodes, ``<outputs>/cells/<hash>.parquet``, written when its
last episode is finished. It may be deleted at any time.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from visualrhp.errors import DataError

if TYPE_CHECKING:
    from pipelines.points import Point

_log = logging.getLogger(__name__)

Rows = dict[int, dict[str, Any]]
"""Index of the task instance -> columns of the episode (:func:`visualrhp.evaluation.episodes.episode_row`)."""


class Cells:
    """The cells in a folder.

    Args:
        folder: with their tables; it is made with the first one.
        reuse: whether cells that are there are used; all are measured again otherwise, and replaced.
    """

    def __init__(self, folder: Path, reuse: bool = True) -> None:
        self.folder = folder
        self._reuse = reuse

    def finished(self, point: Point) -> Rows:
        """The episodes of a prepared point that are finished. A damaged table counts as none, with a warning."""
        from visualrhp.evaluation.episodes import RESULT_COLUMNS, read_episodes

        path = self._path(point)
        if not self._reuse or not path.exists():
            return {}
        try:
            table = read_episodes(path)
        except DataError as error:
            _log.warning("The episodes of a cell are run again: %s", error)
            return {}
        columns: Any = table[list(RESULT_COLUMNS)]
        rows = columns.to_dict("records")
        return {
            int(index): {str(name): value for name, value in row.items()}
            for index, row in zip(table["episode"], rows, strict=True)
        }

    def keep(self, point: Point, rows: Mapping[int, Mapping[str, Any]]) -> None:
        """Write the episodes of a prepared point, unless they are there."""
        from visualrhp.evaluation.episodes import episodes_table, write_episodes

        known = self.finished(point)
        if rows.keys() <= known.keys():
            return
        merged, path = {**known, **rows}, self._path(point)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_episodes(path, episodes_table((point.setting, index, merged[index]) for index in sorted(merged)))

    def _path(self, point: Point) -> Path:
        return self.folder / f"{point.cell}.parquet"
