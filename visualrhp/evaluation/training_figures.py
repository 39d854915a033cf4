"""Figures of trainings: the learning studies of the paper, Fig. 5 and 6, and curves of any training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from visualrhp.errors import DataError
from visualrhp.evaluation.axes import AXIS_LABELS, error_line, not_empty, percent_axis
from visualrhp.evaluation.methods import ACTION_SPACES
from visualrhp.evaluation.metrics import mean_interval
from visualrhp.evaluation.styles import BLUE, LIGHT_GREY, PALETTE, VERMILION, figure_style


@dataclass(frozen=True)
class ShownCurves:
    """The curves of a training stage in its figure and in the report.

    Attributes:
        name: of the stage, in words.
        unit: what a row of its curves stands for; a column.
        columns: to draw.
    """

    name: str
    unit: str
    columns: Sequence[str]


SHOWN_CURVES: Final[Mapping[str, ShownCurves]] = {
    "train_il": ShownCurves(
        "Imitation learning",
        "epoch",
        (
            "greedy/success_rate",
            "greedy/action_efficiency",
            "train/loss",
            "validation/loss",
            "validation/value_rmse",
            "validation/agreement",
            "train/log_likelihood",
            "validation/log_likelihood",
            "train/entropy",
        ),
    ),
    "train_rl": ShownCurves(
        "Reinforcement learning",
        "iteration",
        (
            "greedy/success_rate",
            "greedy/action_efficiency",
            "collection/success_rate",
            "collection/return",
            "value/td_rmse",
            "q/loss",
            "baseline/kl",
            "policy/entropy",
            "policy/kl",
        ),
    ),
    "expert_iteration": ShownCurves(
        "Expert iteration",
        "round",
        (
            "validation/score",
            "validation/success_rate",
            "validation/num_actions",
            "greedy/success_rate",
            "collection/expert_success_rate",
            "collection/greedy_success_rate",
            "imitation/train_value_error",
            "imitation/validation_value_rmse",
        ),
    ),
}
"""By stage, which is the name of its folder."""


def demonstrations_sweep(batches: pd.DataFrame) -> Figure:
    """Fig. 5: success rate of the imitating policy against the number of demonstrations that it learned from.

    Args:
        batches: one row per batch of tasks: action_space, num_demonstrations, success_rate
            (:func:`visualrhp.evaluation.sweeps.demonstration_batches`). The paper has 15 batches of 20 tasks per point;
            the bars are t intervals over the batches.

    Raises:
        DataError: there are no batches.
    """
    not_empty(batches, "demonstration sweeps")
    with figure_style():
        figure = Figure(figsize=(5.6, 3.5), layout="constrained")
        axes = figure.add_subplot()
        for space, colour, marker in zip(ACTION_SPACES, (BLUE, VERMILION), ("o", "s"), strict=True):
            points = _interval_table(batches.loc[batches["action_space"] == space], "num_demonstrations")
            if points.empty:
                continue
            error_line(axes, points, "success_rate", 0.0, color=colour, marker=marker, ms=5.5, label=f"{space} actions")
        axes.set_xlabel("Available demonstrations")
        axes.set_ylabel(AXIS_LABELS["success_rate"])
        axes.set_xlim(left=0)
        _finish_sweep(figure, axes)
    return figure


def learning_stability(trials: pd.DataFrame) -> Figure:
    """Fig. 6: success rate of the greedy policy while it learns, with and without the C3PO step.

    Args:
        trials: one row per trial and measurement: algorithm ("C3PO", "PPO"), transitions, success_rate
            (:func:`visualrhp.evaluation.sweeps.stability_trials`). Lines are means over the trials, bands their t
            intervals.

    Raises:
        DataError: there are no trials.
    """
    not_empty(trials, "reinforcement learning trials")
    colours = {"C3PO": BLUE, "PPO": VERMILION}
    with figure_style():
        figure = Figure(figsize=(5.6, 3.5), layout="constrained")
        axes = figure.add_subplot()
        for number, algorithm in enumerate(sorted(trials["algorithm"].unique())):
            colour = colours.get(algorithm, LIGHT_GREY)
            points = _interval_table(trials.loc[trials["algorithm"] == algorithm], "transitions")
            x = points.index.to_numpy(dtype=float)
            axes.fill_between(
                x, points["success_rate_low"], points["success_rate_high"], color=colour, alpha=0.18, lw=0
            )
            axes.plot(x, points["success_rate"], color=colour, ls=("-", "--", "-.", ":")[number % 4], label=algorithm)
        axes.set_xlabel("Transitions collected")
        axes.set_ylabel("Success rate of the greedy policy")
        _finish_sweep(figure, axes)
    return figure


def training_curves(histories: Mapping[str, pd.DataFrame], x: str, columns: Sequence[str], x_label: str) -> Figure:
    """Training curves: one panel per column, one line per run that has it.

    Args:
        histories: run name -> table with one row per iteration.
        x: column of the horizontal axis; the row number where a run lacks it.
        columns: to draw; those that no run has are left out.
        x_label: label of the horizontal axis.

    Raises:
        DataError: no run has any of the columns.
    """
    columns = [name for name in columns if any(_has_values(history, name) for history in histories.values())]
    if not columns:
        raise DataError("none of the training histories has a column to draw")
    across = min(3, len(columns))
    down = -(-len(columns) // across)
    with figure_style():
        figure = Figure(figsize=(3.1 * across + 0.4, 2.15 * down + 0.6), layout="constrained")
        grid = figure.subplots(down, across, squeeze=False)
        for axes in grid.flat[len(columns) :]:
            axes.set_visible(False)
        drawn: dict[str, Any] = {}
        for axes, column in zip(grid.flat, columns, strict=False):
            for number, (name, history) in enumerate(histories.items()):
                if not _has_values(history, column):
                    continue
                kept = history.loc[history[column].notna()]
                steps = kept[x] if x in kept.columns else pd.Series(range(len(kept)), index=kept.index)
                marker = "o" if len(kept) <= 12 else None
                (line,) = axes.plot(
                    np.asarray(steps, dtype=float),
                    np.asarray(kept[column], dtype=float),
                    color=PALETTE[number % len(PALETTE)],
                    ls=("-", "--", "-.")[number // len(PALETTE) % 3],
                    marker=marker,
                    ms=3.5,
                )
                drawn.setdefault(name, line)
            axes.set_title(column.replace("_", " ").replace("/", ": "), fontsize=9.5)
            axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
            axes.yaxis.set_major_locator(MaxNLocator(4))
        for axes in grid[-1]:
            axes.set_xlabel(x_label)
        figure.legend(list(drawn.values()), list(drawn), loc="outside upper left", ncols=min(3, len(drawn)))
    return figure


def _finish_sweep(figure: Figure, axes: Axes) -> None:
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    percent_axis(axes)
    figure.legend(loc="outside upper left", ncols=2)


def _interval_table(rows: pd.DataFrame, by: str) -> pd.DataFrame:
    """Mean and t interval of ``success_rate`` by a column, with the columns of :func:`summarize`."""
    points = {}
    for key, group in rows.groupby(by):
        estimate = mean_interval(group["success_rate"])
        points[key] = {
            "success_rate": estimate.value,
            "success_rate_low": estimate.low,
            "success_rate_high": estimate.high,
        }
    return pd.DataFrame.from_dict(points, orient="index")


def _has_values(history: pd.DataFrame, column: str) -> bool:
    return column in history.columns and bool(history[column].notna().any())
