"""Results of the execution phase: rates, paired comparisons, what each step to the cell costs, and causes of failure.

They are computed from one table of all episodes, :data:`EXECUTION_COLUMNS`. A success is one in truth: the robot saw
the goal reached, and it was.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from visualrhp.documents import FileKind, brief, document
from visualrhp.evaluation.episodes import read_episodes
from visualrhp.evaluation.methods import order_methods, with_labels
from visualrhp.evaluation.metrics import Estimate, wilson_interval
from visualrhp.evaluation.paired import paired_difference
from visualrhp.evaluation.summaries import percent
from visualrhp.files import atomic_path
from visualrhp.types import Outcome

STEPS: Final = {
    "simulator": "the planner's simulator",
    "arm": "and the arm's reach",
    "friction": "and the cell's friction and masses",
    "true_state": "and three dimensions and control: the cell, with the true state",
    "true_masks": "and outlines and tracking: the camera, with the true masks",
    "network": "and segmentation: the camera, with our network",
}
"""From the planner's simulator to the cell, one cause at a time: column ``step`` -> in words."""

EXECUTION_COLUMNS: Final = (
    "method",
    "step",
    "scene_num_objects",
    "seed",
    "episode",
    "num_objects",
    "outcome",
    "num_actions",
    "true_success",
    "true_distance",
    "num_fallen",
    "fault",
    "mean_perception_s",
    "mean_decision_s",
    "max_decision_time_s",
    "commit",
)
"""Of the table of all episodes."""

EXECUTIONS: Final = FileKind(
    "the table of executions of an evaluation (a CSV file)", "make it again with python -m pipelines.evaluate_execution"
)

EXECUTION_CARD: Final = FileKind(
    "the card of an evaluation (a JSON file)", "make it again with python -m pipelines.evaluate_execution"
)


@document
class ExecutionCard:
    """What is read of the card of an evaluation."""

    commit: str | None
    config: dict[str, Any]
    networks: dict[str, str]
    versions: dict[str, str | None]


_CAUSES: Final = {
    "vanished": "stopped: an object was no longer seen",
    "no clear view": "stopped: no clear view",
    "something still moves": "stopped: something went on moving",
    "from its height": "stopped: the gripper was lifted",
    "while the planner decided": "stopped: the scene changed",
    "target": "stopped: the target region was not found",
}
"""Text in a fault -> its cause in words; the first one that fits."""


def read_executions(folder: Path, commit: str | None) -> pd.DataFrame:
    """The episodes of one evaluation as rows of :data:`EXECUTION_COLUMNS`.

    Args:
        folder: made by ``python -m pipelines.evaluate_execution``.
        commit: of the code that ran them.

    Raises:
        DataError: a table is missing or damaged, or the tables do not belong together.
    """
    episodes = with_labels(read_episodes(folder / "episodes.parquet"))
    path = folder / "executions.csv"
    executions = _read_csv(path)
    shared = ["episode", "num_objects", "outcome", "num_actions"]
    if lacking := [name for name in shared if name not in executions.columns]:
        raise EXECUTIONS.damaged(path, f"it lacks the columns {', '.join(lacking)}")
    if not executions[shared].equals(episodes[shared].astype(executions[shared].dtypes)):
        raise EXECUTIONS.damaged(path, "its episodes are not those of episodes.parquet")
    settings = episodes[["method", "scene_num_objects", "seed", "max_decision_time_s"]]
    rows = executions.join(settings).assign(step=episodes["experiment"], commit=commit)
    return rows.reindex(columns=list(EXECUTION_COLUMNS))


def read_rows(path: Path) -> pd.DataFrame:
    """A table of :data:`EXECUTION_COLUMNS` that :func:`write_rows` wrote.

    Raises:
        DataError: it is missing or damaged.
    """
    rows = _read_csv(path)
    if tuple(rows.columns) != EXECUTION_COLUMNS:
        raise EXECUTIONS.damaged(path, f"its columns should be {', '.join(EXECUTION_COLUMNS)}")
    return rows


def _read_csv(path: Path) -> pd.DataFrame:
    EXECUTIONS.require(path)
    try:
        return pd.read_csv(path, dtype={"scene_num_objects": "str", "fault": "str", "commit": "str"})
    except (ValueError, UnicodeError) as error:
        raise EXECUTIONS.unusable(path, f"is not a table ({brief(error)})") from error


