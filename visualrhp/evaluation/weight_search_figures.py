"""Figures of a search for weights: its trials, and from which side the object is pushed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from visualrhp.evaluation.behaviour import FROM_BEHIND
from visualrhp.evaluation.styles import BLUE, FAINT, VERMILION
from visualrhp.evaluation.weight_search import TrialRecord


def search_figure(records: Sequence[TrialRecord], best: TrialRecord) -> Figure:
    """The objective of every trial in order, and against each weight."""
    names = list(best.weights)
    columns = 3
    rows = -(-(len(names) + 1) // columns)
    figure = Figure(figsize=(9.0, 2.6 * rows), layout="constrained")
    finished = [record for record in records if not record.is_pruned]
    pruned = [record for record in records if record.is_pruned]
    for number, name in enumerate([None, *names]):
        axes = figure.add_subplot(rows, columns, number + 1)
        for group, colour, label in ((pruned, "#b9c0ca", "pruned"), (finished, BLUE, "finished")):
            x = [record.trial if name is None else record.weights[name] for record in group]
            axes.plot(x, [record.objective for record in group], "o", color=colour, markersize=3.5, label=label)
        x = best.trial if name is None else best.weights[name]
        axes.plot([x], [best.objective], "*", color=VERMILION, markersize=11, label="selected")
        axes.set_xlabel("trial" if name is None else name)
        if name is not None:
            axes.set_xscale("log")
            tried = [record.weights[name] for record in records]
            ticks = np.geomspace(min(tried), max(tried), 4)
            axes.set_xticks(ticks, [f"{tick:.2g}" for tick in ticks])
            axes.minorticks_off()
        if number % columns == 0:
            axes.set_ylabel("objective")
        if name is None:
            axes.legend(fontsize="small", loc="lower right")
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def pushes_figure(records: Mapping[str, TrialRecord]) -> Figure:
    """Histograms of the angles of all pushes: one line per record, one panel per action space."""
    spaces = list(next(iter(records.values())).episodes)
    figure = Figure(figsize=(4.5 * len(spaces), 3.0), layout="constrained")
    bins = np.linspace(0.0, 180.0, 13)
    for number, space in enumerate(spaces):
        axes = figure.add_subplot(1, len(spaces), number + 1)
        axes.axvspan(0.0, math.degrees(FROM_BEHIND), color="#e8f1f8", lw=0)
        for (label, record), colour in zip(records.items(), (FAINT, BLUE), strict=True):
            angles = np.degrees([angle for episode in record.episodes[space] for angle in episode.push_angles])
            share = np.mean(angles < math.degrees(FROM_BEHIND)) if len(angles) else math.nan
            heights = np.histogram(angles, bins)[0] / max(1, len(angles))
            axes.stairs(heights, bins, color=colour, lw=1.6, label=f"{label}: {share:.0%} below 60°")
        axes.set(title=space, xlabel="gripper off straight behind the object (°)", xticks=range(0, 181, 30))
        if number == 0:
            axes.set_ylabel("share of pushes")
        axes.legend(fontsize="small")
        axes.spines[["top", "right"]].set_visible(False)
    return figure
