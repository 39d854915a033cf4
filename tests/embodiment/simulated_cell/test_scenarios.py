"""The named set-ups of the cell."""

from __future__ import annotations

import pytest

from visualrhp.embodiment.reach import ReachMap
from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
from visualrhp.embodiment.simulated_cell.scenarios import SCENARIOS, scenario
from visualrhp.errors import ConfigError
from visualrhp.scene.start import check_start
from visualrhp.simulation import rules


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_every_scenario_can_be_played(name: str) -> None:
    task = scenario(name)
    truth = SimulatedCell(task, render=False).truth()
    check_start(truth.scene, truth.state)
    assert rules.outcome_after(rules.is_goal(truth.scene, truth.state), False, 0) is None
    assert ReachMap.load(task.mounting).contains(task.gripper_pose)


def test_the_paper_s_desired_objects_come_first() -> None:
    kinds = {name: scenario(name).objects[0].kind.value for name in SCENARIOS}
    assert kinds["low_clutter"] == kinds["high_clutter"] == kinds["squeeze"] == "orange"
    assert kinds["two_strategies"] == kinds["bottle"] == kinds["surrounded"] == "bottle"
    assert kinds["small_object"] == kinds["large_object"] == "apple"


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"scenario='fig99'.*low_clutter, high_clutter"):
        scenario("fig99")
