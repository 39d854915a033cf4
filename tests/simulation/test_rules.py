"""Goal, validity, reward and the end of an episode by hand (Sec. 4 and 7)."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.simulation import DISCOUNT, MAX_EPISODE_ACTIONS, rules
from visualrhp.types import Outcome, State

BOX = ObjectShape([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]])
SCENE = Scene(TargetRegion([0.1, 0.0], 0.07), (BOX, BOX))


def state_with(*objects: tuple[float, float]) -> State:
    return State.create([-0.2, 0.0, 0.0], 0.085, False, [(x, y, 0.0) for x, y in objects])


def test_constants_are_the_papers() -> None:
    assert DISCOUNT == 0.995
    assert MAX_EPISODE_ACTIONS == 49  # success in under 50 actions


@pytest.mark.parametrize(("x", "goal"), [(0.031, True), (0.029, False), (0.169, True), (0.171, False)])
def test_goal_is_the_desired_objects_centre_within_the_radius(x: float, goal: bool) -> None:
    assert rules.is_goal(SCENE, state_with((x, 0.0), (0.1, 0.2))) is goal
    assert rules.is_goal(SCENE, state_with((-0.1, 0.2), (x, 0.0))) is False  # obstacles do not count


def test_the_border_of_the_target_region_belongs_to_it() -> None:
    scene = Scene(TargetRegion([0.0, 0.0], 0.07), (BOX,))
    assert rules.is_goal(scene, state_with((0.07, 0.0))) and rules.is_goal(scene, state_with((0.0, -0.07)))
    assert not rules.is_goal(scene, state_with((np.nextafter(0.07, 1.0), 0.0)))


@pytest.mark.parametrize(("x", "dropped"), [(0.249, False), (0.251, True), (-0.251, True)])
def test_an_object_is_dropped_when_its_centre_leaves_the_edges(x: float, dropped: bool) -> None:
    assert rules.is_dropped(SCENE, state_with((0.0, 0.0), (x, 0.1))) is dropped
    assert rules.is_dropped(SCENE, state_with((0.1, x), (0.0, 0.1))) is dropped


def test_the_robot_may_reach_beyond_the_edges() -> None:
    assert not rules.is_dropped(SCENE, State.create([-0.4, 0.0, 0.0], 0.085, False, np.zeros((2, 3))))


def test_the_bay_of_a_surface_is_not_on_it() -> None:
    """A surface that is not convex, against another library's point-in-polygon test."""
    edges = np.array([[-0.4, -0.2], [0.4, -0.2], [0.4, 0.2], [0.1, 0.2], [0.0, -0.1], [-0.1, 0.2], [-0.4, 0.2]])
    scene = Scene(TargetRegion([0.3, 0.0]), (BOX,), edges)
    points = np.random.default_rng(0).uniform(-0.45, 0.45, (300, 2))
    is_on = shapely.contains_xy(shapely.Polygon(edges), points)
    assert 50 < is_on.sum() < 250
    assert [not rules.is_dropped(scene, state_with((x, y))) for x, y in points.tolist()] == is_on.tolist()
    assert rules.is_dropped(scene, state_with((0.0, 0.0)))


def test_an_action_costs_one_and_a_drop_fifty() -> None:
    assert (rules.reward(False), rules.reward(True)) == (-1.0, -50.0)
    longest = sum(DISCOUNT**k * rules.reward(False) for k in range(MAX_EPISODE_ACTIONS))
    assert rules.reward(True) < longest  # it never pays to drop an object in order to be done


@pytest.mark.parametrize(
    ("is_goal", "is_dropped", "num_actions", "outcome"),
    [
        (False, False, 0, None),
        (False, False, 48, None),
        (False, False, 49, Outcome.OUT_OF_ACTIONS),
        (False, False, 50, Outcome.OUT_OF_ACTIONS),
        (True, False, 0, Outcome.SUCCESS),
        (True, False, 49, Outcome.SUCCESS),  # under 50 actions
        (False, True, 1, Outcome.DROPPED),
        (True, True, 1, Outcome.DROPPED),
        (True, True, 49, Outcome.DROPPED),
    ],
)
def test_a_drop_comes_before_the_goal_and_the_goal_before_the_limit(
    is_goal: bool, is_dropped: bool, num_actions: int, outcome: Outcome | None
) -> None:
    assert rules.outcome_after(is_goal, is_dropped, num_actions) is outcome
