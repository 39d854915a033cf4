"""Figures of trainings: the learning studies of the paper, Fig. 5 and 6, and curves of any training."""

from __future__ import annotations

import math
from collections.abc import Mapping
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
from visualrhp.evaluation.styles import WIDTH, figure_style, series_style


@dataclass(frozen=True)
class ShownCurves:
    """The curves of a training stage in its figure and in the report.

    Attributes:
        name: of the stage, in words.
        unit: what a row of its curves stands for; a column.
        columns: to draw -> title of their panel.
        explanation: of the titles.
    """

    name: str
    unit: str
    columns: Mapping[str, str]
    explanation: str


SHOWN_CURVES: Final[Mapping[str, ShownCurves]] = {
    "train_il": ShownCurves(
        "Imitation learning",
        "epoch",
        {
            "greedy/success_rate": "Success rate, greedy",
            "greedy/action_efficiency": "Action efficiency, greedy",
            "train/loss": "Loss, training data",
            "validation/loss": "Loss, validation data",
            "validation/value_rmse": "RMS error of predicted return",
            "validation/agreement": "Share of actions as shown",
            "train/log_likelihood": "Log-likelihood, training data",
            "validation/log_likelihood": "Log-likelihood, validation",
            "train/entropy": "Entropy of the policy (nat)",
        },
        "Greedy: the policy without look-ahead, on validation tasks. Loss: Eq. 5 and 6; log-likelihood and predicted "
        "return are its terms. RMS: root mean square.",
    ),
    "train_rl": ShownCurves(
        "Reinforcement learning",
        "iteration",
        {
            "greedy/success_rate": "Success rate, greedy",
            "greedy/action_efficiency": "Action efficiency, greedy",
            "collection/success_rate": "Success rate, exploring",
            "collection/return": "Return, exploring",
            "value/td_rmse": "RMS temporal difference",
            "q/loss": "Squared temporal difference",
            "baseline/kl": "KL to policy, baseline step",
            "policy/entropy": "Entropy of the policy (nat)",
            "policy/kl": "KL to old policy (nat)",
        },
        "Greedy: the policy without look-ahead, on validation tasks. Exploring: while transitions are collected. "
        "Temporal difference: target minus value (Eq. 7, 8 and 10). RMS: root mean square. KL: Kullback-Leibler "
        "divergence.",
    ),
    "expert_iteration": ShownCurves(
        "Expert iteration",
        "round",
        {
            "validation/score": "Score of the planner",
            "validation/success_rate": "Success rate, planner",
            "validation/num_actions": "Actions, planner",
            "greedy/success_rate": "Success rate, greedy",
            "collection/expert_success_rate": "Success rate, expert's episodes",
            "collection/greedy_success_rate": "Success rate, greedy episodes",
            "imitation/train_value_error": "Value error, training data",
            "imitation/validation_value_rmse": "RMS error of predicted return",
        },
        "Planner: VisualRHP+ with the network of the round, on validation tasks; its score is success minus a cost of "
        "the actions. Greedy: the network without look-ahead. Expert's and greedy episodes: those that the next "
        "network imitates. RMS: root mean square.",
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
        figure = Figure(figsize=(WIDTH, 3.3), layout="constrained")
        axes = figure.add_subplot()
        for number, space in enumerate(ACTION_SPACES):
            points = _interval_table(batches.loc[batches["action_space"] == space], "num_demonstrations")
            if points.empty:
                continue
            style = series_style(number).keywords(5.5)
            error_line(axes, points, "success_rate", 0.0, label=f"{space} actions", **style)
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
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.3), layout="constrained")
        axes = figure.add_subplot()
        for number, algorithm in enumerate(sorted(trials["algorithm"].unique())):
            style = series_style(number)
            points = _interval_table(trials.loc[trials["algorithm"] == algorithm], "transitions")
            x = points.index.to_numpy(dtype=float)
            low, high = points["success_rate_low"], points["success_rate_high"]
            axes.fill_between(x, low, high, color=style.colour, alpha=0.18, lw=0)
            axes.plot(x, points["success_rate"], label=algorithm, markevery=0.1, **style.keywords(5.0))
        axes.set_xlabel("Transitions collected")
        axes.set_ylabel("Success rate of the greedy policy")
        _finish_sweep(figure, axes)
    return figure


def training_curves(histories: Mapping[str, pd.DataFrame], x: str, columns: Mapping[str, str], x_label: str) -> Figure:
    """Training curves: one panel per column, one line per run that has it.

    Args:
        histories: run name -> table with one row per iteration.
        x: column of the horizontal axis; the row number where a run lacks it.
        columns: to draw -> title of the panel; those that no run has are left out.
        x_label: label of the horizontal axis.

    Raises:
        DataError: no run has any of the columns.
    """
    drawn_columns = [name for name in columns if any(_has_values(history, name) for history in histories.values())]
    if not drawn_columns:
        raise DataError("none of the training histories has a column to draw")
    across = min(2, len(drawn_columns))
    down = -(-len(drawn_columns) // across)
    legend_columns = 2 if max(map(len, histories)) <= 26 else 1
    with figure_style():
        height = 1.75 * down + 0.3 + 0.2 * math.ceil(len(histories) / legend_columns)
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        grid = figure.subplots(down, across, squeeze=False)
        for axes in grid.flat[len(drawn_columns) :]:
            axes.set_visible(False)
        drawn: dict[str, Any] = {}
        for axes, column in zip(grid.flat, drawn_columns, strict=False):
            for number, (name, history) in enumerate(histories.items()):
                if not _has_values(history, column):
                    continue
                kept = history.loc[history[column].notna()]
                steps = kept[x] if x in kept.columns else pd.Series(range(len(kept)), index=kept.index)
                (line,) = axes.plot(
                    np.asarray(steps, dtype=float),
                    np.asarray(kept[column], dtype=float),
                    markevery=max(1, len(kept) // 8),
                    **series_style(number).keywords(4.0),
                )
                drawn.setdefault(name, line)
            axes.set_title(columns[column], fontsize=9.5, fontweight="normal")
            first, last = axes.dataLim.intervalx
            if first == last:
                axes.set_xlim(first - 0.5, last + 0.5)
            axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
            axes.yaxis.set_major_locator(MaxNLocator(4))
        for axes in grid.flat[max(0, len(drawn_columns) - across) : len(drawn_columns)]:
            axes.set_xlabel(x_label)
        figure.legend(list(drawn.values()), list(drawn), loc="outside upper left", ncols=legend_columns)
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
