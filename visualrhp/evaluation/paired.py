"""Paired comparisons of methods on the same task instances: differences with intervals, and exact tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import stats

from visualrhp.evaluation.methods import METHOD, order_methods, with_labels
from visualrhp.evaluation.metrics import CONFIDENCE, bootstrap_interval

SEARCHES: Final = ("K.RRT closed loop", "dhRRT", "K.RRT")
"""Methods that search for a plan: the references of :func:`paired_table`."""

CONDITION: Final = ("action_space", "scene_num_objects", "object_size", "layout", "noise_level")
"""Columns that together name a condition, under which methods are compared."""

_INSTANCE: Final = ("seed", "episode")

_MOST_EXACT: Final = 10
"""Differences of which the signed-rank test is exact."""


def paired_table(episodes: pd.DataFrame, references: Sequence[str] = SEARCHES) -> pd.DataFrame:
    """Compare every method with each of the ``references`` on the task instances that both were run on.

    Returns:
        One row per condition, method and reference: the columns :data:`CONDITION`, ``method``, ``reference``, ``tasks``
        (their number), and

        - ``success_difference``, ``_low``, ``_high``: difference of the success rates with its interval (Agresti and
          Min, 2005), and ``success_p``, the p value of McNemar's exact test;
        - ``actions_difference``, ``_low``, ``_high``: mean difference of the actions over the tasks that both
          completed, with its bootstrap interval, and ``actions_p``, the p value of Wilcoxon's signed-rank test;
        - ``slowest_decision_s``, ``reference_slowest_decision_s``: 95th percentile over the tasks of the longest time
          that a decision of a task took.
    """
    labelled = with_labels(episodes).drop_duplicates(
        [*METHOD, *CONDITION, *_INSTANCE]
    )  # blocks of a suite may share settings
    rows = []
    for condition, group in labelled.groupby(list(CONDITION), sort=False):
        by_method = {name: rows.set_index(list(_INSTANCE)) for name, rows in group.groupby("method")}
        for reference in (name for name in references if name in by_method):
            for method in order_methods([str(name) for name in by_method if name != reference]):
                other = by_method[reference].add_suffix("_reference")
                pair = by_method[method].join(other, how="inner")
                if len(pair):
                    names: Any = condition
                    key = dict(zip(CONDITION, names, strict=True))
                    rows.append({**key, "method": method, "reference": reference, **paired_difference(pair)})
    return pd.DataFrame(rows, columns=[*CONDITION, "method", "reference", *paired_difference(_NOTHING)])


def compare_methods(episodes: pd.DataFrame, method: str, reference: str) -> dict[str, float] | None:
    """Compare two methods on all task instances that both were run on, whatever their condition.

    Returns:
        See :func:`paired_difference`; None without such instances.
    """
    labelled = with_labels(episodes).drop_duplicates([*METHOD, *CONDITION, *_INSTANCE])
    own, other = (
        labelled.loc[labelled["method"] == name].set_index([*CONDITION, *_INSTANCE]) for name in (method, reference)
    )
    pair = own.join(other.add_suffix("_reference"), how="inner")
    return paired_difference(pair) if len(pair) else None


def paired_difference(pair: pd.DataFrame) -> dict[str, float]:
    """The numbers of a row of :func:`paired_table`.

    Args:
        pair: one row per task instance: ``success``, ``num_actions`` and ``max_decision_time_s`` of a method, and with
            the suffix ``_reference`` of another one.
    """
    own, other = (np.asarray(pair[name], dtype=np.bool_) for name in ("success", "success_reference"))
    only_own, only_other = int((own & ~other).sum()), int((other & ~own).sum())
    discordant = only_own + only_other
    low, high = _agresti_min(only_own, only_other, len(pair))
    both = pair.loc[own & other]
    differences = np.asarray(both["num_actions"], float) - np.asarray(both["num_actions_reference"], float)
    actions = bootstrap_interval(differences)
    # With ties, SciPy enumerates all signs of up to 13 differences, which takes seconds.
    method = "auto" if len(differences) <= _MOST_EXACT else "asymptotic"
    signed_rank: Any = stats.wilcoxon(differences, method=method) if np.any(differences) else None
    return {
        "tasks": len(pair),
        "success_difference": (only_own - only_other) / len(pair) if len(pair) else math.nan,
        "success_difference_low": low,
        "success_difference_high": high,
        "success_p": float(stats.binomtest(only_own, discordant).pvalue) if discordant else 1.0,
        "actions_difference": actions.value,
        "actions_difference_low": actions.low,
        "actions_difference_high": actions.high,
        "actions_p": 1.0 if signed_rank is None else float(signed_rank.pvalue),
        "slowest_decision_s": _percentile(pair["max_decision_time_s"]),
        "reference_slowest_decision_s": _percentile(pair["max_decision_time_s_reference"]),
    }


def _agresti_min(only_own: int, only_other: int, count: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Interval of a difference of paired proportions: Wald's, with half an observation more in each of four cells."""
    if not count:
        return math.nan, math.nan
    b, c, n = only_own + 0.5, only_other + 0.5, count + 2.0
    difference = (b - c) / n
    half = float(stats.norm.ppf(0.5 + confidence / 2.0)) * math.sqrt((b + c) - (b - c) ** 2 / n) / n
    return max(-1.0, difference - half), min(1.0, difference + half)


def _percentile(times: npt.ArrayLike) -> float:
    values = np.asarray(times, dtype=np.float64)
    return float(np.percentile(values, 95.0)) if values.size else math.nan


_COLUMNS = ("success", "num_actions", "max_decision_time_s")
_NOTHING = pd.DataFrame({name + suffix: np.empty(0) for name in _COLUMNS for suffix in ("", "_reference")})
