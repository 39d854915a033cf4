"""Verdicts on claims, from tables in which the truth is known."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
import pandas as pd
import pytest

from tests.evaluation.samples import sample_table
from visualrhp.evaluation.claim_findings import HIGH_RATE, Verdict, claims_table, findings, num_comparisons, verdict_of
from visualrhp.evaluation.claims import CLAIMS, Cell, Claim, Comparison

OURS, GREEDY = Cell("VisualRHP 3x3"), Cell("Greedy")


def rows(cell: Cell, values: Iterable[dict[str, Any]]) -> Iterable[dict[str, Any]]:
    planner = {"VisualRHP 3x3": ("VisualRHP", 3, 3), "Greedy": ("Greedy", None, None)}[cell.method]
    for number, value in enumerate(values):
        yield {
            **dict(zip(("planner", "num_rollouts", "horizon"), planner, strict=True)),
            "action_space": cell.action_space,
            "scene_num_objects": cell.objects,
            "object_size": cell.size,
            "noise_level": cell.noise,
            "episode": number,
            **value,
        }


def successes(cell: Cell, rate: float, count: int = 300) -> list[dict[str, Any]]:
    """Successes spread over the tasks, so that methods do not succeed on the same ones."""
    chosen = np.random.default_rng(abs(hash(cell)) % 1000).permutation(count) < rate * count
    return list(rows(cell, ({"success": bool(success)} for success in chosen)))


def verdict(episodes: pd.DataFrame, comparison: Comparison) -> Verdict:
    return verdict_of(findings(episodes, Claim("a claim", "Sec. 8", (comparison,))))


Relation = Literal["more", "less", "same"]


@pytest.mark.parametrize(
    ("relation", "own", "other", "expected"),
    [
        ("more", 0.95, 0.8, Verdict.HOLDS),
        ("more", 0.8, 0.95, Verdict.FAILS),
        ("less", 0.8, 0.95, Verdict.HOLDS),
        ("less", 0.95, 0.8, Verdict.FAILS),
        ("same", 0.95, 0.8, Verdict.FAILS),
        ("same", 1.0, 1.0, Verdict.HOLDS),
        ("more", 1.0, 1.0, Verdict.FAILS),  # there is no difference that matters
        ("more", 0.7, 0.7, Verdict.OPEN),  # the interval is too wide to say
        ("same", 0.7, 0.7, Verdict.OPEN),
    ],
)
def test_verdicts_on_success(relation: Relation, own: float, other: float, expected: Verdict) -> None:
    episodes = sample_table([*successes(OURS, own), *successes(GREEDY, other)])
    assert verdict(episodes, Comparison(OURS, GREEDY, relation)) is expected


@pytest.mark.parametrize(("rate", "expected"), [(0.99, Verdict.HOLDS), (HIGH_RATE, Verdict.OPEN), (0.8, Verdict.FAILS)])
def test_a_high_rate_is_one_of_which_the_interval_is_high(rate: float, expected: Verdict) -> None:
    assert verdict(sample_table(successes(GREEDY, rate)), Comparison(GREEDY, None)) is expected


def test_efficiency_is_compared_on_tasks_that_both_completed() -> None:
    own = rows(OURS, ({"num_actions": 5} for _ in range(50)))  # 4 objects: 0.8
    other = rows(GREEDY, ({"num_actions": 8, "success": number < 30} for number in range(50)))  # 0.5
    (finding,) = findings(
        sample_table([*own, *other]), Claim("", "", (Comparison(OURS, GREEDY, "more", "efficiency"),))
    )
    assert (finding.effect.value, finding.effect.count) == (pytest.approx(0.3), 30)
    assert finding.verdict is Verdict.HOLDS


def test_times_are_compared_by_their_ratio() -> None:
    times = np.random.default_rng(0).uniform(0.5, 1.5, 80)
    own = rows(OURS, ({"decision_time_s": 2.0 * time, "simulation_time_s": 0.0} for time in times))
    other = rows(GREEDY, ({"decision_time_s": time, "simulation_time_s": 0.0} for time in times))
    episodes = sample_table([*own, *other])
    (finding,) = findings(episodes, Claim("", "", (Comparison(OURS, GREEDY, "more", "time"),)))
    assert finding.effect.value == pytest.approx(math.log(2.0)) and finding.verdict is Verdict.HOLDS


def test_losses_are_compared() -> None:
    """Greedy loses 40 points from one object to seven, VisualRHP 5."""
    cells = [
        (Cell(name, objects=m), rate)
        for name, rates in (("Greedy", (0.9, 0.5)), ("VisualRHP 3x3", (1.0, 0.95)))
        for m, rate in zip(("1", "7"), rates, strict=True)
    ]
    episodes = sample_table([row for cell, rate in cells for row in successes(cell, rate)])
    (one, seven), (our_one, our_seven) = ([cell for cell, _ in cells[start : start + 2]] for start in (0, 2))
    comparison = Comparison(seven, one, "less", minus=(our_seven, our_one))
    (finding,) = findings(episodes, Claim("", "", (comparison,)))
    assert finding.effect.value == pytest.approx(-0.35) and finding.verdict is Verdict.HOLDS
    assert verdict(episodes, Comparison(our_seven, our_one, "less", minus=(seven, one))) is Verdict.FAILS


def test_a_claim_needs_all_of_its_comparisons() -> None:
    episodes = sample_table([*successes(OURS, 0.95), *successes(GREEDY, 0.8)])
    holds, fails, missing = (
        Comparison(OURS, GREEDY),
        Comparison(GREEDY, OURS),
        Comparison(OURS, Cell("Greedy", noise="high")),
    )
    for comparisons, expected in (
        ((holds,), Verdict.HOLDS),
        ((holds, missing), Verdict.OPEN),
        ((holds, missing, fails), Verdict.FAILS),
    ):
        assert verdict_of(findings(episodes, Claim("", "", comparisons))) is expected


def test_the_table_has_every_claim_with_its_numbers() -> None:
    episodes = sample_table([*successes(OURS, 0.95), *successes(GREEDY, 0.8)])
    table = claims_table(episodes)
    assert table["claim"].tolist() == [claim.words for claim in CLAIMS]
    assert sum(found.count(": ") for found in table["found"]) == num_comparisons()
    assert "VisualRHP 3x3 continuous against Greedy: +15.0 points (+" in table["found"][0]
    assert "Greedy continuous 1 object: no episodes, not decidable" in "".join(table["found"])
