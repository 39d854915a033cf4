"""The way to where an episode begins."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from visualrhp.embodiment.approach import CLEARANCE_HEIGHT, approach
from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.reach_computation import CollisionModel
from visualrhp.embodiment.robot_cell import ArmLimits
from visualrhp.embodiment.robot_model import GRIPPER_HEIGHT, HOME
from visualrhp.errors import UnreachableError

KINEMATICS = ArmKinematics()
COLLISIONS = CollisionModel(KINEMATICS.mounting)
LEVEL = KINEMATICS.inverse(0.1, -0.1, 2.0, near=HOME)


def tilted(angle: float, joint: int = 3, height: float = 0.2) -> Any:
    """The arm with the gripper at ``height``, then one joint turned by ``angle``."""
    joints = KINEMATICS.inverse(0.0, 0.05, -1.0, near=HOME, height=height)
    joints[joint] += angle
    return joints


@pytest.mark.parametrize("start", [LEVEL, tilted(0.0), tilted(0.4), tilted(-0.4), tilted(0.5, 4), tilted(0.2, 1)])
@pytest.mark.parametrize("pose", [(-0.1, 0.15, 0.5), (0.2, -0.2, 1.57)])
def test_it_goes_up_across_and_down(start: Any, pose: Any) -> None:
    up, across, down = approach(KINEMATICS, start, pose, COLLISIONS)
    first = KINEMATICS.forward(start)
    assert up.positions[0] == pytest.approx(start)
    assert across.positions[0] == pytest.approx(up.positions[-1])
    assert down.positions[0] == pytest.approx(across.positions[-1])
    heights = {name: [KINEMATICS.forward(joints).height for joints in leg.positions[::10]]
               for name, leg in (("up", up), ("across", across), ("down", down))}  # fmt: skip
    assert (np.diff(heights["up"]) > -1e-3).all() and (np.diff(heights["down"]) < 1e-9).all()
    assert min(heights["across"]) > CLEARANCE_HEIGHT - 0.03
    for joints in up.positions[::10]:
        tool = KINEMATICS.forward(joints)
        assert math.hypot(tool.x - first.x, tool.y - first.y) < 2e-3
        assert tool.tilt <= first.tilt + 1e-3
    for joints in down.positions[::10]:
        tool = KINEMATICS.forward(joints)
        assert (tool.x, tool.y, tool.theta) == pytest.approx(pose, abs=1e-9)
    end = KINEMATICS.forward(down.positions[-1])
    assert end.height == pytest.approx(GRIPPER_HEIGHT, abs=1e-9) and end.tilt < 1e-7


def test_limits_hold() -> None:
    limits = ArmLimits(velocity=np.full(6, 0.5), acceleration=np.full(6, 2.0))
    for leg in approach(ArmKinematics(limits=limits), tilted(0.4), (0.0, 0.0, 1.0), COLLISIONS):
        velocity = np.diff(leg.positions, axis=0) / leg.times[1]
        assert (abs(velocity) <= limits.velocity * (1 + 1e-9)).all()
        assert (abs(np.diff(velocity, axis=0)) / leg.times[1] <= limits.acceleration * (1 + 1e-9)).all()
        assert ((leg.positions >= limits.lower) & (leg.positions <= limits.upper)).all()


def test_a_tool_above_the_clearance_stays_there() -> None:
    up, across, _ = approach(KINEMATICS, tilted(0.3, height=0.35), (0.0, 0.0, 1.0), COLLISIONS)
    height = KINEMATICS.forward(up.positions[0]).height
    assert height > CLEARANCE_HEIGHT
    assert KINEMATICS.forward(across.positions[-1]).height == pytest.approx(height, abs=1e-6)


def test_a_gripper_that_touches_the_table_is_lifted() -> None:
    start = KINEMATICS.inverse(0.0, 0.0, 1.0, near=HOME, height=GRIPPER_HEIGHT - 0.005)
    assert COLLISIONS.touching(start)
    up, _, _ = approach(KINEMATICS, start, (0.0, 0.0, 1.0), COLLISIONS)
    assert not COLLISIONS.touching(up.positions[-1])


def test_an_end_outside_the_reach_is_a_named_error() -> None:
    with pytest.raises(UnreachableError, match="outside the reach"):
        approach(KINEMATICS, LEVEL, (0.6, 0.0, 0.0), COLLISIONS)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ((0.0, -1.2, -2.0, 0.1, -1.57, 0.0), "posture|straight line|too close|flange would be"),
        ((0.0, -0.1, 0.1, -1.57, -1.57, 0.0), "posture|straight line|too close|flange would be"),
        ((0.0, -1.2, 3.5, 0.1, -1.57, 0.0), "a limit of a joint is in the way"),
    ],
)
def test_an_impossible_way_is_a_named_error(start: Any, message: str) -> None:
    with pytest.raises(UnreachableError, match=message):
        approach(KINEMATICS, start, (0.0, 0.0, 0.0), COLLISIONS)