def write_rows(path: Path, rows: pd.DataFrame) -> None:
    """Write a table of :data:`EXECUTION_COLUMNS` as CSV, atomically."""
    with atomic_path(path) as temporary:
        rows.to_csv(temporary, index=False, float_format="%.6g")


def is_success(rows: pd.DataFrame) -> npt.NDArray[np.bool_]:
    """Whether the robot saw the goal reached, and it was."""
    return np.asarray(rows["outcome"] == Outcome.SUCCESS.value) & np.asarray(rows["true_success"], dtype=np.bool_)


def cause(outcome: str, true_success: bool, num_fallen: int, fault: str | None) -> str:
    """Why an episode failed, in words; "" if it did not."""
    if outcome == Outcome.SUCCESS:
        return "" if true_success else "seen as a success, but it was none"
    if outcome == Outcome.DROPPED:
        return "an object fell" if num_fallen else "an object was seen to fall, but did not"
    if outcome == Outcome.STOPPED:
        text = "" if fault is None or pd.isna(fault) else fault
        return next((words for part, words in _CAUSES.items() if part in text), "stopped: another fault")
    return outcome


# -------------------------------------------------------------------------------------------------------------- tables
def rates_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A line for each method, step and clutter: successes with 90% intervals (Wilson), outcomes, and mean costs."""
    lines = []
    for (clutter, step, method), group in _groups(rows):
        success = is_success(group)
        lines.append(
            {
                "objects": clutter,
                "method": method,
                "world": step,
                "runs": len(group),
                "success": _interval(_rate(group)),
                "as seen": percent(_count(group, Outcome.SUCCESS) / len(group)),
                "dropped": _count(group, Outcome.DROPPED),
                "stopped": _count(group, Outcome.STOPPED, Outcome.UNREACHABLE, Outcome.DIVERGED),
                "gave up": _count(group, Outcome.NO_PLAN, Outcome.PLAN_FAILED),
                "out of actions": _count(group, Outcome.OUT_OF_ACTIONS),
                "actions": _number(_mean(np.asarray(group["num_actions"], float)[success]), 1),
                "perception": _milliseconds(_mean(group["mean_perception_s"])),
                "decision": _milliseconds(_mean(group["mean_decision_s"])),
            }
        )
    return pd.DataFrame(lines)


def pairs_table(rows: pd.DataFrame, method: str) -> pd.DataFrame:
    """``method`` against every other one on the same cells, in the same world: difference and McNemar's exact test."""
    lines = []
    for (clutter, step, other), group in _groups(rows):
        own = rows.loc[(rows["scene_num_objects"] == clutter) & (rows["step"] == step) & (rows["method"] == method)]
        if other != method:
            compared = _compared(own, group)
            if compared is not None:
                lines.append({"objects": clutter, "world": step, "against": other, **compared})
    return pd.DataFrame(lines)


def steps_table(rows: pd.DataFrame, method: str) -> pd.DataFrame:
    """What each step from the planner's simulator to the cell costs ``method``, against the step before."""
    lines = []
    for clutter, group in rows.loc[rows["method"] == method].groupby("scene_num_objects", sort=False):
        before = None
        for step, words in STEPS.items():
            here = group.loc[group["step"] == step]
            if here.empty:
                continue
            compared = _compared(here, before) if before is not None else None
            line = {"objects": clutter, "world": step, "what": words, "success": _interval(_rate(here))}
            lines.append(line | (compared or {"cells": len(here), "difference": "–", "90% interval": "–", "p": "–"}))
            before = here
    return pd.DataFrame(lines)


def causes_table(rows: pd.DataFrame, method: str) -> pd.DataFrame:
    """How often ``method`` failed for which cause: a line for each cause, a column for each clutter and world."""
    own = rows.loc[rows["method"] == method]
    columns = own[["outcome", "true_success", "num_fallen", "fault"]].itertuples(index=False)
    named = own.assign(cause=[cause(*values) for values in columns])
    named = named.loc[named["cause"] != ""]
    counts: dict[str, dict[str, int]] = {}
    for (clutter, step, _), group in _groups(own):
        found = named.loc[named.index.isin(group.index), "cause"].value_counts()
        counts[f"{clutter}, {step}"] = {str(name): int(count) for name, count in found.items()}
    causes = sorted({name for found in counts.values() for name in found})
    table = {name: [found.get(cause, 0) for cause in causes] for name, found in counts.items()}
    return pd.DataFrame({"cause": causes, **table})


