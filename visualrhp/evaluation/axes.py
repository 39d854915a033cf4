"""Parts that the figures share: metrics with interval bars, axes of rates, positions side by side."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Final, Literal

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from visualrhp.errors import DataError
from visualrhp.evaluation.methods import SIZES

MetricName = Literal["success_rate", "action_efficiency", "execution_time_s"]

AXIS_LABELS: Final[dict[MetricName, str]] = {
    "success_rate": "Success rate",
    "action_efficiency": "Action efficiency (objects / actions)",
    "execution_time_s": "Execution time per run (s)",
}


def error_line(axes: Axes, line: pd.DataFrame, metric: str, offset: float, **style: Any) -> None:
    """Draw markers with interval bars, joined across gaps.

    Args:
        axes: to draw on.
        line: indexed by the horizontal axis; columns as in :func:`visualrhp.evaluation.metrics.summarize`. Numbers are
            drawn where they are, sizes at 0, 1, 2.
        metric: column to draw.
        offset: of the horizontal positions.
        style: for matplotlib.
    """
    line = line.loc[line[metric].notna()]
    numeric = pd.api.types.is_numeric_dtype(line.index)
    positions = line.index.to_numpy(dtype=float) if numeric else [list(SIZES).index(name) for name in line.index]
    x = pd.Series(positions, dtype=float).to_numpy() + offset
    value = line[metric].to_numpy(dtype=float)
    low = line[f"{metric}_low"].fillna(line[metric]).to_numpy(dtype=float)
    high = line[f"{metric}_high"].fillna(line[metric]).to_numpy(dtype=float)
    errors = [(value - low).clip(min=0.0), (high - value).clip(min=0.0)]
    axes.errorbar(x, value, yerr=errors, elinewidth=1.0, capsize=2.0, capthick=1.0, **style)


def finish_axes(axes: Axes, metric: MetricName, positions: Sequence[Any]) -> None:
    """Set ticks and limits of axes with :func:`error_line` at ``positions``."""
    if positions and isinstance(positions[0], str):
        ticks = [list(SIZES).index(name) for name in positions]
        axes.set_xticks(ticks, list(positions))
        axes.set_xlim(min(ticks) - 0.5, max(ticks) + 0.5)
    elif positions:
        margin = 0.5 * spacing(positions)
        axes.set_xticks(positions)
        axes.set_xlim(min(positions) - margin, max(positions) + margin)
    axes.grid(axis="x", visible=False)
    if metric == "success_rate":
        percent_axis(axes)
    else:
        axes.set_ylim(bottom=0.0)


def percent_axis(axes: Axes) -> None:
    """Make the vertical axis one of rates from 0 to 100%."""
    axes.set_ylim(-0.02, 1.03)
    axes.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:.0f}%"))


def spacing(positions: Sequence[Any]) -> float:
    """The smallest distance between ``positions`` on an axis; 1.0 for a single position, and for sizes."""
    if any(isinstance(position, str) for position in positions):
        return 1.0
    ordered = sorted(positions)
    return min((after - before for before, after in itertools.pairwise(ordered)), default=1.0)


def offsets(count: int, width: float) -> list[float]:
    """``count`` positions around 0, ``width`` from first to last, so that error bars stand side by side."""
    return [0.0] if count < 2 else [width * (number / (count - 1) - 0.5) for number in range(count)]


def not_empty(rows: pd.DataFrame, needed: str) -> pd.DataFrame:
    """Return ``rows``.

    Raises:
        DataError: there are none; the message names what the figure needs.
    """
    if rows.empty:
        raise DataError(f"the table has no rows for this figure (it needs {needed})")
    return rows
