"""Results of a search for weights: a table of its trials, and their summaries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from visualrhp.evaluation.behaviour import FROM_BEHIND
from visualrhp.evaluation.metrics import wilson_interval
from visualrhp.evaluation.weight_search import SearchResult, TrialEpisode, TrialRecord


def space_metrics(episodes: Sequence[TrialEpisode]) -> dict[str, float | None]:
    """Success rate with its 90% interval, drop rate, mean actions (of completed episodes), share of pushes from behind.

    The last two are None if there is nothing to take the mean of.
    """
    rate = wilson_interval(sum(episode.success for episode in episodes), len(episodes))
    actions = [episode.num_actions for episode in episodes if episode.success]
    angles = [angle for episode in episodes for angle in episode.push_angles]
    return {
        "success_rate": rate.value,
        "success_rate_low": rate.low,
        "success_rate_high": rate.high,
        "drop_rate": sum(episode.dropped for episode in episodes) / len(episodes),
        "actions": sum(actions) / len(actions) if actions else None,
        "from_behind": sum(angle < FROM_BEHIND for angle in angles) / len(angles) if angles else None,
    }


def trials_table(records: Sequence[TrialRecord], action_spaces: Sequence[str]) -> pd.DataFrame:
    """One row per record.

    Columns: step, trial, the weights, is_pruned, num_instances (per action space), objective, and for each action space
    those of :func:`space_metrics` with its name as a suffix.
    """
    rows = []
    for record in records:
        row: dict[str, Any] = {"step": record.step, "trial": record.trial, **record.weights}
        row |= {"is_pruned": record.is_pruned, "num_instances": record.num_instances, "objective": record.objective}
        for space in action_spaces:
            metrics = space_metrics(record.episodes[space])
            row |= {f"{name}_{space}": value for name, value in metrics.items() if not name.endswith(("_low", "_high"))}
        rows.append(row)
    return pd.DataFrame(rows)


def record_summary(record: TrialRecord) -> dict[str, Any]:
    """Objective, number of instances and :func:`space_metrics` of a record, as JSON."""
    return {
        "objective": record.objective,
        "num_instances": record.num_instances,
        "by_action_space": {space: space_metrics(episodes) for space, episodes in record.episodes.items()},
    }


def result_card(result: SearchResult) -> dict[str, Any]:
    """The result of a search, as JSON."""
    return {
        "best": {"trial": result.best.trial, "weights": result.weights},
        "num_trials": len(result.searched),
        "num_pruned": sum(record.is_pruned for record in result.searched),
        "num_episodes": sum(len(episodes) for record in result.records for episodes in record.episodes.values()),
        "results": {
            step: {str(record.trial): record_summary(record) for record in records}
            for step, records in (("selection", result.selected), ("check", result.checked))
        },
    }


def heuristic_yaml(result: SearchResult) -> str:
    """The heuristic with the best weights, in the form of ``conf/planner/crafted_heuristic_rhp.yaml``."""
    weights = [f"  {name}: {value}" for name, value in result.weights.items()]
    return "\n".join(["heuristic:", "  kind: crafted", *weights]) + "\n"


def check_lines(result: SearchResult) -> str:
    """The outcome of the check as a few lines of text."""
    start, best = result.start_check, result.best_check
    found = ", ".join(f"{name} {value:g}" for name, value in result.weights.items())
    lines = [f"Best: trial {best.trial}: {found}. On {best.num_instances} further instances, first and best weights:"]
    for space in best.episodes:
        for label, record in (("first", start), ("best", best)):
            numbers = space_metrics(record.episodes[space])
            rate, low, high = (numbers[f"success_rate{end}"] or 0.0 for end in ("", "_low", "_high"))
            lines.append(
                f"  {space:<11} {label:<6} {rate:.1%} [{low:.1%}, {high:.1%}]  "
                f"{_or_dash(numbers['actions'], '.1f')} actions  "
                f"{_or_dash(numbers['from_behind'], '.0%')} of pushes from behind"
            )
    return "\n".join(lines)


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
