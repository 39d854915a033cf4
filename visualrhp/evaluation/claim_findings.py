"""What a table of episodes says about the claims of the paper.

Every comparison has an effect with a 90% interval and a verdict. A claim holds if all of its comparisons hold, and does
not hold if one of them does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
import pandas as pd

from visualrhp.evaluation.claims import CLAIMS, Cell, Claim, Comparison, Metric
from visualrhp.evaluation.methods import with_labels
from visualrhp.evaluation.metrics import Estimate, bootstrap_interval, wilson_interval
from visualrhp.evaluation.paired import paired_difference
from visualrhp.evaluation.summaries import percent

MARGINS: Final[dict[Metric, float]] = {"success": 0.05, "efficiency": 0.05, "time": 0.1}
"""Effects that are smaller count as none: of a success rate, of an action efficiency, of the logarithm of a time."""

HIGH_RATE: Final = 0.9
"""A success rate of at least this much is high."""


class Verdict(StrEnum):
    """What the episodes say about a claim."""

    HOLDS = "holds"
    FAILS = "does not hold"
    OPEN = "not decidable"


@dataclass(frozen=True, slots=True)
class Finding:
    """A comparison in a table of episodes: its effect, and the verdict; NaN without episodes."""

    comparison: Comparison
    effect: Estimate
    verdict: Verdict


def findings(episodes: pd.DataFrame, claim: Claim) -> list[Finding]:
    """The comparisons of a claim in a table of episodes."""
    labelled = with_labels(episodes)
    return [_finding(labelled, comparison) for comparison in claim.comparisons]


def verdict_of(found: Sequence[Finding]) -> Verdict:
    """The verdict on a claim with these comparisons."""
    verdicts = {finding.verdict for finding in found}
    if Verdict.FAILS in verdicts:
        return Verdict.FAILS
    return Verdict.HOLDS if verdicts == {Verdict.HOLDS} else Verdict.OPEN


def _finding(labelled: pd.DataFrame, comparison: Comparison) -> Finding:
    one = comparison.one.rows(labelled)
    if comparison.other is None:
        rate = wilson_interval(int(np.count_nonzero(one["success"])), len(one))
        return Finding(comparison, rate, _verdict(comparison, rate, HIGH_RATE))
    effect = _difference(one, comparison.other.rows(labelled), comparison.metric)
    if comparison.minus is not None:
        first, second = (cell.rows(labelled) for cell in comparison.minus)
        of_others = _difference(first, second, comparison.metric)
        effect = _minus(effect, of_others)
    return Finding(comparison, effect, _verdict(comparison, effect, 0.0))


def _difference(one: pd.DataFrame, other: pd.DataFrame, metric: Metric) -> Estimate:
    """Mean of ``one`` minus that of ``other`` over the task instances that both have.

    Instances with the same index in settings with other scenes are independent, which the intervals allow.
    """
    pair = one.join(other.add_suffix("_reference"), how="inner")
    if pair.empty:
        return Estimate(math.nan, math.nan, math.nan, 0)
    if metric == "success":
        found = paired_difference(pair)
        value, low, high = (found[f"success_difference{end}"] for end in ("", "_low", "_high"))
        return Estimate(value, low, high, len(pair))
    column = "action_efficiency" if metric == "efficiency" else "execution_time_s"
    values = [np.asarray(pair[name], dtype=np.float64) for name in (column, f"{column}_reference")]
    if metric == "time":
        values = [np.log(value) for value in values]
    return bootstrap_interval(values[0] - values[1])  # of completed tasks only, where there is no efficiency otherwise


def _minus(one: Estimate, other: Estimate) -> Estimate:
    """The difference of two independent estimates, with a normal interval."""
    value = one.value - other.value
    half = math.hypot((one.high - one.low) / 2.0, (other.high - other.low) / 2.0)
    return Estimate(value, value - half, value + half, min(one.count, other.count))


def _verdict(comparison: Comparison, effect: Estimate, reference: float) -> Verdict:
    if effect.count == 0 or math.isnan(effect.low):
        return Verdict.OPEN
    low, high = effect.low - reference, effect.high - reference
    margin = MARGINS[comparison.metric]
    is_none = -margin <= low and high <= margin
    if comparison.relation == "same":
        return Verdict.HOLDS if is_none else Verdict.FAILS if low > 0.0 or high < 0.0 else Verdict.OPEN
    if comparison.relation == "less":
        low, high = -high, -low
    if low > 0.0:
        return Verdict.HOLDS
    return Verdict.FAILS if high < 0.0 or (is_none and comparison.other is not None) else Verdict.OPEN


# ------------------------------------------------------------------------------------------------------------ in words
def claims_table(episodes: pd.DataFrame) -> pd.DataFrame:
    """A row per claim: ``claim``, ``paper``, ``found`` (the comparisons with numbers), ``verdict``."""
    rows = []
    for claim in CLAIMS:
        found = findings(episodes, claim)
        parts = [*(_words(finding) for finding in found), *([claim.remark] if claim.remark else [])]
        rows.append(
            {
                "claim": claim.words,
                "paper": claim.place,
                "found": "<br>".join(parts),
                "verdict": verdict_of(found).value,
            }
        )
    return pd.DataFrame(rows)


def _words(finding: Finding) -> str:
    """A comparison with its numbers."""
    comparison, effect = finding.comparison, finding.effect
    one, other = comparison.one, comparison.other
    if effect.count == 0:
        numbers = "no episodes"
    elif math.isnan(effect.low):
        numbers = "too few episodes"
    elif other is None:
        numbers = f"{percent(effect.value)} ({percent(effect.low)} to {percent(effect.high)})"
    elif comparison.metric == "time":
        ratio, low, high = (f"{math.exp(value):.2f}" for value in (effect.value, effect.low, effect.high))
        numbers = f"{ratio} times ({low} to {high})"
    else:
        scale, digits, unit = (100.0, 1, " points") if comparison.metric == "success" else (1.0, 2, "")
        value, low, high = (f"{scale * value:+.{digits}f}" for value in (effect.value, effect.low, effect.high))
        numbers = f"{value}{unit} ({low} to {high})"
    what = _name(one) if other is None else f"{_name(one)} against {_name(other, one)}"
    if comparison.minus is not None:
        what += f", compared with {_name(comparison.minus[0], one)} against {_name(comparison.minus[1], one)}"
    return f"{what}: {numbers}, {finding.verdict.value}"


def _name(cell: Cell, known: Cell | None = None) -> str:
    """A cell in words, without what ``known`` has said."""
    parts = [cell.method] if known is None or cell.method != known.method else []
    if known is None or cell.action_space != known.action_space:
        parts.append(cell.action_space)
    if cell.objects != (known.objects if known else "1-7"):
        parts.append(f"{cell.objects} object{'' if cell.objects == '1' else 's'}")
    if cell.size != (known.size if known else "mixed"):
        parts.append(cell.size)
    if cell.noise != (known.noise if known else "none"):
        parts.append(f"noise {cell.noise}")
    return " ".join(parts)


def num_comparisons() -> int:
    """Number of comparisons in all claims."""
    return sum(len(claim.comparisons) for claim in CLAIMS)
