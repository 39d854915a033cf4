"""Training curves and trained networks, read from the folders of trainings."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from visualrhp.documents import FileKind, brief, files_named
from visualrhp.parameters import show

CURVES: Final = FileKind("a table of training curves (CSV)", "rerun the training that made it")

_TEXT: Final = ("network",)
"""Columns that are not numbers."""


def read_curves(folder: Path) -> dict[str, pd.DataFrame]:
    """The training curves of the networks below ``folder`` (``<action space>/<observation>/curves.csv``), by name.

    Raises:
        DataError: a file cannot be read, or is not a table of training curves.
    """
    curves = {}
    for path in files_named(folder, "*/*", "curves.csv"):
        table = read_curve_table(path, "network")
        space, observation = path.parent.parts[-2:]
        for network, rows in table.groupby("network", sort=False):
            names = (space, observation, str(network))
            curves[", ".join(dict.fromkeys(names))] = rows.dropna(axis="columns", how="all")
    return curves


def read_curve_table(path: Path, *required: str) -> pd.DataFrame:
    """Read a ``curves.csv``.

    Args:
        path: of the file.
        required: columns that it must have.

    Raises:
        DataError: the file cannot be read, is not a table, lacks a column, has no rows, or a value is not a number.
    """
    CURVES.require(path)
    try:
        data = path.read_bytes()
        if not data.endswith((b"\n", b"\r")):
            raise ValueError("its last line was cut short: it has no line break")
        table = pd.read_csv(io.BytesIO(data))
        _check_table(table, required)
    except OSError as error:
        raise CURVES.unreadable(path, error) from error
    except Exception as error:  # pandas raises almost anything for bytes that are no CSV
        raise CURVES.unusable(path, f"is not a table of training curves ({brief(error)})") from error
    return table


def _check_table(table: pd.DataFrame, required: tuple[str, ...]) -> None:
    if missing := [name for name in required if name not in table.columns]:
        raise ValueError(f"it lacks the columns {', '.join(missing)}")
    if not isinstance(table.index, pd.RangeIndex):
        raise ValueError("its rows have more fields than it has columns")
    if table.empty:
        raise ValueError("it has no rows")
    for name in table.columns:
        values = table[name]
        if name in _TEXT:
            if bool(np.any(pd.isna(values))):
                raise ValueError(f"the column {name} has missing values")
        elif not pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values):
            raise ValueError(f"the column {show(name)} has values that are not numbers")
        elif np.isinf(values.to_numpy(np.float64)).any():
            raise ValueError(f"the column {show(name)} has infinite numbers")


def trained_networks(folder: Path) -> tuple[int, list[str]]:
    """How many networks have a card below ``folder``, and the folders that they are in ("continuous, image")."""
    cards = sorted(folder.glob("**/heuristic*.json"))
    return len(cards), sorted({", ".join(card.relative_to(folder).parent.parts) for card in cards})
