"""Summaries of a table of episodes: the rows that a statement is about, tables of metrics, numbers in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd

from visualrhp.evaluation.failures import Failure
from visualrhp.evaluation.methods import ACTION_SPACES, order_methods, with_labels
from visualrhp.evaluation.metrics import evaluation_metrics, summarize
from visualrhp.evaluation.paired import paired_table
from visualrhp.types import Metrics


# ------------------------------------------------------------------------------------------------------ choice of rows
def mixed_sizes(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes with objects of mixed size, in scenes of uniform layout."""
    return episodes.loc[(episodes["object_size"] == "mixed") & (episodes["layout"] == "uniform")]


def without_noise(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes in which the planner's model is exact."""
    return episodes.loc[episodes["noise_level"] == "none"]


def random_num_objects(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes whose number of objects was drawn at random (Sec. 8.1), or all if there are none."""
    random = episodes["scene_num_objects"].astype(str).str.contains("-")
    return episodes.loc[random] if random.any() else episodes


def main_rows(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes of the headline numbers: mixed sizes, no noise, a random number of objects where there is one."""
    rows = without_noise(mixed_sizes(episodes))
    return random_num_objects(rows if len(rows) else episodes)


# -------------------------------------------------------------------------------------------------------------- tables
def summary_tables(episodes: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Tables of metrics by name; the column ``label`` ("VisualRHP 3x3, continuous") identifies a line of a plot.

    They are ``summary`` (:func:`main_rows`), ``by_num_objects``, ``by_size``, ``by_noise``, ``failures``
    (:func:`failure_counts`), and ``paired``, comparisons with methods that search
    (:func:`visualrhp.evaluation.paired.paired_table`), if any was evaluated.
    """

    def by(rows: pd.DataFrame, *keys: str) -> pd.DataFrame:
        labelled = with_labels(rows)
        labelled = labelled.assign(label=labelled["method"] + ", " + labelled["action_space"])
        return summarize(labelled, ["label", *keys])

    paired = paired_table(episodes)
    return {
        "summary": by(main_rows(episodes)),
        "by_num_objects": by(mixed_sizes(without_noise(episodes)), "num_objects"),
        "by_size": by(without_noise(episodes), "object_size", "layout", "scene_num_objects"),
        "by_noise": by(mixed_sizes(episodes), "noise_level", "num_objects"),
        "failures": failure_counts(episodes),
        **({"paired": paired} if len(paired) else {}),
    }


def failure_counts(episodes: pd.DataFrame) -> pd.DataFrame:
    """How often each method failed, by action space, number of objects, noise and kind of failure.

    Columns: ``action_space``, ``method``, ``num_objects``, ``noise_level``, ``episodes`` (all), and one per kind of
    :class:`~visualrhp.evaluation.failures.Failure`.
    """
    keys = ["action_space", "method", "num_objects", "noise_level"]
    rows = mixed_sizes(with_labels(episodes))
    counts: dict[str, Any] = {"episodes": rows.groupby(keys).size()}
    for kind in Failure:
        if kind is not Failure.NONE:
            counts[kind.value] = rows["failure"].eq(kind.value).groupby([rows[key] for key in keys]).sum()
    return pd.DataFrame(counts).reset_index()


def metrics_by_method(episodes: pd.DataFrame) -> dict[str, dict[str, Metrics]]:
    """action space -> method -> metric -> value, over :func:`main_rows`; metrics without a value are left out."""
    metrics: dict[str, dict[str, Metrics]] = {}
    for row in summarize(with_labels(main_rows(episodes)), ["action_space", "method"]).to_dict("records"):
        numbers = {
            str(key): round(float(value), 6)
            for key, value in row.items()
            if key not in ("action_space", "method") and not math.isnan(value)
        }
        metrics.setdefault(row["action_space"], {})[row["method"]] = numbers
    return metrics


@dataclass(frozen=True, slots=True)
class CellSummary:
    """Results of a method in a setting.

    Attributes:
        name: of both: "VisualRHP+ 3x3, continuous, 7 objects, noise high".
        setting: what tells it from others, by name.
        metrics: with the bounds of their intervals; counts of failures are ``failures/<kind>``.
    """

    name: str
    setting: dict[str, Any]
    metrics: Metrics


def cell_summaries(episodes: pd.DataFrame) -> Iterator[CellSummary]:
    """Summarize each method in each setting, in the order of legends."""
    labelled = with_labels(episodes)
    order = order_methods(labelled["method"].tolist())
    keys = ["action_space", "method", "planner", "scene_num_objects", "object_size", "layout", "noise_level", "seed"]
    cells: Any = labelled.groupby(keys, sort=False)
    for key, rows in sorted(cells, key=lambda cell: (ACTION_SPACES.index(cell[0][0]), order.index(cell[0][1]))):
        setting = dict(zip(keys, key, strict=True))
        num_objects = setting["scene_num_objects"]
        parts = [
            setting["method"],
            setting["action_space"],
            f"{num_objects.replace('-', ' to ')} object{'' if num_objects == '1' else 's'}",
            *([setting["object_size"]] if setting["object_size"] != "mixed" else []),
            *([setting["layout"].replace("_", " ")] if setting["layout"] != "uniform" else []),
            *([f"noise {setting['noise_level']}"] if setting["noise_level"] != "none" else []),
        ]
        failures = rows.loc[~rows["success"], "failure"].value_counts()
        metrics = _numbers(rows) | {f"failures/{kind}": float(count) for kind, count in failures.items()}
        yield CellSummary(", ".join(parts), setting | {"num_episodes": len(rows)}, metrics)


def _numbers(episodes: pd.DataFrame) -> Metrics:
    """The metrics and the bounds of their intervals by name, those that are not a number left out."""
    numbers = {}
    for name, estimate in evaluation_metrics(episodes).items():
        named = {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
        numbers |= {key: value for key, value in named.items() if not math.isnan(value)}
    return numbers


# --------------------------------------------------------------------------------------------------------------- words
def summary_lines(episodes: pd.DataFrame, num_settings: int) -> str:
    """The metrics of every method as a few lines of text."""
    lines = [
        f"{len(episodes)} episodes in {num_settings} settings. Success rate [90% interval], action efficiency, time:"
    ]
    for row in summarize(with_labels(main_rows(episodes)), ["action_space", "method"]).to_dict("records"):
        lines.append(
            f"  {row['action_space']:<11} {row['method']:<24} {percent(row['success_rate']):>5} "
            f"[{percent(row['success_rate_low'])}, {percent(row['success_rate_high'])}]  "
            f"{row['action_efficiency']:.2f}  {duration(row['execution_time_s'])}  ({row['episodes']} episodes)"
        )
    return "\n".join(lines)


def percent(value: float, digits: int = 0) -> str:
    """A rate in per cent, or a dash for a missing one; one more digit where 0% or 100% would not be the whole truth."""
    if pd.isna(value):
        return "–"
    text = f"{100.0 * value:.{digits}f}"
    rounded = float(text) in (0.0, 100.0) and 100.0 * value != float(text)
    return f"{100.0 * value:.{digits + 1}f}%" if rounded else f"{text}%"


def duration(seconds: float) -> str:
    """A duration in a suitable unit, or a dash for a missing one."""
    if pd.isna(seconds):
        return "–"
    if seconds < 1.0:
        return f"{1e3 * seconds:.3g} ms"
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"
