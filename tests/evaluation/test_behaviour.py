"""Angles of pushes, by hand."""

from __future__ import annotations

import math

import pytest

from tests.evaluation.samples import sample_scene, sample_state
from visualrhp.evaluation.behaviour import push_angles

SCENE = sample_scene()


@pytest.mark.parametrize("bearing", [0.0, 0.5, -0.5, 2.0, math.pi])
def test_angle_of_a_push_is_measured_from_straight_behind_when_it_begins(bearing: float) -> None:
    """The object is at the origin, the target region to its right; where the gripper ends is irrelevant."""
    gripper = (-0.1 * math.cos(bearing), -0.1 * math.sin(bearing))
    angles = push_angles(SCENE, [sample_state(gripper, (0.0, 0.0)), sample_state((0.1, 0.2), (0.02, 0.0))])
    assert angles == pytest.approx([abs(bearing)])


def test_only_actions_that_bring_the_object_nearer_count() -> None:
    behind, front = (-0.1, 0.0), (0.3, 0.0)
    states = [
        sample_state(behind, (0.0, 0.0)),
        sample_state(behind, (0.004, 0.0)),  # too little
        sample_state(behind, (0.004, 0.1)),  # away
        sample_state(front, (0.004, 0.0)),  # nearer, from behind (above)
        sample_state(front, (0.05, 0.0)),  # nearer, from the front
    ]
    angles = push_angles(SCENE, states)
    assert len(angles) == 2
    assert angles[1] == pytest.approx(math.pi)
    assert len(push_angles(SCENE, states, min_progress=0.001)) == 3


def test_an_episode_without_an_action_has_no_push() -> None:
    assert push_angles(SCENE, [sample_state((0.0, 0.0), (0.1, 0.0))]).shape == (0,)
