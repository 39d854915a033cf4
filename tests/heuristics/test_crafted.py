"""The handcrafted heuristic: each term by hand, and the behaviour it is meant to favour."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from visualrhp.errors import ConfigError
from visualrhp.heuristics.crafted import CostToGo, CraftedHeuristic
from visualrhp.planning import RecedingHorizon
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.types import ActionSpaceName, State

SQUARE = ObjectShape.centred([[0.0, 0.0], [0.04, 0.0], [0.04, 0.04], [0.0, 0.04]])
SCENE = Scene(TargetRegion(np.array([0.2, 0.0])), (SQUARE,))


def state(robot: tuple[float, float, float], desired: tuple[float, float]) -> State:
    return State.create(robot, 0.085, False, [[*desired, 0.0]])


def cost(weights: dict[str, float], robot: tuple[float, float, float], desired: tuple[float, float]) -> float:
    everything = {weight.name: 0.0 for weight in fields(CostToGo)} | weights
    return float(CostToGo(**everything)([SCENE], [state(robot, desired)])[0])


def test_distances() -> None:
    """Robot (0, 0), object (0.03, 0.04), target (0.2, 0): 5 cm, and the root of 0.17^2 + 0.04^2."""
    assert cost({"reach": 2.0}, (0.0, 0.0, 1.0), (0.03, 0.04)) == pytest.approx(0.1)
    assert cost({"carry": 1.0}, (0.0, 0.0, 1.0), (0.03, 0.04)) == pytest.approx(math.hypot(0.17, 0.04))


@pytest.mark.parametrize(
    ("heading", "angle"),
    [(math.pi / 2, 0.0), (0.0, math.pi / 2), (-math.pi / 2, math.pi), (-3.0, 2 * math.pi - 3 - math.pi / 2)],
)
def test_angular_displacement_of_the_object_is_wrapped(heading: float, angle: float) -> None:
    """The object is straight above the robot (world frame)."""
    assert cost({"turn": 1.0}, (0.0, 0.0, heading), (0.0, 0.1)) == pytest.approx(angle)


@pytest.mark.parametrize(
    ("robot", "angle"),
    [((-0.1, 0.0), 0.0), ((0.1, 0.0), math.pi), ((0.0, 0.1), math.pi / 2), ((0.0, -0.1), math.pi / 2)],
)
def test_alignment_of_robot_object_and_target(robot: tuple[float, float], angle: float) -> None:
    """The object is at the origin, the target region to its right."""
    assert cost({"align": 1.0}, (*robot, 0.3), (0.0, 0.0)) == pytest.approx(angle)


def test_facing_the_target_counts_the_more_the_further_the_robot_is_behind() -> None:
    """Heading off by 90 degrees: straight behind, 60 degrees off, and beside the object."""

    def face(bearing: float) -> float:
        x, y = -0.1 * math.cos(bearing), -0.1 * math.sin(bearing)
        heading = math.atan2(-y, 0.2 - x) + math.pi / 2
        return cost({"face": 1.0}, (x, y, heading), (0.0, 0.0))

    assert face(0.0) == pytest.approx(math.pi / 2)
    assert face(math.pi / 3) == pytest.approx(math.pi / 4)
    assert face(math.pi / 2) == pytest.approx(0.0, abs=1e-12)
    assert face(math.pi) == pytest.approx(0.0)


def test_a_dropped_object_is_penalized() -> None:
    assert cost({"drop": 50.0}, (0.0, 0.0, 0.0), (0.26, 0.0)) == 50.0
    assert cost({"drop": 50.0}, (0.0, 0.0, 0.0), (0.24, 0.0)) == 0.0


def test_values_of_a_batch_are_minus_the_costs_of_its_states() -> None:
    other = Scene(TargetRegion(np.array([-0.2, 0.1])), (SQUARE, SQUARE))
    states = [state((0.0, 0.1, 0.2), (0.05, 0.0)), State.create([0, 0, 1], 0.085, True, [[0.1, 0, 0], [0, 0.1, 0]])]
    together = CraftedHeuristic("discrete").guide([SCENE, other], states).values
    alone = [
        CraftedHeuristic("discrete").guide([scene], [s]).values[0]
        for scene, s in zip((SCENE, other), states, strict=True)
    ]
    assert together.tolist() == alone
    assert (together < 0.0).all()
    assert alone[0] == -CostToGo()([SCENE], states[:1])[0]


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_it_solves_an_easy_task_by_pushing_from_behind(action_space: ActionSpaceName) -> None:
    start = state((-0.2, 0.02, 0.3), (-0.05, 0.0))
    model = TransitionModel(SCENE, make_action_space(action_space))
    policy = RecedingHorizon(CraftedHeuristic(action_space), 8, 4).start(model, np.random.default_rng(0))
    current = start
    for _ in range(40):
        action = policy(current).action
        assert action is not None
        transition = model.simulate(current, action)
        current = transition.next_state
        if transition.is_terminal:
            break
    assert model.is_goal(current)


@pytest.mark.parametrize("weights", [{"reach": -1.0}, {"turn": math.nan}, {"drop": math.inf}])
def test_a_weight_out_of_range_is_named(weights: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(weights))):
        CostToGo(**weights)
