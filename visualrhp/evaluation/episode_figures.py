"""The paper's figures of results, Fig. 7 to 10, from a table of episodes.

Continuous actions are above, discrete ones below; bars are 90% confidence intervals. Give the functions the whole table
of an evaluation: the styles of methods depend on it (:func:`visualrhp.evaluation.styles.method_styles`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullLocator

from visualrhp.evaluation.axes import AXIS_LABELS, MetricName, error_line, finish_axes, not_empty, offsets, spacing
from visualrhp.evaluation.methods import ACTION_SPACES, NOISE_ORDER, SIZES, order_methods, with_labels
from visualrhp.evaluation.metrics import summarize
from visualrhp.evaluation.styles import (
    FAINT,
    NOISE_STYLES,
    SURFACE,
    WIDTH,
    LineStyle,
    figure_style,
    method_styles,
)
from visualrhp.evaluation.summaries import mixed_sizes, random_num_objects, without_noise


def by_num_objects(episodes: pd.DataFrame, metric: MetricName = "success_rate") -> Figure:
    """Fig. 7a and 8a: a metric against the number of objects, objects of mixed size, no noise.

    The axis has the numbers that were requested, or all that occurred if none was. Episodes are grouped by the number
    of objects in their scenes, requested or drawn at random (given the number, both have the same distribution).

    Raises:
        DataError: there are no such episodes.
    """
    rows = not_empty(without_noise(mixed_sizes(episodes)), "objects of mixed size without noise")
    styles = method_styles(episodes)

    def draw(axes: Axes, panel: pd.DataFrame) -> None:
        _draw_methods(axes, panel, "num_objects", _requested_num_objects(rows), metric, styles)
        axes.set_xlabel("Objects in the scene")

    return _panels_by_action_space(rows, metric, draw, styles)


def by_size(episodes: pd.DataFrame, metric: MetricName = "success_rate") -> Figure:
    """Fig. 7b and 8b: a metric against the average object size, random numbers of objects, no noise.

    Raises:
        DataError: there are no such episodes.
    """
    rows = not_empty(random_num_objects(without_noise(episodes)), "no noise")
    sizes = [size for size in SIZES if size in set(rows["object_size"])]
    styles = method_styles(episodes)

    def draw(axes: Axes, panel: pd.DataFrame) -> None:
        _draw_methods(axes, panel, "object_size", sizes, metric, styles)
        axes.set_xlabel("Object size relative to the gripper")

    return _panels_by_action_space(rows, metric, draw, styles)


def execution_time(episodes: pd.DataFrame) -> Figure:
    """Fig. 9: planning and execution time per run, mixed sizes, random numbers of objects, no noise; logarithmic.

    Raises:
        DataError: there are no such episodes.
    """
    rows = random_num_objects(without_noise(mixed_sizes(episodes)))
    rows = with_labels(not_empty(rows, "objects of mixed size without noise"))
    methods = order_methods(rows["method"].tolist())
    styles = method_styles(episodes)
    spaces = [space for space in ACTION_SPACES if space in set(rows["action_space"])]
    summaries = {
        (summary["method"], summary["action_space"]): summary
        for summary in summarize(rows, ["method", "action_space"]).to_dict("records")
    }
    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.9 + 0.46 * len(methods)), layout="constrained")
        axes = figure.add_subplot()
        largest = max(float(summary["execution_time_s"]) for summary in summaries.values())
        for row, method in enumerate(methods):
            for offset, space in zip(offsets(len(spaces), 0.4), spaces, strict=True):
                if (method, space) in summaries:
                    is_filled = space == "continuous"
                    _draw_time(axes, row + offset, summaries[method, space], styles[method], is_filled)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _seconds(value)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlim(right=largest * 5.0)  # room for the figures
        axes.set_yticks(range(len(methods)), methods)
        axes.set_ylim(len(methods) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel("Planning and execution time per run")
        handles = [
            Line2D([], [], ls="", marker="o", ms=7, color=FAINT, mfc=FAINT if space == "continuous" else SURFACE)
            for space in spaces
        ]
        figure.legend(handles, [f"{space} actions" for space in spaces], loc="outside upper left", ncols=2)
    return figure


def robustness(episodes: pd.DataFrame, metric: MetricName = "success_rate") -> Figure:
    """Fig. 10: a metric against the number of objects at each level of noise on the world, one panel per method.

    Methods that were never run with noise are left out; the paper's are in the continuous action space.

    Raises:
        DataError: there are no episodes with noise.
    """
    rows = with_labels(mixed_sizes(episodes))
    noisy = rows.loc[rows["noise_level"] != "none"]
    panels = sorted(
        set(zip(noisy["method"], noisy["action_space"], strict=True)),
        key=lambda panel: (panel[1], order_methods(noisy["method"].tolist()).index(panel[0])),
    )
    not_empty(noisy, "objects of mixed size with noise")
    levels = [level for level in NOISE_ORDER if level in set(rows["noise_level"])]
    numbers = _requested_num_objects(noisy)
    columns = min(len(panels), 2)
    lines = -(-len(panels) // columns)
    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.8 + 2.3 * lines), layout="constrained")
        grid = figure.subplots(lines, columns, sharey=True, squeeze=False)
        for axes in grid.flat[len(panels) :]:
            axes.set_visible(False)
        for axes, (method, space) in zip(grid.flat, panels, strict=False):
            panel = rows.loc[(rows["method"] == method) & (rows["action_space"] == space)]
            summary = summarize(panel, ["noise_level", "num_objects"])
            width = 0.4 * spacing(numbers)
            for offset, level in zip(offsets(len(levels), width), levels, strict=True):
                line = summary.loc[summary["noise_level"] == level].set_index("num_objects").reindex(numbers)
                error_line(axes, line, metric, offset, **NOISE_STYLES[level].keywords(4.5))
            axes.set_title(method if len(set(noisy["action_space"])) == 1 else f"{method},\n{space}", fontsize=9.5)
            finish_axes(axes, metric, numbers)
            axes.set_xlabel("Objects in the scene")
        for axes in grid[:, 0]:
            axes.set_ylabel(AXIS_LABELS[metric])
        handles = [Line2D([], [], **NOISE_STYLES[level].keywords(4.5)) for level in levels]
        names = [f"{level} noise" if level != "none" else "no noise" for level in levels]
        figure.legend(handles, names, loc="outside upper left", ncols=2)
    return figure


def _panels_by_action_space(
    rows: pd.DataFrame,
    metric: MetricName,
    draw: Callable[[Axes, pd.DataFrame], None],
    styles: Mapping[str, LineStyle],
) -> Figure:
    rows = with_labels(rows)
    spaces = [space for space in ACTION_SPACES if space in set(rows["action_space"])]
    methods = order_methods(rows["method"].tolist())
    with figure_style():
        height = 0.3 + 0.2 * math.ceil(len(methods) / 2) + 2.9 * len(spaces)
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        grid = figure.subplots(len(spaces), 1, sharey=True, squeeze=False)[:, 0]
        for axes, space in zip(grid, spaces, strict=True):
            panel = rows.loc[rows["action_space"] == space]
            draw(axes, panel)
            axes.set_title(f"{space.capitalize()} actions")
            axes.set_ylabel(AXIS_LABELS[metric])
        handles = [Line2D([], [], **styles[method].keywords(6.0)) for method in methods]
        figure.legend(handles, methods, loc="outside upper left", ncols=2)
    return figure


def _draw_methods(
    axes: Axes,
    panel: pd.DataFrame,
    by: str,
    positions: Sequence[Any],
    metric: MetricName,
    styles: Mapping[str, LineStyle],
) -> None:
    methods = order_methods(panel["method"].tolist())
    width = spacing(positions) * min(0.8, 0.08 * len(methods))
    for offset, method in zip(offsets(len(methods), width), methods, strict=True):
        line = summarize(panel.loc[panel["method"] == method], [by]).set_index(by).reindex(positions)
        error_line(axes, line, metric, offset, **styles[method].keywords(6.0))
    finish_axes(axes, metric, positions)


def _draw_time(axes: Axes, y: float, summary: dict[Any, Any], style: LineStyle, is_filled: bool) -> None:
    """A mean execution time with its interval, and its value in figures."""
    value, low, high = (float(summary[f"execution_time_s{end}"]) for end in ("", "_low", "_high"))
    low = max(low, 0.2 * value)  # a logarithmic axis has no zero
    errors = None if math.isnan(high) else [[value - low], [high - value]]
    axes.errorbar(
        [value],
        [y],
        xerr=errors,
        linestyle="",
        marker=style.marker,
        color=style.colour,
        markerfacecolor=style.colour if is_filled else SURFACE,
        markersize=7,
        elinewidth=1.2,
        capsize=3,
    )
    axes.annotate(
        _seconds(value),
        (max(value, high) if not math.isnan(high) else value, y),
        xytext=(8, 0),
        textcoords="offset points",
        va="center",
        fontsize=8.5,
        color=FAINT,
    )


def _requested_num_objects(episodes: pd.DataFrame) -> list[int]:
    """Numbers of objects that were requested; where all were drawn at random, those that occurred."""
    requested = episodes["scene_num_objects"].astype(str)
    fixed = sorted({int(number) for number in requested if number.isdecimal()})
    return fixed or sorted(int(number) for number in episodes["num_objects"].unique())


def _seconds(value: float) -> str:
    """A duration in a suitable unit."""
    if value < 1.0:
        return f"{1e3 * value:.3g} ms"
    return f"{value:.3g} s" if value < 120.0 else f"{value / 60.0:.3g} min"
