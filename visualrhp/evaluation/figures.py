"""The figures of the paper (Fig. 5 to 10) from tables of results, in one style.

Every method has its own colour and marker everywhere (the colour-blind safe set of Okabe and Ito, and greys), with the
continuous action space left, the discrete one right; bars and bands are 90% confidence intervals. Figures are plain
matplotlib ``Figure`` objects, made without pyplot's global state; :func:`to_svg` prepares one for a page, :func:`save`
writes it.
"""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

from visualrhp.errors import DataError
from visualrhp.evaluation.metrics import mean_interval, summarize
from visualrhp.files import atomic_path

MetricName = Literal["success_rate", "action_efficiency", "execution_time_s"]

METHOD = ["planner", "num_rollouts", "horizon"]
"""Columns of an episodes table that together name a method."""

SIZES = ("small", "mixed", "large")
NOISE_ORDER = ("none", "low", "medium", "high")
ACTION_SPACES = ("continuous", "discrete")

_INK = "#1c2129"
_FAINT = "#6f7885"
_GRID = "#d9dde3"
_PAPER = "#fefefe"

_AXIS_LABELS: dict[MetricName, str] = {
    "success_rate": "Success rate",
    "action_efficiency": "Action efficiency (objects / actions)",
    "execution_time_s": "Execution time per run (s)",
}


@dataclass(frozen=True, slots=True)
class MethodStyle:
    """How a method is drawn."""

    colour: str
    marker: str


_STYLES = {
    "VisualRHP 6x6": MethodStyle("#56b4e9", "D"),
    "VisualRHP 3x3": MethodStyle("#0072b2", "o"),
    "CartesianRHP 3x3": MethodStyle("#e69f00", "s"),
    "CraftedHeuristicRHP 8x4": MethodStyle("#009e73", "^"),
    "Greedy": MethodStyle("#d55e00", "v"),
    "K.RRT": MethodStyle("#6f6f6f", "X"),
    "K.RRT closed loop": MethodStyle("#cc79a7", "P"),
    "dhRRT": MethodStyle("#000000", "d"),
}
_FURTHER_STYLES = [MethodStyle("#9a9a9a", marker) for marker in ("h", "*", "p", "<", ">", "H")]
_NOISE_COLOURS = {"none": "#0b2545", "low": "#2a6f97", "medium": "#c8792b", "high": "#a4161a"}
_NOISE_LINES = {"none": "-", "low": "--", "medium": "-.", "high": ":"}


def method_label(planner: str, num_rollouts: float | None = None, horizon: float | None = None) -> str:
    """A method's name in the paper's manner: the planner, then n x h if it rolls out ("VisualRHP 3x3").

    A planner whose name ends in its n x h already is left alone; None, NaN and 0 mean no roll-outs.
    """
    if not _is_count(num_rollouts) or not _is_count(horizon):
        return planner
    suffix = f"{int(num_rollouts or 0)}x{int(horizon or 0)}"
    return planner if planner.endswith(suffix) else f"{planner} {suffix}"


def with_labels(table: pd.DataFrame) -> pd.DataFrame:
    """A copy of an episodes or summary table with the column ``method`` (see :func:`method_label`)."""
    labels = [method_label(*key) for key in table[METHOD].itertuples(index=False)]
    return table.assign(method=pd.Series(labels, index=table.index, dtype="object"))


def order_methods(labels: Sequence[str]) -> list[str]:
    """The distinct ``labels`` in the order of legends and tables: the paper's methods first."""
    known = list(_STYLES)
    return sorted(set(labels), key=lambda label: (known.index(label) if label in known else len(known), label))


def method_style(label: str, labels: Sequence[str]) -> MethodStyle:
    """Colour and marker of the method ``label`` among all ``labels`` of a figure."""
    if label in _STYLES:
        return _STYLES[label]
    others = [other for other in order_methods(labels) if other not in _STYLES]
    return _FURTHER_STYLES[others.index(label) % len(_FURTHER_STYLES)]


