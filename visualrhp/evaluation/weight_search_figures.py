"""Figures of a search for weights: its trials, and from which side the object is pushed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from visualrhp.evaluation.behaviour import FROM_BEHIND
from visualrhp.evaluation.styles import BLUE, GREY, ORANGE, SKY, VERMILION, WIDTH, figure_style
from visualrhp.evaluation.weight_search import TrialRecord


def search_figure(records: Sequence[TrialRecord], best: TrialRecord) -> Figure:
    """The objective of every trial in order, and against each weight."""
    names = list(best.weights)
    columns = 2
    rows = -(-(len(names) + 1) // columns)
    finished = [record for record in records if not record.is_pruned]
    pruned = [record for record in records if record.is_pruned]
    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.3 + 1.9 * rows), layout="constrained")
        for number, name in enumerate([None, *names]):
            axes = figure.add_subplot(rows, columns, number + 1)
            for group, colour, marker, label in ((pruned, GREY, "x", "pruned"), (finished, SKY, "o", "finished")):
                x = [record.trial if name is None else record.weights[name] for record in group]
                y = [record.objective for record in group]
                axes.plot(x, y, marker, color=colour, markersize=3.5, label=label)
            x = best.trial if name is None else best.weights[name]
            axes.plot([x], [best.objective], "*", color=VERMILION, markersize=11, label="selected")
            axes.set_xlabel("trial" if name is None else name)
            if name is not None:
                axes.set_xscale("log")
                tried = [record.weights[name] for record in records]
                ticks = np.geomspace(min(tried), max(tried), 3)
                axes.set_xticks(ticks, [f"{tick:.2g}" for tick in ticks])
                axes.minorticks_off()
            if number % columns == 0:
                axes.set_ylabel("objective")
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def pushes_figure(records: Mapping[str, TrialRecord]) -> Figure:
    """Histograms of the angles of all pushes: one line per record, one panel per action space."""
    spaces = list(next(iter(records.values())).episodes)
    bins = np.linspace(0.0, 180.0, 13)
    limit = math.degrees(FROM_BEHIND)
    with figure_style():
        figure = Figure(figsize=(WIDTH, 2.7 * len(spaces)), layout="constrained")
        for number, space in enumerate(spaces):
            axes = figure.add_subplot(len(spaces), 1, number + 1)
            axes.axvspan(0.0, limit, color=SKY, alpha=0.1, lw=0)
            for (label, record), colour, line in zip(records.items(), (ORANGE, BLUE), ("--", "-"), strict=True):
                angles = np.degrees([angle for episode in record.episodes[space] for angle in episode.push_angles])
                share = np.mean(angles < limit) if len(angles) else math.nan
                heights = np.histogram(angles, bins)[0] / max(1, len(angles))
                axes.stairs(heights, bins, color=colour, ls=line, lw=1.6, label=f"{label}: {share:.0%} below 60°")
            axes.set(title=space, xticks=range(0, 181, 30), ylabel="share of pushes")
            axes.set_xlabel("gripper off straight behind the object (°)")
            axes.legend()
    return figure
