"""Summaries of the history of a training: one row of metrics per epoch or iteration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from visualrhp.types import Metrics

_REPORTED = ("success_rate", "dropped_rate", "action_efficiency", "num_actions")


def imitation_summary(history: Sequence[Metrics]) -> dict[str, Any]:
    """The metrics of the last epoch by group, without times."""
    last = history[-1]
    metrics: dict[str, Any] = {"epochs": int(last["epoch"])}
    for group in ("train", "validation", "greedy"):
        prefix = f"{group}/"
        rows = {name.removeprefix(prefix): value for name, value in last.items() if name.startswith(prefix)}
        if rows:
            metrics[group] = {name: value for name, value in rows.items() if not name.endswith("_time_s")}
    return metrics


def expert_iteration_summary(history: Sequence[Metrics], best_round: int) -> dict[str, Any]:
    """Validation of the initial, best and last network, of the planner and of the greedy policy."""
    metrics: dict[str, Any] = {"rounds": int(history[-1]["round"]), "best_round": best_round}
    for name, row in (("initial", history[0]), ("best", history[best_round]), ("last", history[-1])):
        metrics[name] = {
            group: {key.removeprefix(f"{group}/"): value for key, value in row.items() if key.startswith(f"{group}/")}
            for group in ("validation", "greedy")
        }
    return metrics


def reinforcement_summary(history: Sequence[Metrics], best_iteration: int) -> dict[str, Any]:
    """Greedy performance of the initial, best and last network, and the number of transitions; without times."""
    evaluated = [row for row in history if "greedy/success_rate" in row]
    metrics: dict[str, Any] = {"iterations": int(history[-1]["iteration"])}
    if evaluated:
        best = next(row for row in evaluated if row["iteration"] == best_iteration)
        metrics["best_iteration"] = best_iteration
        for name, row in (("initial", evaluated[0]), ("best", best), ("last", evaluated[-1])):
            metrics[name] = {key: row[f"greedy/{key}"] for key in _REPORTED if f"greedy/{key}" in row}
    if "collection/transitions" in history[-1]:
        metrics["transitions"] = int(history[-1]["collection/transitions"])
    return metrics
