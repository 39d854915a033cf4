"""The figures of the report: file names, headings and captions."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from visualrhp.errors import DataError
from visualrhp.evaluation import episode_figures, training_figures
from visualrhp.evaluation.curves import read_curves
from visualrhp.evaluation.metrics import CONFIDENCE
from visualrhp.evaluation.summaries import without_noise
from visualrhp.evaluation.sweeps import TASKS_PER_BATCH, demonstration_batches, stability_trials


@dataclass(frozen=True)
class NamedFigure:
    """A figure of the report: the stem of its file, its heading and what it shows."""

    stem: str
    name: str
    caption: str
    figure: Figure


def result_figures(episodes: pd.DataFrame) -> dict[str, list[NamedFigure]]:
    """The paper's Fig. 7 to 10 that the episodes have rows for, in the sections "environments" and "robustness"."""
    has_sizes = len(set(without_noise(episodes)["object_size"])) > 1
    by_num_objects, by_size = episode_figures.by_num_objects, episode_figures.by_size
    candidates: list[tuple[str, str, str, str, Callable[[pd.DataFrame], Figure]]] = [
        (
            "environments",
            "figure_7a",
            "Success rate by number of objects",
            "Objects of mixed size, no noise. Paper, Fig. 7a.",
            by_num_objects,
        ),
        (
            "environments",
            "figure_7b",
            "Success rate by object size",
            "Number of objects drawn at random. Paper, Fig. 7b.",
            by_size,
        ),
        (
            "environments",
            "figure_8a",
            "Action efficiency by number of objects",
            "Objects in the scene over actions until completion, completed tasks only: higher is better. Paper, "
            "Fig. 8a.",
            functools.partial(by_num_objects, metric="action_efficiency"),
        ),
        (
            "environments",
            "figure_8b",
            "Action efficiency by object size",
            "Number of objects drawn at random; completed tasks only. Paper, Fig. 8b.",
            functools.partial(by_size, metric="action_efficiency"),
        ),
        (
            "environments",
            "figure_9",
            "Execution time per run",
            "Time to choose all actions of a run and to simulate those executed, mean over all runs, on this machine; "
            "logarithmic scale. Filled symbols: continuous actions, hollow ones: discrete. Paper, Fig. 9.",
            episode_figures.execution_time,
        ),
        (
            "robustness",
            "figure_10",
            "Success rate under noise",
            "The shapes, friction and density of the world's objects are drawn around the planner's model (relative "
            "standard deviation 1%, 3% and 5%). Every method is run in the same perturbed worlds. Paper, Fig. 10.",
            episode_figures.robustness,
        ),
    ]
    found: dict[str, list[NamedFigure]] = {"environments": [], "robustness": []}
    for section, stem, name, caption, draw in candidates:
        if stem in ("figure_7b", "figure_8b") and not has_sizes:
            continue
        try:
            figure = draw(episodes)
        except DataError:  # no episodes for this figure
            continue
        found[section].append(NamedFigure(stem, name, caption, figure))
    return found


def curve_figures(folders: Sequence[Path]) -> list[NamedFigure]:
    """A figure of training curves for each folder named in ``SHOWN_CURVES`` that has any, one line per network.

    Raises:
        DataError: a file of curves is damaged.
    """
    named = []
    for folder in folders:
        shown = training_figures.SHOWN_CURVES.get(folder.name)
        if shown is None:
            continue
        curves = read_curves(folder)
        try:
            figure = training_figures.training_curves(curves, shown.unit, shown.columns, shown.unit.capitalize())
        except DataError:  # no such curves, as in a run without validation of a single iteration
            continue
        caption = f"One line per trained network ({len(curves)}). {shown.explanation}"
        named.append(NamedFigure(f"training_{folder.name}", shown.name, caption, figure))
    return named


def sweep_figures(demonstrations: Path | None, stability: Path | None) -> list[NamedFigure]:
    """Fig. 5 and 6, from the folders of the sweeps behind them; None leaves a figure out.

    Raises:
        DataError: a sweep has no finished job.
    """
    named = []
    if demonstrations is not None:
        figure = training_figures.demonstrations_sweep(demonstration_batches(demonstrations))
        caption = f"Imitation followed greedily, means over batches of {TASKS_PER_BATCH} tasks (Fig. 5)."
        named.append(NamedFigure("demonstrations", "Number of demonstrations", caption, figure))
    if stability is not None:
        trials = stability_trials(stability)
        figure = training_figures.learning_stability(trials)
        caption = (
            f"Reinforcement learning with the baseline step (C3PO) and without it (PPO), {trials['trial'].nunique()} "
            f"trials; bands are {CONFIDENCE:.0%} confidence intervals (Fig. 6)."
        )
        named.append(NamedFigure("stability", "Learning stability", caption, figure))
    return named
