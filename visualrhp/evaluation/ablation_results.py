"""Results of an ablation as a Markdown document: every number is computed from the table of episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from visualrhp.evaluation.claim_findings import claims_table, num_comparisons
from visualrhp.evaluation.failures import Failure
from visualrhp.evaluation.methods import NOISE_ORDER, order_methods, with_labels
from visualrhp.evaluation.metrics import summarize
from visualrhp.evaluation.paired import paired_table
from visualrhp.evaluation.report_figures import NamedFigure
from visualrhp.evaluation.report_tables import decision_time
from visualrhp.evaluation.summaries import duration, failure_counts, main_rows, mixed_sizes, percent

SEARCHES_AGAIN: Final = ("K.RRT closed loop", "dhRRT")
"""Methods with which others are compared in pairs."""

RACERS: Final = ("VisualRHP+ 3x3", "Greedy", "K.RRT")
"""Methods that are shown side by side."""

_CELL: Final = ("method", "action_space", "scene_num_objects", "object_size", "layout", "noise_level")


def results_document(
    episodes: pd.DataFrame, figures: Sequence[NamedFigure], facts: Mapping[str, str], commands: Sequence[str]
) -> str:
    """The document.

    Args:
        episodes: the table of episodes.
        figures: in files of their stems, ``.svg``, beside the document.
        facts: of the runs: commit, seed, machine and so on.
        commands: that made the artefacts.
    """
    sections: list[tuple[str, str, pd.DataFrame]] = [
        (
            "Main comparison",
            "Objects of mixed size, 1 to 7 of them, no noise. 90% intervals: Wilson's for rates, bootstrap for means.",
            main_table(episodes),
        ),
        *(
            (
                f"Success by number of objects, {actions} actions, noise {noise}",
                "Objects of mixed size; half the width of the 90% interval is at most 5 points at 300 runs.",
                density_table(episodes, actions, noise),
            )
            for actions in ("continuous", "discrete")
            for noise in NOISE_ORDER
        ),
        (
            "Compared with searching again in every state",
            "On the same tasks, mixed sizes. Differences of the success rate (points) and of the actions of tasks that "
            "both completed, with 90% intervals; p of McNemar's exact test and of Wilcoxon's signed-rank test, not "
            "corrected for the number of tests.",
            pairs_table(episodes),
        ),
        (
            "Claims of the paper",
            f"{num_comparisons()} comparisons, 90% intervals, not corrected for their number. Differences of the "
            "success rate are in points. A claim holds if all of its comparisons hold.",
            claims_table(episodes),
        ),
        (
            "Why episodes fail",
            "Objects of mixed size, all numbers of objects and levels of noise; kinds are defined in "
            "`visualrhp/evaluation/failures.py`.",
            failures_table(episodes),
        ),
    ]
    parts = ["# Results of the ablation", "\n".join(f"- {name}: {value}" for name, value in facts.items())]
    parts += ["```bash\n" + "\n".join(commands) + "\n```"]
    for title, caption, table in sections[:1]:
        parts += _section(title, caption, table)
    for figure in figures:
        parts += [f"![{figure.name}]({figure.stem}.svg)", f"*{figure.name}. {figure.caption}*"]
    for title, caption, table in sections[1:]:
        parts += _section(title, caption, table)
    if films := film_list(episodes):
        parts += ["Films of the commonest of each kind, where it fails the same way when it is run again:", films]
    return "\n\n".join(parts) + "\n"


def _section(title: str, caption: str, table: pd.DataFrame) -> list[str]:
    if table.empty:
        return []
    return [f"## {title}", caption, str(table.to_markdown(index=False, disable_numparse=True))]


def main_table(episodes: pd.DataFrame) -> pd.DataFrame:
    """A line per method and action space over the headline rows."""
    rows = with_labels(main_rows(episodes))
    times = {key: decision_time(group) for key, group in rows.groupby(["method", "action_space"])}
    slowest: dict[Any, float] = rows.groupby(["method", "action_space"])["max_decision_time_s"].quantile(0.95).to_dict()
    lines = []
    for summary in _in_order(summarize(rows, ["method", "action_space"])):
        key = summary["method"], summary["action_space"]
        lines.append(
            {
                "method": summary["method"],
                "actions": summary["action_space"],
                "runs": summary["episodes"],
                "success": _rate(summary, "success_rate"),
                "objects per action": _interval(summary, "action_efficiency", 2),
                "actions per run": _interval(summary, "num_actions", 1),
                "dropped": percent(summary["drop_rate"], 1),
                "time per run": duration(summary["execution_time_s"]),
                "per decision": duration(times[key]),
                "slowest decision (95%)": duration(slowest[key]),
            }
        )
    return pd.DataFrame(lines)


def density_table(episodes: pd.DataFrame, action_space: str, noise_level: str) -> pd.DataFrame:
    """Success rates: a line per method, a column per number of objects that was requested."""
    rows = with_labels(mixed_sizes(episodes))
    rows = rows.loc[(rows["action_space"] == action_space) & (rows["noise_level"] == noise_level)]
    rows = rows.loc[rows["scene_num_objects"].str.isdecimal()]
    if rows.empty:
        return pd.DataFrame()
    rates = rows.groupby(["method", "num_objects"])["success"].mean().unstack()
    lines = []
    for method in order_methods([str(name) for name in rates.index]):
        cells = {str(m): "–" if pd.isna(rate) else percent(rate, 1) for m, rate in rates.loc[method].items()}
        lines.append({"method": method, **cells})
    return pd.DataFrame(lines)


def pairs_table(episodes: pd.DataFrame) -> pd.DataFrame:
    """Every method against those that search again, without noise and with the most."""
    table = paired_table(mixed_sizes(episodes), SEARCHES_AGAIN)
    table = table.loc[table["noise_level"].isin([NOISE_ORDER[0], NOISE_ORDER[-1]])]
    lines = []
    for row in table.to_dict("records"):
        success, actions = (
            f"{scale * row[f'{name}_difference']:+.1f} ({scale * row[f'{name}_difference_low']:+.1f} to "
            f"{scale * row[f'{name}_difference_high']:+.1f})"
            for name, scale in (("success", 100.0), ("actions", 1.0))
        )
        lines.append(
            {
                "method": row["method"],
                "against": row["reference"],
                "actions": row["action_space"],
                "objects": row["scene_num_objects"],
                "noise": row["noise_level"],
                "tasks": row["tasks"],
                "success, points": success,
                "p": f"{row['success_p']:.2g}",
                "actions per run": actions,
                "p (actions)": f"{row['actions_p']:.2g}",
            }
        )
    return pd.DataFrame(lines)


def failures_table(episodes: pd.DataFrame) -> pd.DataFrame:
    """A line per method and action space: failures by kind, of all its episodes."""
    counts = failure_counts(episodes)
    kinds = [kind.value for kind in Failure if kind is not Failure.NONE and np.any(counts[kind.value])]
    groups: Any = counts.groupby(["method", "action_space"])
    table = groups[["episodes", *kinds]].sum().reset_index()
    lines = [
        {"method": row["method"], "actions": row["action_space"], **{name: row[name] for name in ("episodes", *kinds)}}
        for row in _in_order(table)
    ]
    return pd.DataFrame(lines)


def commonest_failures(episodes: pd.DataFrame) -> dict[Failure, dict[str, Any]]:
    """For each kind of failure, the row of its first episode in the cell where it is commonest.

    Cells of planners with a deadline are left out, since they do not fail the same way again.
    """
    labelled = with_labels(episodes)
    repeatable = labelled.loc[~labelled["planner"].str.contains(" in ")]
    found: dict[Failure, dict[str, Any]] = {}
    for kind in Failure:
        rows = repeatable.loc[repeatable["failure"] == kind.value]
        if kind is Failure.NONE or rows.empty:
            continue
        counts = rows.groupby(list(_CELL), sort=True).size()
        chosen: Any = counts.index[int(np.argmax(counts))]
        cell = rows.loc[np.logical_and.reduce([rows[name] == value for name, value in zip(_CELL, chosen, strict=True)])]
        found[kind] = _row(cell.iloc[0].to_dict())
    return found


def race(episodes: pd.DataFrame) -> list[dict[str, Any]]:
    """The rows of :data:`RACERS` on one hard task that the first one completed and the others did not.

    Seven objects, high noise, continuous actions; empty if there is no such task.
    """
    rows = with_labels(mixed_sizes(episodes))
    rows = rows.loc[(rows["scene_num_objects"] == "7") & (rows["noise_level"] == "high")]
    rows = rows.loc[(rows["action_space"] == "continuous") & rows["method"].isin(RACERS)]
    by_task = rows.pivot_table(index="episode", columns="method", values="success", aggfunc="first")
    if set(by_task.columns) != set(RACERS):
        return []
    first, *others = (by_task[name].fillna(value=False).astype(bool) for name in RACERS)
    hard = by_task.index[np.logical_and.reduce([first, *(~other for other in others)])]
    if not len(hard):
        return []
    chosen = rows.loc[rows["episode"] == hard[0]].set_index("method")
    return [_row({"method": name, **chosen.loc[name].to_dict()}) for name in RACERS]


def film_list(episodes: pd.DataFrame) -> str:
    """Links to the films of :func:`commonest_failures`, one line each."""
    lines = []
    for kind, row in commonest_failures(episodes).items():
        noise = "" if row["noise_level"] == "none" else f", noise {row['noise_level']}"
        lines.append(
            f"- [{kind.value}]({film_name(kind)}): {row['method']}, {row['action_space']} actions, "
            f"{row['num_objects']} objects{noise}, task {row['episode']}"
        )
    return "\n".join(lines)


def film_name(kind: Failure) -> str:
    """Name of the file of a film of :func:`commonest_failures`."""
    return f"{kind.value.replace(' ', '_')}.webm"


def _row(values: Mapping[Any, Any]) -> dict[str, Any]:
    return {str(name): value for name, value in values.items()}


def _in_order(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows with the columns ``method`` and ``action_space``, in the order of legends."""
    rows: list[dict[str, Any]] = [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]
    order = order_methods([row["method"] for row in rows])
    return sorted(rows, key=lambda row: (order.index(row["method"]), row["action_space"]))


def _rate(row: Mapping[str, Any], name: str) -> str:
    return f"{percent(row[name], 1)} ({percent(row[f'{name}_low'], 1)} to {percent(row[f'{name}_high'], 1)})"


def _interval(row: Mapping[str, Any], name: str, digits: int) -> str:
    if pd.isna(row[name]):
        return "–"
    value, low, high = (f"{row[f'{name}{end}']:.{digits}f}" for end in ("", "_low", "_high"))
    return value if pd.isna(row[f"{name}_low"]) else f"{value} ({low} to {high})"
