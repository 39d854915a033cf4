"""Reward, goal and validity by hand (Sec. 4 and 7)."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.simulation import DISCOUNT, MAX_EPISODE_ACTIONS, DiscreteActionSpace, TransitionModel
from visualrhp.types import State

BOX = ObjectShape([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]])


def state_with(*objects: tuple[float, float]) -> State:
    return State.create([-0.2, 0.0, 0.0], 0.085, False, [(x, y, 0.0) for x, y in objects])


@pytest.fixture
def model() -> TransitionModel:
    return TransitionModel(Scene(TargetRegion([0.1, 0.0], 0.07), (BOX, BOX)), DiscreteActionSpace())


def test_constants_are_the_papers() -> None:
    assert DISCOUNT == 0.995
    assert MAX_EPISODE_ACTIONS == 49  # success in under 50 actions


@pytest.mark.parametrize(("x", "goal"), [(0.031, True), (0.029, False), (0.169, True), (0.171, False)])
def test_goal_is_the_desired_objects_centre_within_the_radius(model: TransitionModel, x: float, goal: bool) -> None:
    assert model.is_goal(state_with((x, 0.0), (0.1, 0.2))) is goal
    assert model.is_goal(state_with((-0.1, 0.2), (x, 0.0))) is False  # obstacles do not count


@pytest.mark.parametrize(("x", "dropped"), [(0.249, False), (0.251, True), (-0.251, True)])
def test_an_object_is_dropped_when_its_centre_leaves_the_edges(model: TransitionModel, x: float, dropped: bool) -> None:
    assert model.is_dropped(state_with((0.0, 0.0), (x, 0.1))) is dropped
    assert model.is_dropped(state_with((0.1, x), (0.0, 0.1))) is dropped


def test_the_robot_may_reach_beyond_the_edges(model: TransitionModel) -> None:
    assert not model.is_dropped(State.create([-0.4, 0.0, 0.0], 0.085, False, np.zeros((2, 3))))


def test_pushing_into_the_target_is_the_goal(model: TransitionModel) -> None:
    state = State.create([-0.03, 0.0, 0.0], 0.0, True, [(0.015, 0.0, 0.0), (0.0, 0.2, 0.0)])
    transition = model.simulate(state, 0)
    assert (transition.reward, transition.is_goal, transition.is_dropped) == (-1.0, True, False)
    assert transition.is_terminal


def test_pushing_over_the_edge_is_a_drop_even_at_the_goal() -> None:
    model = TransitionModel(Scene(TargetRegion([0.24, 0.0], 0.07), (BOX,)), DiscreteActionSpace())
    state = State.create([0.165, 0.0, 0.0], 0.0, True, [(0.21, 0.0, 0.0)])
    transition = model.simulate(state, 0)
    assert (transition.reward, transition.is_goal, transition.is_dropped) == (-50.0, False, True)
    assert model.is_goal(transition.next_state)
