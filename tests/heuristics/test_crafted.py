"""The handcrafted heuristic: each term by hand, and the behaviour it is meant to favour."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from visualrhp.errors import ConfigError
from visualrhp.evaluation.behaviour import FROM_BEHIND, push_angles
from visualrhp.heuristics.crafted import CostToGo, CraftedHeuristic
from visualrhp.planning import RecedingHorizon
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.simulation.rules import MAX_EPISODE_ACTIONS
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


def run(
    cost_to_go: CostToGo, action_space: ActionSpaceName, start: State, scene: Scene = SCENE, seed: int = 0
) -> tuple[bool, list[State]]:
    """Whether RHP 8x4 solves the task, and the states it passes through."""
    model = TransitionModel(scene, make_action_space(action_space))
    policy = RecedingHorizon(CraftedHeuristic(action_space, cost_to_go), num_rollouts=8, horizon=4).start(
        model, np.random.default_rng(seed)
    )
    states = [start]
    while len(states) <= MAX_EPISODE_ACTIONS:
        action = policy(states[-1]).action
        assert action is not None
        transition = model.simulate(states[-1], action)
        states.append(transition.next_state)
        if transition.is_terminal:
            break
    return model.is_goal(states[-1]), states


WRONG_SIDES = {
    "in front": ((0.08, 0.0, math.pi), (-0.08, 0.0)),
    "left": ((-0.08, 0.18, -math.pi / 2), (-0.08, 0.0)),
    "right": ((-0.08, -0.18, math.pi / 2), (-0.08, 0.0)),
}
"""Robot and desired object; the target region is at (0.2, 0)."""


def runs_from_wrong_sides(cost_to_go: CostToGo, action_space: ActionSpaceName) -> tuple[int, float]:
    """Number of solved tasks of six, and the share of pushes from behind."""
    num_solved, angles = 0, []
    for seed in range(2):
        for robot, desired in WRONG_SIDES.values():
            start = state(robot, desired)
            assert misalignment(start) > math.radians(80)
            solved, states = run(cost_to_go, action_space, start, seed=seed)
            num_solved += solved
            angles += list(push_angles(SCENE, states))
    return num_solved, float(np.mean(np.array(angles) < FROM_BEHIND))


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_from_a_wrong_side_it_goes_behind_the_object_and_pushes(action_space: ActionSpaceName) -> None:
    """Sec. 7.5: "the robot would first approach the desired object from the back, then pushes it"."""
    num_solved, from_behind = runs_from_wrong_sides(CostToGo(), action_space)
    assert num_solved >= 4
    assert from_behind > 0.6


def test_the_terms_of_alignment_are_what_makes_it_go_behind() -> None:
    _, from_behind = runs_from_wrong_sides(CostToGo(), "discrete")
    _, without = runs_from_wrong_sides(replace(CostToGo(), align=0.0, face=0.0), "discrete")
    assert without < 0.5 < from_behind


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_it_solves_a_task_from_behind_with_hardly_a_detour(action_space: ActionSpaceName) -> None:
    solved, states = run(CostToGo(), action_space, state((-0.2, 0.02, 0.3), (-0.05, 0.0)))
    assert solved
    assert (push_angles(SCENE, states) < FROM_BEHIND).all()


def test_the_weight_of_a_drop_plays_no_part_in_a_roll_out() -> None:
    """A drop ends it: the reward of Sec. 7 is the penalty, and nothing is bootstrapped from (Algorithm 1)."""
    start = state((0.1, 0.0, 0.0), (0.21, 0.05))  # near the edge
    scene = Scene(TargetRegion(np.array([-0.2, 0.0])), (SQUARE,))
    paths = [run(replace(CostToGo(), drop=drop), "continuous", start, scene)[1] for drop in (0.0, 1000.0)]
    assert paths[0] == paths[1]


def misalignment(current: State) -> float:
    """What the term of alignment weighs [rad]."""
    return float(CostToGo(0.0, 0.0, 0.0, 1.0, 0.0, 0.0)([SCENE], [current])[0])


@pytest.mark.parametrize("weights", [{"reach": -1.0}, {"turn": math.nan}, {"drop": math.inf}])
def test_a_weight_out_of_range_is_named(weights: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(weights))):
        CostToGo(**weights)
