"""Metrics and their intervals, by hand and against SciPy."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests.evaluation.samples import sample_result
from visualrhp.errors import ConfigError, DataError
from visualrhp.evaluation.episodes import episode_row
from visualrhp.evaluation.metrics import (
    Estimate,
    bootstrap_interval,
    evaluation_metrics,
    mean_interval,
    metrics_of_results,
    summarize,
    wilson_interval,
)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [  # z = 1.6448536 for 90%; e.g. 5/10: centre 0.5, half = z / (1 + z^2/10) * sqrt(0.025 + z^2/400)
        (5, 10, 0.269272, 0.730728),
        (0, 10, 0.0, 0.212942),  # z^2 / (10 + z^2)
        (10, 10, 0.787058, 1.0),
        (90, 100, 0.839645, 0.939281),
    ],
)
def test_wilson_intervals_by_hand(successes, trials, low, high):
    estimate = wilson_interval(successes, trials)
    assert estimate.value == successes / trials
    assert estimate.count == trials
    assert (estimate.low, estimate.high) == (pytest.approx(low, abs=2e-6), pytest.approx(high, abs=2e-6))


def test_a_published_wilson_interval():
    # Newcombe (1998), Table I: 81 of 263 at 95% gives 0.2553 to 0.3662
    estimate = wilson_interval(81, 263, confidence=0.95)
    assert (round(estimate.low, 4), round(estimate.high, 4)) == (0.2553, 0.3662)


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (3, 7), (299, 300)])
def test_wilson_agrees_with_scipy(successes, trials):
    estimate = wilson_interval(successes, trials, confidence=0.8)
    expected = stats.binomtest(successes, trials).proportion_ci(0.8, method="wilson")
    assert (estimate.low, estimate.high) == pytest.approx((expected.low, expected.high))


@given(trials=st.integers(1, 400), share=st.floats(0.0, 1.0), confidence=st.floats(0.5, 0.99))
def test_wilson_bounds_solve_the_score_equation(trials, share, confidence):
    successes = round(share * trials)
    estimate = wilson_interval(successes, trials, confidence)
    assert 0.0 <= estimate.low <= estimate.value <= estimate.high <= 1.0
    mirrored = wilson_interval(trials - successes, trials, confidence)
    assert mirrored.low == pytest.approx(1.0 - estimate.high, abs=1e-12)
    narrower = wilson_interval(10 * successes, 10 * trials, confidence)
    assert narrower.high - narrower.low < estimate.high - estimate.low


def test_t_interval_by_hand():
    # 1, 2, 3, 4: mean 2.5, s = 1.290994, t(0.95; 3) = 2.353363, half = 2.353363 * 1.290994 / 2 = 1.519089
    estimate = mean_interval([1.0, 2.0, math.nan, 3.0, 4.0])
    assert (estimate.value, estimate.count) == (2.5, 4)
    assert (estimate.low, estimate.high) == (pytest.approx(0.980911, abs=1e-5), pytest.approx(4.019089, abs=1e-5))


def test_bootstrap_intervals_are_close_to_t_intervals_where_those_are_right():
    values = np.random.default_rng(3).normal(5.0, 2.0, 400)
    bootstrap, t = bootstrap_interval([*values, math.nan]), mean_interval(values)
    assert (bootstrap.value, bootstrap.count) == (pytest.approx(values.mean()), 400)
    assert bootstrap.low == pytest.approx(t.low, abs=0.02) and bootstrap.high == pytest.approx(t.high, abs=0.02)
    assert bootstrap_interval(values) == bootstrap_interval(values)


def test_bootstrap_intervals_are_skewed_as_their_values_are():
    values = np.random.default_rng(3).lognormal(0.0, 1.5, 60)
    estimate = bootstrap_interval(values)
    assert values.min() <= estimate.low < estimate.value < estimate.high <= values.max()
    assert estimate.high - estimate.value > 1.1 * (estimate.value - estimate.low)
    mirrored = bootstrap_interval(-values)
    assert (mirrored.low, mirrored.high) == (pytest.approx(-estimate.high), pytest.approx(-estimate.low))


def test_intervals_of_little_or_nothing():
    for interval in (mean_interval, bootstrap_interval):
        assert interval([]).count == 0 and math.isnan(interval([math.nan]).value)
        single = interval([3.0])
        assert single.value == 3.0 and math.isnan(single.low) and math.isnan(single.high)
        with pytest.raises(ConfigError, match="confidence=1"):
            interval([1.0], confidence=1.0)
    assert bootstrap_interval([2.0, 2.0, 2.0]) == Estimate(2.0, 2.0, 2.0, 3)
    assert wilson_interval(0, 0).count == 0 and math.isnan(wilson_interval(0, 0).value)
    with pytest.raises(ConfigError, match="5 successes of 4"):
        wilson_interval(5, 4)


def test_the_three_metrics_by_hand():
    results = [  # efficiency, execution time
        sample_result(num_objects=4, num_actions=8, decision_time_s=0.3, simulation_time_s=0.1),  # 0.5, 0.4 s
        sample_result(num_objects=1, num_actions=4, decision_time_s=0.1, simulation_time_s=0.1),  # 0.25, 0.2 s
        sample_result("dropped", num_actions=3, decision_time_s=0.5, simulation_time_s=0.1),  # 0.6 s, no efficiency
        sample_result("out of actions", num_actions=49, decision_time_s=1.0, simulation_time_s=0.6),  # 1.6 s
    ]
    metrics = metrics_of_results(results)
    assert metrics["success_rate"].value == 0.5
    assert metrics["action_efficiency"].value == pytest.approx(0.375)
    assert metrics["action_efficiency"].count == 2
    assert metrics["execution_time_s"].value == pytest.approx(0.7)
    assert metrics["drop_rate"].value == 0.25
    assert metrics["num_actions"].value == 16.0


def table(rows):
    return pd.DataFrame([episode_row(sample_result(**row.pop("result", {}))) | row for row in rows])


def test_groups_are_summarized_apart_and_missing_keys_are_a_group():
    rows = [
        {"planner": "VisualRHP", "horizon": 3},
        {"planner": "VisualRHP", "horizon": 3, "result": {"outcome": "dropped"}},
        {"planner": "Greedy", "horizon": None},
        {"planner": "Greedy", "horizon": None},
        {"planner": "Greedy", "horizon": None, "result": {"outcome": "out of actions"}},
    ]
    summary = summarize(table(rows), ["planner", "horizon"])
    assert summary["planner"].tolist() == ["Greedy", "VisualRHP"]
    assert summary["episodes"].tolist() == [3, 2]
    assert summary["success_rate"].tolist() == [pytest.approx(2 / 3), 0.5]
    expected = wilson_interval(2, 3)
    bounds = summary[["success_rate_low", "success_rate_high"]].to_numpy()[0]
    assert bounds == pytest.approx([expected.low, expected.high])


def test_summaries_of_everything_and_of_nothing():
    episodes = table([{"planner": "Greedy"}, {"planner": "K.RRT"}])
    assert summarize(episodes, [])["episodes"].tolist() == [2]
    empty = summarize(episodes.iloc[:0], ["planner"])
    assert empty.empty and list(empty.columns) == list(summarize(episodes, ["planner"]).columns)
    assert math.isnan(evaluation_metrics(episodes.iloc[:0])["success_rate"].value)
    with pytest.raises(DataError, match="no column action_space"):
        summarize(episodes, ["action_space"])


def test_rows_in_another_order_give_the_same_summary():
    rows = [{"planner": f"planner {index % 3}", "result": {"num_actions": 1 + index % 7}} for index in range(40)]
    episodes = table(rows)
    shuffled = episodes.sample(frac=1.0, random_state=np.random.default_rng(0))
    pd.testing.assert_frame_equal(summarize(episodes, ["planner"]), summarize(shuffled, ["planner"]))
