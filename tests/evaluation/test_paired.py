"""Paired comparisons: hand-computed counts, statsmodels' numbers, and the choice of pairs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest

from visualrhp.evaluation.paired import compare_methods, paired_difference, paired_table


def table(planner: str, successes: list[bool], actions: list[int], **changes: Any) -> pd.DataFrame:
    count = len(successes)
    columns = {
        "planner": planner,
        "num_rollouts": None,
        "horizon": None,
        "action_space": "continuous",
        "scene_num_objects": "4",
        "object_size": "mixed",
        "layout": "uniform",
        "noise_level": "none",
        "seed": 0,
        "episode": range(count),
        "success": successes,
        "num_actions": actions,
        "max_decision_time_s": np.linspace(0.0, 1.0, count),
    }
    return pd.DataFrame({**columns, **changes})


def test_discordant_pairs_are_counted() -> None:
    """Four tasks: both, own alone twice, the reference alone."""
    own = table("mine", [True, True, True, False], [4, 5, 6, 49])
    other = table("dhRRT", [True, False, False, True], [7, 49, 49, 9], max_decision_time_s=2.0)
    (row,) = paired_table(pd.concat([own, other])).to_dict("records")
    assert (row["method"], row["reference"], row["tasks"]) == ("mine", "dhRRT", 4)
    assert row["success_difference"] == pytest.approx(0.25)
    assert row["success_p"] == pytest.approx(1.0), "2 of 3 discordant pairs"
    assert row["actions_difference"] == pytest.approx(-3.0) and math.isnan(row["actions_difference_low"])
    assert row["slowest_decision_s"] == pytest.approx(0.95) and row["reference_slowest_decision_s"] == 2.0


def test_two_methods_are_compared_over_all_conditions() -> None:
    own = [table("mine", [True, False], [4, 49]), table("mine", [True, True], [5, 5], scene_num_objects="7")]
    other = [table("K.RRT", [True, True], [6, 7]), table("K.RRT", [False, True], [49, 8], scene_num_objects="7")]
    row = compare_methods(pd.concat([*own, *other]), "mine", "K.RRT")
    assert row is not None and (row["tasks"], row["success_difference"], row["actions_difference"]) == (4, 0.0, -2.5)
    assert compare_methods(pd.concat(own), "mine", "K.RRT") is None


def test_the_interval_is_agresti_and_mins_and_the_test_mcnemars() -> None:
    """20 of 100 pairs are in favour, 5 against: with 20.5, 5.5 and 102, 0.1471 +- 1.6449 * 0.0478."""
    own = table("mine", [True] * 50 + [True] * 20 + [False] * 5 + [False] * 25, [5] * 100)
    other = table("K.RRT", [True] * 50 + [False] * 20 + [True] * 5 + [False] * 25, [5] * 100)
    (row,) = paired_table(pd.concat([own, other])).to_dict("records")
    assert row["success_difference_low"] == pytest.approx(15 / 102 - 1.6449 * math.sqrt(26 - 225 / 102) / 102, abs=1e-4)
    assert row["success_difference_high"] == pytest.approx(
        15 / 102 + 1.6449 * math.sqrt(26 - 225 / 102) / 102, abs=1e-4
    )
    assert row["success_p"] == pytest.approx(2 * sum(math.comb(25, k) for k in range(6)) / 2**25)
    assert row["actions_difference"] == 0.0 and row["actions_p"] == 1.0


def test_only_tasks_that_both_were_run_on_are_compared_and_none_twice() -> None:
    own = table("mine", [True, False, True], [4, 49, 6])
    other = table("K.RRT", [True, True], [7, 7])
    elsewhere = table("K.RRT", [True, True], [7, 7], noise_level="high")
    found = paired_table(pd.concat([own, own, other, elsewhere]))
    assert found["tasks"].tolist() == [2]
    assert paired_table(own).empty and "success_p" in paired_table(own).columns


def test_exchanging_the_methods_changes_the_sign() -> None:
    rng = np.random.default_rng(0)
    success, actions = rng.random((2, 60)) < 0.7, rng.integers(3, 20, (2, 60))
    pair = {
        "success": success[0],
        "success_reference": success[1],
        "num_actions": actions[0],
        "num_actions_reference": actions[1],
        "max_decision_time_s": np.zeros(60),
        "max_decision_time_s_reference": np.ones(60),
    }
    swapped = {name: pair[name.removesuffix("_reference") if "_ref" in name else f"{name}_reference"] for name in pair}
    first, second = paired_difference(pd.DataFrame(pair)), paired_difference(pd.DataFrame(swapped))
    for name in ("success", "actions"):
        assert first[f"{name}_difference"] == pytest.approx(-second[f"{name}_difference"])
        assert first[f"{name}_difference_low"] == pytest.approx(-second[f"{name}_difference_high"])
        assert first[f"{name}_p"] == pytest.approx(second[f"{name}_p"])
