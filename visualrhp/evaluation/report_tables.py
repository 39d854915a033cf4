"""Tables of results as the report shows them: rows of formatted numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from visualrhp.evaluation.methods import ACTION_SPACES, NOISE_ORDER, SIZES, order_methods, with_labels
from visualrhp.evaluation.metrics import summarize
from visualrhp.evaluation.paired import paired_table
from visualrhp.evaluation.summaries import duration, main_rows, mixed_sizes, percent, without_noise


def main_table(episodes: pd.DataFrame) -> dict[str, Any]:
    """The headline table, for the template."""
    return results_table(main_rows(episodes), {"method": "Method", "action_space": "Actions"}, "", "")


def detail_tables(episodes: pd.DataFrame) -> dict[str, list[dict[str, Any]]]:
    """By section of the report: the tables below its figures, for the template."""
    noiseless = without_noise(episodes)
    environments = [
        results_table(
            mixed_sizes(noiseless),
            {"method": "Method", "action_space": "Actions", "num_objects": "Objects"},
            "By number of objects",
            "Objects of mixed size, no noise.",
        )
    ]
    if len(set(noiseless["object_size"])) > 1:
        environments.append(
            results_table(
                noiseless,
                {"method": "Method", "action_space": "Actions", "object_size": "Size"},
                "By object size",
                "All evaluated numbers of objects, no noise.",
            )
        )
    robustness = results_table(
        mixed_sizes(episodes),
        {"method": "Method", "action_space": "Actions", "noise_level": "Noise"},
        "By noise level",
        "Objects of mixed size, all evaluated numbers of objects.",
    )
    return {"environments": environments, "robustness": [robustness]}


def results_table(episodes: pd.DataFrame, by: Mapping[str, str], title: str, caption: str) -> dict[str, Any]:
    """A table of metrics: methods, noise levels and sizes in their order.

    Args:
        episodes: to summarize.
        by: columns that form a group -> their headings.
        title: of the table.
        caption: of the table.
    """
    labelled = with_labels(episodes)
    methods = order_methods(labelled["method"].tolist())
    order = {
        "method": methods,
        "action_space": list(ACTION_SPACES),
        "object_size": list(SIZES),
        "noise_level": list(NOISE_ORDER),
    }

    def rank(row: dict[Any, Any]) -> tuple[Any, ...]:
        return tuple(order[key].index(row[key]) if key in order else row[key] for key in by)

    decision_times: dict[Any, float] = {key: decision_time(group) for key, group in labelled.groupby(list(by))}
    rows = []
    previous = None
    for row in sorted(summarize(labelled, list(by)).to_dict("records"), key=rank):
        low, high = row["success_rate_low"], row["success_rate_high"]
        group = row["method"]
        rows.append(
            {
                "labels": [str(row[key]) for key in by],
                "starts_group": previous is not None and group != previous,
                "success": percent(row["success_rate"]),
                "success_range": f"{100 * low:.0f}–{100 * high:.0f}",
                "success_percent": round(100 * row["success_rate"], 1),
                "low_percent": round(100 * low, 1),
                "width_percent": round(100 * (high - low), 1),
                "efficiency": number(row["action_efficiency"]),
                "efficiency_range": _range(row, "action_efficiency", number),
                "time": duration(row["execution_time_s"]),
                "time_range": _range(row, "execution_time_s", duration),
                "decision": duration(decision_times[tuple(row[key] for key in by)]),
                "dropped": percent(row["drop_rate"]),
                "episodes": row["episodes"],
            }
        )
        previous = group
    return {"title": title, "caption": caption, "headings": list(by.values()), "rows": rows}


def paired_rows(episodes: pd.DataFrame) -> list[dict[str, str]]:
    """The comparisons of :func:`visualrhp.evaluation.paired.paired_table` with closed-loop searches, formatted.

    Objects of mixed size only.
    """

    def signed(value: float, digits: int) -> str:
        return "–" if pd.isna(value) else f"{round(value, digits) + 0.0:+.{digits}f}".replace("-", "−")

    def p_value(value: float) -> str:
        return "< 0.001" if value < 1e-3 else f"{value:.3f}"

    def between(row: Mapping[Any, Any], name: str, scale: float) -> str:
        return " to ".join(signed(scale * row[f"{name}_difference_{end}"], 1) for end in ("low", "high"))

    table = paired_table(mixed_sizes(episodes), ("K.RRT closed loop", "dhRRT"))
    return [
        {
            **{name: str(row[name]) for name in ("method", "reference", "action_space", "noise_level", "tasks")},
            "num_objects": str(row["scene_num_objects"]).replace("-", " to "),
            "success": f"{signed(100 * row['success_difference'], 1)}%",
            "success_range": between(row, "success", 100.0),
            "success_p": p_value(row["success_p"]),
            "actions": signed(row["actions_difference"], 1),
            "actions_range": between(row, "actions", 1.0),
            "actions_p": p_value(row["actions_p"]),
            "slowest": duration(row["slowest_decision_s"]),
            "reference_slowest": duration(row["reference_slowest_decision_s"]),
        }
        for row in table.to_dict("records")
    ]


def decision_time(episodes: pd.DataFrame) -> float:
    """Mean wall-clock time per action [s]."""
    return float(np.sum(episodes["decision_time_s"])) / max(1, int(np.sum(episodes["num_actions"])))


def number(value: float) -> str:
    """A number with two digits after the point, or a dash for a missing one."""
    return "–" if pd.isna(value) else f"{value:.2f}"


def _range(row: Mapping[Any, Any], name: str, write: Callable[[float], str]) -> str:
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    if pd.isna(low) or pd.isna(high):
        return ""
    first, last = write(max(0.0, low)), write(high)
    unit = last.partition(" ")[2]  # a unit that both have is written once
    return f"{first.removesuffix(f' {unit}') if unit else first}–{last}"
