"""Statistics of attempts, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.demonstrations.shards import Arrays
from visualrhp.demonstrations.statistics import AttemptStatistics


def attempts(solved: list[int], length: list[int], num_objects: list[int]) -> Arrays:
    count = len(solved)
    return {
        "solved": np.array(solved, dtype=np.bool_),
        "length": np.array(length),
        "num_objects": np.array(num_objects),
        "num_simulated": np.arange(1, count + 1) * 100,
        "num_nodes": np.ones(count, dtype=np.int64),
        "search_time_s": np.arange(1, count + 1) * 0.5,
    }


@pytest.fixture
def statistics() -> AttemptStatistics:
    """Five demonstrations: four of the first block, and the first one of the second block completes the set."""
    found = AttemptStatistics()
    found.add(attempts([1, 0, 1, 1, 1], [4, 0, 2, 6, 4], [2, 3, 1, 3, 2]), num_missing=5)
    found.add(attempts([0, 1, 1], [0, 9, 50], [7, 3, 7]), num_missing=1)
    return found


def test_only_attempts_up_to_the_last_needed_one_count(statistics: AttemptStatistics) -> None:
    assert statistics.lengths().tolist() == [4, 2, 6, 4, 9]
    metrics = statistics.metrics()
    assert (metrics["demonstrations"], metrics["attempts"], metrics["failures"]) == (5, 7, 2)
    assert metrics["solved_rate"] == pytest.approx(5 / 7)


def test_lengths_and_efficiency(statistics: AttemptStatistics) -> None:
    metrics = statistics.metrics()
    assert (metrics["transitions"], metrics["actions_max"], metrics["actions_median"]) == (25, 9, 4.0)
    assert metrics["actions_mean"] == 5.0
    assert metrics["action_efficiency"] == pytest.approx((2 / 4 + 1 / 2 + 3 / 6 + 2 / 4 + 3 / 9) / 5)


def test_failed_attempts_count_in_the_effort(statistics: AttemptStatistics) -> None:
    simulated = [100, 200, 300, 400, 500, 100, 200]
    metrics, timings = statistics.metrics(), statistics.timings()
    assert metrics["simulated_mean"] == pytest.approx(np.mean(simulated))
    assert metrics["simulated_median"] == 200.0
    assert timings["search_time_total_s"] == pytest.approx(0.005 * sum(simulated))
    assert metrics["simulated_p95"] == pytest.approx(470.0)  # position 0.95 * 6 = 5.7: 400 + 0.7 * 100
    assert not any("time" in name for name in metrics)  # they do not depend on the speed of the machine


def test_times_of_searches() -> None:
    found = AttemptStatistics()
    found.add(attempts([1, 1, 0, 1], [1, 1, 0, 1], [1, 1, 1, 1]) | {"search_time_s": np.array([4.0, 1.0, 2.0, 9.0])}, 3)
    assert found.timings() == pytest.approx(
        {
            "search_time_mean_s": 4.0,
            "search_time_median_s": 3.0,
            "search_time_p95_s": 8.25,  # position 0.95 * 3 = 2.85: 4 + 0.85 * 5
            "search_time_total_s": 16.0,
        }
    )


def test_a_demonstration_without_actions_has_a_finite_efficiency() -> None:
    """The desired object is in the target region from the start."""
    found = AttemptStatistics()
    found.add(attempts([1, 1], [0, 4], [3, 2]), num_missing=2)
    assert found.metrics()["action_efficiency"] == pytest.approx((3 / 1 + 2 / 4) / 2)


def test_the_table_of_lengths(statistics: AttemptStatistics) -> None:
    assert statistics.length_table().splitlines() == [
        "num_objects,actions,demonstrations",
        "1,2,1",
        "2,4,2",
        "3,6,1",
        "3,9,1",
    ]
