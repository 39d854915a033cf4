"""The comparison with OMPL is between equals: the same states, the same limits, plans that hold."""

from __future__ import annotations

import pytest

from tests.benchmarks.rrt import OMPLSearch, against_ompl, reach
from visualrhp.planning import KinodynamicRRT
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.streams import Split


def test_reach_prints_a_row_for_each_number_of_objects(capsys: pytest.CaptureFixture[str]) -> None:
    reach("continuous", (1, 7), 2, KinodynamicRRT(time_limit_s=10.0))
    title, _, *rows = capsys.readouterr().out.strip().splitlines()
    assert "2 task instances per row, limit 10.0 s" in title
    assert [row[:5] for row in rows] == ["m = 1", "m = 7"]
    assert all("2/2 100.0%" in row for row in rows)


def test_against_ompl(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("ompl", reason="has no wheel for this platform")
    for space in ("continuous", "discrete"):
        against_ompl(space, (2,), 1, KinodynamicRRT(time_limit_s=10.0))
        rows = capsys.readouterr().out.strip().splitlines()[2:]
        assert [row.split("  ")[0] for row in rows[:4]] == ["m = 2, K.RRT", "m = 2, OMPL", "all, K.RRT", "all, OMPL"]


def test_ompl_keeps_to_the_budget() -> None:
    pytest.importorskip("ompl", reason="has no wheel for this platform")
    task = sample_task_instance(SceneDistribution(num_objects=(7, 7)), 0, Split.EVALUATION, 0)
    found = OMPLSearch("continuous", task, 0, KinodynamicRRT(max_simulations=2)).search()
    assert found.length is None and found.num_simulated == 2