def by_density(episodes: pd.DataFrame, metric: MetricName = "success_rate") -> Figure:
    """Fig. 7a and 8a: a metric against the clutter density, objects of mixed size, no noise.

    The densities are those that were asked for, or all that occurred if none was. Episodes are grouped by the number of
    objects that their scenes have, whether asked for or drawn at random (given the number, both are one distribution).
    """
    rows = episodes.loc[(episodes["object_size"] == "mixed") & (episodes["noise_level"] == "none")]
    rows = _not_empty(rows, "objects of mixed size without noise")

    def draw(axes: Axes, panel: pd.DataFrame) -> None:
        _draw_methods(axes, panel, "num_objects", _densities(rows), metric)
        axes.set_xlabel("Objects in the scene")

    return _panels_by_action_space(rows, metric, draw)


def by_size(episodes: pd.DataFrame, metric: MetricName = "success_rate") -> Figure:
    """Fig. 7b and 8b: a metric against the average object size, densities drawn at random, no noise."""
    rows = _not_empty(_random_density(episodes.loc[episodes["noise_level"] == "none"]), "no noise")

    def draw(axes: Axes, panel: pd.DataFrame) -> None:
        _draw_methods(axes, panel, "object_size", [size for size in SIZES if size in set(rows["object_size"])], metric)
        axes.set_xlabel("Object size relative to the gripper")

    return _panels_by_action_space(rows, metric, draw)


