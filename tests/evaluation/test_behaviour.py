"""From where the desired object is pushed: by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visualrhp.evaluation.behaviour import push_angles
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.types import State

SQUARE = ObjectShape.centred([[0.0, 0.0], [0.04, 0.0], [0.04, 0.04], [0.0, 0.04]])
SCENE = Scene(TargetRegion(np.array([0.2, 0.0])), (SQUARE,))


def state(robot: tuple[float, float], desired: tuple[float, float]) -> State:
    return State.create([*robot, 0.0], 0.085, False, [[*desired, 0.0]])


@pytest.mark.parametrize("bearing", [0.0, 0.5, -0.5, 2.0, math.pi])
def test_angle_of_a_push_is_measured_from_straight_behind_when_it_begins(bearing: float) -> None:
    """The object is at the origin, the target region to its right; where the robot ends does not matter."""
    robot = (-0.1 * math.cos(bearing), -0.1 * math.sin(bearing))
    angles = push_angles(SCENE, [state(robot, (0.0, 0.0)), state((0.1, 0.2), (0.02, 0.0))])
    assert angles == pytest.approx([abs(bearing)])


def test_only_actions_that_bring_the_object_nearer_count() -> None:
    behind, front = (-0.1, 0.0), (0.3, 0.0)
    states = [
        state(behind, (0.0, 0.0)),
        state(behind, (0.004, 0.0)),  # too little
        state(behind, (0.004, 0.1)),  # away
        state(front, (0.004, 0.0)),  # nearer, from behind (above)
        state(front, (0.05, 0.0)),  # nearer, from the front
    ]
    angles = push_angles(SCENE, states)
    assert len(angles) == 2
    assert angles[1] == pytest.approx(math.pi)
    assert len(push_angles(SCENE, states, min_progress=0.001)) == 3


def test_an_episode_without_an_action_has_no_push() -> None:
    assert push_angles(SCENE, [state((0.0, 0.0), (0.1, 0.0))]).shape == (0,)
