"""Transitions by hand: reward, goal and drop (Sec. 4 and 7)."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.simulation import DiscreteActionSpace, TransitionModel, rules
from visualrhp.types import State

BOX = ObjectShape([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]])


def state_with(*objects: tuple[float, float]) -> State:
    return State.create([-0.2, 0.0, 0.0], 0.085, False, [(x, y, 0.0) for x, y in objects])


@pytest.fixture
def model() -> TransitionModel:
    return TransitionModel(Scene(TargetRegion([0.1, 0.0], 0.07), (BOX, BOX)), DiscreteActionSpace())


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
    assert rules.is_goal(model.scene, transition.next_state) and not model.is_goal(transition.next_state)


def test_a_perturbed_model_differs_in_its_objects_alone(model: TransitionModel) -> None:
    perturbed = model.perturbed(0.1, 0.2, np.random.default_rng(0))
    assert perturbed.scene.target == model.scene.target and perturbed.action_space is model.action_space
    assert all(one != other for one, other in zip(perturbed.scene.objects, model.scene.objects, strict=True))
    assert model.perturbed(0.1, 0.2, np.random.default_rng(0)).scene == perturbed.scene
    assert model.perturbed(0.0, 0.0, np.random.default_rng(0)).scene == model.scene
    free = state_with((0.0, 0.2), (0.1, 0.2))
    assert perturbed.simulate(free, 0).next_state == model.simulate(free, 0).next_state, "nothing is touched"