def execution_time(episodes: pd.DataFrame) -> Figure:
    """Fig. 9: planning and execution time per run, mixed sizes at random densities, no noise; logarithmic."""
    rows = _random_density(episodes.loc[(episodes["object_size"] == "mixed") & (episodes["noise_level"] == "none")])
    rows = with_labels(_not_empty(rows, "objects of mixed size without noise"))
    methods = order_methods(rows["method"].tolist())
    spaces = [space for space in ACTION_SPACES if space in set(rows["action_space"])]
    summaries = {
        (summary["method"], summary["action_space"]): summary
        for summary in summarize(rows, ["method", "action_space"]).to_dict("records")
    }
    with _style():
        figure = Figure(figsize=(7.6, 0.9 + 0.52 * len(methods)), layout="constrained")
        axes = figure.add_subplot()
        largest = max(float(summary["execution_time_s"]) for summary in summaries.values())
        for row, method in enumerate(methods):
            style = method_style(method, methods)
            for offset, space in zip(_offsets(len(spaces), 0.3), spaces, strict=True):
                if (method, space) not in summaries:
                    continue
                summary = summaries[method, space]
                value, low, high = (float(summary[f"execution_time_s{end}"]) for end in ("", "_low", "_high"))
                low = max(low, 0.2 * value)  # a logarithmic axis has no zero
                errors = None if math.isnan(high) else [[value - low], [high - value]]
                axes.errorbar(
                    [value],
                    [row + offset],
                    xerr=errors,
                    fmt=style.marker,
                    color=style.colour,
                    markerfacecolor=style.colour if space == "continuous" else _PAPER,
                    markersize=7,
                    elinewidth=1.2,
                    capsize=3,
                )
                axes.annotate(
                    _seconds(value),
                    (max(value, high) if not math.isnan(high) else value, row + offset),
                    xytext=(8, 0),
                    textcoords="offset points",
                    va="center",
                    fontsize=8.5,
                    color=_FAINT,
                )
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _seconds(value)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlim(right=largest * 2.2)
        axes.set_yticks(range(len(methods)), methods)
        axes.set_ylim(len(methods) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel("Planning and execution time per run")
        handles = [
            Line2D([], [], ls="", marker="o", ms=7, color=_FAINT, mfc=_FAINT if space == "continuous" else _PAPER)
            for space in spaces
        ]
        figure.legend(handles, [f"{space} actions" for space in spaces], loc="outside upper left", ncols=2)
    return figure


def robustness(episodes: pd.DataFrame, metric: MetricName = "success_rate") -> Figure:
    """Fig. 10: a metric against the clutter density at each level of noise on the world, a panel a method.

    Methods that were never run with noise are left out; the paper's are in the continuous action space.
    """
    rows = with_labels(episodes.loc[episodes["object_size"] == "mixed"])
    noisy = rows.loc[rows["noise_level"] != "none"]
    panels = sorted(
        set(zip(noisy["method"], noisy["action_space"], strict=True)),
        key=lambda panel: (panel[1], order_methods(noisy["method"].tolist()).index(panel[0])),
    )
    _not_empty(noisy, "objects of mixed size with noise")
    levels = [level for level in NOISE_ORDER if level in set(rows["noise_level"])]
    densities = _densities(noisy)
    columns = min(len(panels), 4)
    lines = -(-len(panels) // columns)
    with _style():
        figure = Figure(figsize=(1.0 + 2.35 * columns, 0.8 + 2.5 * lines), layout="constrained")
        grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
        for axes in grid.flat[len(panels) :]:
            axes.set_visible(False)
        for axes, (method, space) in zip(grid.flat, panels, strict=False):
            panel = rows.loc[(rows["method"] == method) & (rows["action_space"] == space)]
            summary = summarize(panel, ["noise_level", "num_objects"])
            for offset, level in zip(_offsets(len(levels), 0.3), levels, strict=True):
                line = summary.loc[summary["noise_level"] == level].set_index("num_objects").reindex(densities)
                colour = _NOISE_COLOURS[level]
                _error_line(axes, line, metric, offset, color=colour, marker="o", ms=4, ls=_NOISE_LINES[level])
            axes.set_title(method if len(set(noisy["action_space"])) == 1 else f"{method}, {space}", fontsize=9.5)
            _finish_axes(axes, metric, densities)
            axes.set_xlabel("Objects in the scene")
        for axes in grid[:, 0]:
            axes.set_ylabel(_AXIS_LABELS[metric])
        handles = [
            Line2D([], [], color=_NOISE_COLOURS[level], ls=_NOISE_LINES[level], marker="o", ms=4) for level in levels
        ]
        names = [f"{level} noise" if level != "none" else "no noise" for level in levels]
        figure.legend(handles, names, loc="outside upper left", ncols=len(levels))
    return figure


def demonstrations_sweep(batches: pd.DataFrame) -> Figure:
    """Fig. 5: success rate of the imitating policy against the number of demonstrations it learned from.

    Args:
        batches: one row per batch of tasks: action_space, num_demonstrations, success_rate. The paper has 15 batches of
            20 tasks a point; the bars are t intervals over the batches.
    """
    _not_empty(batches, "demonstration sweeps")
    with _style():
        figure = Figure(figsize=(5.6, 3.5), layout="constrained")
        axes = figure.add_subplot()
        for space, colour, marker in zip(ACTION_SPACES, ("#0072b2", "#d55e00"), ("o", "s"), strict=True):
            points = _interval_table(batches.loc[batches["action_space"] == space], "num_demonstrations")
            if points.empty:
                continue
            _error_line(
                axes, points, "success_rate", 0.0, color=colour, marker=marker, ms=5.5, label=f"{space} actions"
            )
        axes.set_xlabel("Available demonstrations")
        axes.set_ylabel(_AXIS_LABELS["success_rate"])
        axes.set_xlim(left=0)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        _percent_axis(axes)
        figure.legend(loc="outside upper left", ncols=2)
    return figure


def learning_stability(trials: pd.DataFrame) -> Figure:
    """Fig. 6: success rate of the greedy policy while it learns, with and without the C3PO step.

    Args:
        trials: one row per trial and measurement: algorithm ("C3PO", "PPO"), transitions, success_rate. Lines are means
            over the trials, bands their t intervals.
    """
    _not_empty(trials, "reinforcement learning trials")
    colours = {"C3PO": "#0072b2", "PPO": "#d55e00"}
    with _style():
        figure = Figure(figsize=(5.6, 3.5), layout="constrained")
        axes = figure.add_subplot()
        for number, algorithm in enumerate(sorted(trials["algorithm"].unique())):
            colour = colours.get(algorithm, _FURTHER_STYLES[0].colour)
            points = _interval_table(trials.loc[trials["algorithm"] == algorithm], "transitions")
            x = points.index.to_numpy(dtype=float)
            axes.fill_between(
                x, points["success_rate_low"], points["success_rate_high"], color=colour, alpha=0.18, lw=0
            )
            axes.plot(x, points["success_rate"], color=colour, ls=("-", "--", "-.", ":")[number % 4], label=algorithm)
        axes.set_xlabel("Transitions collected")
        axes.set_ylabel("Success rate of the greedy policy")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        _percent_axis(axes)
        figure.legend(loc="outside upper left", ncols=2)
    return figure


def training_curves(histories: Mapping[str, pd.DataFrame], x: str, columns: Sequence[str], x_label: str) -> Figure:
    """Small multiples of training curves: a panel per column, a line per run that has it.

    Args:
        histories: run name -> table with one row per iteration.
        x: column of the horizontal axis; the row number where a run lacks it.
        columns: what to draw, those that no run has are left out.
        x_label: words for the horizontal axis.
    """
    columns = [name for name in columns if any(_has_values(history, name) for history in histories.values())]
    if not columns:
        raise DataError("none of the training histories has a column to draw")
    palette = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#6f6f6f"]
    across = min(3, len(columns))
    down = -(-len(columns) // across)
    with _style():
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
                    color=palette[number % len(palette)],
                    ls=("-", "--", "-.")[number // len(palette) % 3],
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


def to_svg(figure: Figure) -> str:
    """The figure as an ``<svg>`` element for an HTML page: no identifiers that could clash, no external names.

    Text and axes take the page's text colour (``currentColor``), hollow markers its ``--surface`` colour, so that the
    figure follows a light or dark theme. The same figure gives the same string.
    """
    with _style():
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].strip()
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\s*xmlns(:\w+)?="[^"]*"', "", svg)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = svg.replace("font-family: 'DejaVu Sans', sans-serif", "font-family: inherit")
    return svg.replace(_INK, "currentColor").replace(_PAPER, "var(--surface, #fff)")


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write the figure to ``path`` (.svg, .png or .pdf by its suffix), atomically, without a date in it."""
    suffix = os.path.splitext(path)[1]
    metadata: dict[str, Any] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix, {})
    with _style(), atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=160, metadata=metadata)


@contextmanager
def _style() -> Iterator[None]:
    parameters: Any = {
        "font.family": "sans-serif",
        "font.sans-serif": ["DejaVu Sans"],
        "font.size": 10,
        "axes.titlesize": 10,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.labelsize": 10,
        "axes.labelcolor": _INK,
        "axes.edgecolor": _FAINT,
        "axes.linewidth": 0.8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.facecolor": "none",
        "figure.facecolor": "none",
        "savefig.facecolor": "white",
        "grid.color": _GRID,
        "grid.alpha": 0.6,
        "grid.linewidth": 0.7,
        "lines.linewidth": 1.5,
        "legend.frameon": False,
        "legend.fontsize": 9.5,
        "legend.handlelength": 1.9,
        "text.color": _INK,
        "xtick.color": _FAINT,
        "ytick.color": _FAINT,
        "xtick.labelcolor": _INK,
        "ytick.labelcolor": _INK,
        "xtick.labelsize": 9.5,
        "ytick.labelsize": 9.5,
        "svg.fonttype": "none",
        "svg.hashsalt": "visualrhp",
    }
    with matplotlib.rc_context(parameters):
        yield


def _panels_by_action_space(
    rows: pd.DataFrame, metric: MetricName, draw: Callable[[Axes, pd.DataFrame], None]
) -> Figure:
    rows = with_labels(rows)
    spaces = [space for space in ACTION_SPACES if space in set(rows["action_space"])]
    methods = order_methods(rows["method"].tolist())
    with _style():
        figure = Figure(figsize=(0.9 + 4.3 * len(spaces), 4.0), layout="constrained")
        grid = figure.subplots(1, len(spaces), sharey=True, squeeze=False)[0]
        for axes, space in zip(grid, spaces, strict=True):
            panel = rows.loc[rows["action_space"] == space]
            draw(axes, panel)
            axes.set_title(f"{space.capitalize()} actions")
        grid[0].set_ylabel(_AXIS_LABELS[metric])
        styles = [method_style(method, methods) for method in methods]
        handles = [Line2D([], [], color=style.colour, marker=style.marker, ms=6) for style in styles]
        figure.legend(handles, methods, loc="outside upper left", ncols=3)
    return figure


def _draw_methods(axes: Axes, panel: pd.DataFrame, by: str, positions: Sequence[Any], metric: MetricName) -> None:
    methods = order_methods(panel["method"].tolist())
    for offset, method in zip(_offsets(len(methods), 0.36), methods, strict=True):
        style = method_style(method, methods)
        line = summarize(panel.loc[panel["method"] == method], [by]).set_index(by).reindex(positions)
        _error_line(axes, line, metric, offset, color=style.colour, marker=style.marker, ms=6)
    _finish_axes(axes, metric, positions)


def _error_line(axes: Axes, line: pd.DataFrame, metric: str, offset: float, **style: Any) -> None:
    """Markers with interval bars, joined over gaps; categories are placed at 0, 1, ..., numbers at themselves."""
    line = line.loc[line[metric].notna()]
    numeric = pd.api.types.is_numeric_dtype(line.index)
    positions = line.index.to_numpy(dtype=float) if numeric else [list(SIZES).index(name) for name in line.index]
    x = pd.Series(positions, dtype=float).to_numpy() + offset
    value = line[metric].to_numpy(dtype=float)
    low = line[f"{metric}_low"].fillna(line[metric]).to_numpy(dtype=float)
    high = line[f"{metric}_high"].fillna(line[metric]).to_numpy(dtype=float)
    errors = [(value - low).clip(min=0.0), (high - value).clip(min=0.0)]
    axes.errorbar(x, value, yerr=errors, elinewidth=1.0, capsize=2.0, capthick=1.0, **style)


def _finish_axes(axes: Axes, metric: MetricName, positions: Sequence[Any]) -> None:
    if positions and isinstance(positions[0], str):
        ticks = [list(SIZES).index(name) for name in positions]
        axes.set_xticks(ticks, list(positions))
        axes.set_xlim(min(ticks) - 0.5, max(ticks) + 0.5)
    elif positions:
        axes.set_xticks(positions)
        axes.set_xlim(min(positions) - 0.5, max(positions) + 0.5)
    axes.grid(axis="x", visible=False)
    if metric == "success_rate":
        _percent_axis(axes)
    else:
        axes.set_ylim(bottom=0.0)


def _percent_axis(axes: Axes) -> None:
    axes.set_ylim(-0.02, 1.03)
    axes.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:.0f}%"))


def _interval_table(rows: pd.DataFrame, by: str) -> pd.DataFrame:
    """Mean and t interval of ``success_rate`` by a column, as a table with the columns of :func:`summarize`."""
    points = {}
    for key, group in rows.groupby(by):
        estimate = mean_interval(group["success_rate"])
        points[key] = {
            "success_rate": estimate.value,
            "success_rate_low": estimate.low,
            "success_rate_high": estimate.high,
        }
    return pd.DataFrame.from_dict(points, orient="index")


def _random_density(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes whose density was drawn at random (Sec. 8.1), or all if there are none."""
    if "scene_num_objects" in episodes.columns:
        random = episodes["scene_num_objects"].astype(str).str.contains("-")
        if random.any():
            return episodes.loc[random]
    return episodes


def _densities(episodes: pd.DataFrame) -> list[int]:
    """Numbers of objects that were asked for; where every density was drawn at random, all that occurred."""
    if "scene_num_objects" in episodes.columns:
        requested = episodes["scene_num_objects"].astype(str)
        fixed = sorted({int(number) for number in requested if number.isdecimal()})
        if fixed:
            return fixed
    return sorted(int(number) for number in episodes["num_objects"].unique())


def _not_empty(rows: pd.DataFrame, what: str) -> pd.DataFrame:
    if rows.empty:
        raise DataError(f"the table has no rows for this figure (it needs {what})")
    return rows


def _has_values(history: pd.DataFrame, column: str) -> bool:
    return column in history.columns and bool(history[column].notna().any())


def _offsets(count: int, width: float) -> list[float]:
    """``count`` positions around 0, ``width`` from first to last, so that error bars stand side by side."""
    return [0.0] if count < 2 else [width * (number / (count - 1) - 0.5) for number in range(count)]


def _is_count(number: float | None) -> bool:
    return number is not None and not pd.isna(number) and number > 0


def _seconds(value: float) -> str:
    """A duration with a unit that suits it."""
    if value < 1.0:
        return f"{1e3 * value:.3g} ms"
    return f"{value:.3g} s" if value < 120.0 else f"{value / 60.0:.3g} min"