def results_document(rows: pd.DataFrame, method: str) -> str:
    """All tables in Markdown."""
    commits = ", ".join(f"`{str(commit)[:7]}`" for commit in rows["commit"].dropna().unique())
    seeds = ", ".join(str(seed) for seed in sorted(rows["seed"].unique()))
    sections = {
        "Success": rates_table(rows),
        f"{method} against other methods": pairs_table(rows, method),
        "From the planner's simulator to the cell": steps_table(rows, method),
        f"Causes of failure of {method}": causes_table(rows, method),
    }
    parts = [
        "# Results of the execution phase",
        "Made by `python -m pipelines.report_execution` from `executions.csv`, one row per episode. "
        f"Seed {seeds}, commit {commits}. A success is one in truth: the robot saw the goal reached, and it was. "
        "Intervals are of 90%; p is of McNemar's exact test, not corrected for the number of tests. Times are means "
        "per action.",
    ]
    for title, table in sections.items():
        if len(table):
            parts += [f"## {title}", str(table.to_markdown(index=False, disable_numparse=True))]
    return "\n\n".join(parts) + "\n"


# ------------------------------------------------------------------------------------------------------------- helpers
def _groups(rows: pd.DataFrame) -> Iterator[tuple[tuple[str, str, str], pd.DataFrame]]:
    """By clutter, step and method, in the order of tables."""
    for clutter in sorted(rows["scene_num_objects"].unique()):
        for step in sorted(rows["step"].unique(), key=_order_of_step):
            group = rows.loc[(rows["scene_num_objects"] == clutter) & (rows["step"] == step)]
            for method in order_methods([str(name) for name in group["method"].unique()]):
                yield (str(clutter), str(step), method), group.loc[group["method"] == method]


def _order_of_step(step: str) -> tuple[int, str]:
    steps = list(STEPS)
    return (len(steps) - steps.index(step) if step in steps else len(steps) + 1), step


def _compared(own: pd.DataFrame, other: pd.DataFrame) -> dict[str, Any] | None:
    """The difference of success on the same cells; None if there are none."""
    pair = _outcomes(own).join(_outcomes(other).add_suffix("_reference"), how="inner")
    if pair.empty:
        return None
    found = paired_difference(pair)
    low, high = (100.0 * found[f"success_difference_{bound}"] for bound in ("low", "high"))
    return {
        "cells": len(pair),
        "difference": f"{100.0 * found['success_difference']:+.0f} points",
        "90% interval": f"{low:+.0f} to {high:+.0f}",
        "p": f"{found['success_p']:.2g}",
    }


def _outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    columns = ["success", "num_actions", "max_decision_time_s"]
    return rows.assign(success=is_success(rows)).set_index(["seed", "episode"]).reindex(columns=columns)


def _rate(rows: pd.DataFrame) -> Estimate:
    return wilson_interval(int(is_success(rows).sum()), len(rows))


def _count(rows: pd.DataFrame, *outcomes: Outcome) -> int:
    return int(np.isin(np.asarray(rows["outcome"], dtype=str), [outcome.value for outcome in outcomes]).sum())


def _mean(values: npt.ArrayLike) -> float:
    """Of the values that are there; NaN without any."""
    numbers = np.asarray(values, dtype=np.float64)
    numbers = numbers[~np.isnan(numbers)]
    return float(numbers.mean()) if numbers.size else math.nan


def _interval(rate: Estimate) -> str:
    return f"{percent(rate.value)} ({percent(rate.low)} to {percent(rate.high)})"


def _number(value: float, digits: int) -> str:
    return "–" if pd.isna(value) else f"{value:.{digits}f}"


def _milliseconds(seconds: float) -> str:
    return "–" if pd.isna(seconds) else f"{1e3 * seconds:.0f} ms"


def joined(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """One table of all episodes, in an order that does not depend on that of the evaluations."""
    keys = ["scene_num_objects", "step", "method", "seed", "episode"]
    return pd.concat(tables, ignore_index=True).sort_values(keys, kind="stable", ignore_index=True)
