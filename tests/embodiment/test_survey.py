"""The arm gets out of the camera's sight, from wherever an episode begins."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.embodiment.approach import CLEARANCE_HEIGHT
from visualrhp.embodiment.survey import MOST_LEAN, backwards, survey_motions

pytest.importorskip("pinocchio")

from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.robot_model import HOME

KINEMATICS = ArmKinematics()


@pytest.mark.parametrize("pose", [(0.1, 0.0, 0.0), (0.22, 0.16, -3.12), (0.21, 0.23, -3.05), (-0.1, -0.2, 1.5)])
def test_the_arm_rises_turns_aside_and_returns(pose: tuple[float, float, float]) -> None:
    start = KINEMATICS.inverse(*pose, near=HOME)
    up, aside = survey_motions(KINEMATICS, start)
    assert up.positions[0] == pytest.approx(start, abs=1e-6)
    assert aside.positions[0] == pytest.approx(up.positions[-1], abs=1e-6)
    tools = [KINEMATICS.forward(joints) for joints in up.positions[::20]]
    assert np.diff([tool.height for tool in tools]).min() > -1e-4
    assert max(np.hypot(tool.x - pose[0], tool.y - pose[1]) for tool in tools) < MOST_LEAN + 1e-3
    assert max(tool.tilt for tool in tools) < 0.02
    risen, away = (KINEMATICS.forward(leg.positions[-1]) for leg in (up, aside))
    assert risen.height == pytest.approx(CLEARANCE_HEIGHT, abs=2e-3)
    assert away.height == pytest.approx(risen.height, abs=1e-6)
    assert away.x < -0.3  # not above the table


def test_the_way_back_is_the_way_there() -> None:
    up, _ = survey_motions(KINEMATICS, KINEMATICS.inverse(0.1, 0.0, 0.0, near=HOME))
    back = backwards(up)
    assert back.positions[-1] == pytest.approx(up.positions[0]) and back.positions[0] == pytest.approx(up.positions[-1])
    assert back.times[0] == 0.0 and np.diff(back.times).min() > 0.0
    assert back.duration == pytest.approx(up.duration)
