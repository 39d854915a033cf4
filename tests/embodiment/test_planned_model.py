"""The planner's model: the arm's reach is a constraint, and the scene follows the camera's."""

from __future__ import annotations

import copy
import pickle
from typing import Any
from unittest import mock

import numpy as np
import pytest

from tests.embodiment.planar_cell import pushing_task
from visualrhp.embodiment import planned_model
from visualrhp.embodiment.planned_model import ReachableModel
from visualrhp.embodiment.reach import ReachMap, TurningRange
from visualrhp.embodiment.robot_model import Mounting
from visualrhp.errors import ActionError, SimulationError
from visualrhp.planning.planner import PlanningModel
from visualrhp.scene.noise import perturb
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import Scene, TargetRegion, TaskInstance, square_edges
from visualrhp.simulation import ContinuousActionSpace, DiscreteActionSpace, Physics, TransitionModel
from visualrhp.streams import Split
from visualrhp.types import State

REACH = ReachMap.load()
FORWARD, BACKWARD, CLOSE = 0, 1, 6


def task(index: int, num_objects: int = 3) -> TaskInstance:
    return sample_task_instance(SceneDistribution(num_objects=num_objects), 0, Split.EVALUATION, index)


def moved_gripper(state: State, pose: Any) -> State:
    return State.create(pose, state.gripper_opening, state.gripper_closed, state.object_poses)


def as_planning_model(model: PlanningModel) -> PlanningModel:
    """pyright checks that it is one."""
    return model


@pytest.fixture
def first() -> TaskInstance:
    return task(0)


@pytest.fixture
def model(first: TaskInstance) -> ReachableModel:
    return ReachableModel(first.scene, DiscreteActionSpace(), REACH)


# ----------------------------------------------------------------------------------------------------- the constraint
def test_within_the_reach_it_is_the_transition_model(first: TaskInstance, model: ReachableModel) -> None:
    state = moved_gripper(first.state, (0.0, -0.2, 1.5))
    expected = TransitionModel(first.scene, DiscreteActionSpace()).simulate(state, FORWARD)
    found = as_planning_model(model).simulate(state, FORWARD)
    assert (found.next_state, found.reward, found.is_goal) == (expected.next_state, expected.reward, expected.is_goal)
    assert model.is_goal(state) == TransitionModel(first.scene, DiscreteActionSpace()).is_goal(state)
    assert not model.is_dropped(state)
    assert model.scene is first.scene


def test_turning_beyond_the_wrist_is_invalid(first: TaskInstance) -> None:
    model = ReachableModel(first.scene, ContinuousActionSpace(), REACH)
    state = moved_gripper(first.state, (0.0, -0.2, 3.0))
    left, right = np.array([0.0, 0.0, 1.0, -1.0]), np.array([0.0, 0.0, -1.0, -1.0])
    model.follow(first.scene, TurningRange(Mounting(), 0.13, (0.0, -0.2, 3.0), forwards=2.0, backwards=1.2))
    after = model.simulate(state, left).next_state  # 50 degrees, past the heading of 180
    with pytest.raises(SimulationError, match="wrist 3 cannot turn on by 50"):
        model.simulate(after, left)
    model.simulate(after, right)
    with pytest.raises(SimulationError, match="wrist 3"):
        model.perturbed(0.05, 0.0, np.random.default_rng(0)).simulate(after, left)
    model.follow(first.scene)
    model.simulate(after, left)


def test_in_perturbed_models_no_object_is_pushed_close_to_an_edge() -> None:
    task = pushing_task(target_x=0.0)
    space, forward = ContinuousActionSpace(), np.array([1.0, 0.0, 0.0, 1.0])
    touched = ReachableModel(task.scene, space).simulate(task.state, forward).next_state
    pushed = ReachableModel(task.scene, space).simulate(touched, forward).next_state
    x = float(pushed.object_positions[0, 0])
    assert x > touched.object_positions[0, 0] + 0.05
    shifted = square_edges(0.5) + (x + 0.02 - 0.25, 0.0)
    scene = Scene(TargetRegion(np.array([x, 0.1]), 0.05), task.scene.objects, shifted, task.scene.gripper)

    def is_dropped(edge_margin: float, state: State, action: np.ndarray) -> list[bool]:
        model = ReachableModel(scene, space, edge_margin=edge_margin)
        assert not model.simulate(state, action).is_dropped
        perturbed = [model.perturbed(0.0, 0.0, np.random.default_rng(seed)) for seed in range(8)]
        transitions = [each.simulate(state, action) for each in perturbed]
        assert all(each.reward == (-50.0 if each.is_dropped else -1.0) for each in transitions)
        return [each.is_dropped for each in transitions]

    assert not any(is_dropped(0.0, touched, forward))
    assert 0 < sum(is_dropped(0.04, touched, forward)) < 8  # each model has its own part of the margin
    assert sum(is_dropped(0.4, touched, forward)) > 6
    assert not any(is_dropped(0.4, pushed, -forward))  # it is left where it is


def test_what_the_arm_cannot_do_is_invalid(first: TaskInstance, model: ReachableModel) -> None:
    near_the_base = moved_gripper(first.state, (-0.19, 0.0, 0.0))
    with pytest.raises(SimulationError, match=r"cannot move the gripper from \(-0.190 m, 0.000 m, 0.0 degrees\)"):
        model.simulate(near_the_base, BACKWARD)
    with pytest.raises(SimulationError):
        model.perturbed(0.05, 0.0, np.random.default_rng(0)).simulate(near_the_base, BACKWARD)
    model.simulate(near_the_base, FORWARD)
    model.simulate(near_the_base, CLOSE)
    ReachableModel(first.scene, DiscreteActionSpace(), None).simulate(near_the_base, BACKWARD)


def test_wrong_actions_are_errors_of_the_caller(first: TaskInstance, model: ReachableModel) -> None:
    with pytest.raises(ActionError):
        model.simulate(first.state, 8)


def test_a_planner_avoids_what_cannot_be_reached(first: TaskInstance) -> None:
    """All roll-outs of a planner that backs off into the base count as invalid."""
    from visualrhp.heuristics.crafted import CraftedHeuristic
    from visualrhp.planning import RecedingHorizon

    never = ReachMap(REACH.mounting, np.zeros_like(REACH.free))
    blocked = ReachableModel(first.scene, ContinuousActionSpace(), never)
    planner = RecedingHorizon(CraftedHeuristic("continuous"), num_rollouts=3, horizon=2)
    decision = planner.start(blocked, np.random.default_rng(0))(first.state)
    assert decision.num_invalid == 3


# ------------------------------------------------------------------------------------------------------- changed scenes
def test_follow_changes_the_scene_of_the_model_and_its_perturbed_ones(model: ReachableModel) -> None:
    near = model.perturbed(0.05, 0.1, np.random.default_rng(3))
    twice = near.perturbed(0.05, 0.0, np.random.default_rng(4))
    scenes = [near.scene, twice.scene]
    second = task(1, num_objects=5)
    model.follow(second.scene)
    assert model.scene is second.scene and near.scene.num_objects == twice.scene.num_objects == 5
    state = moved_gripper(second.state, (0.0, -0.2, 1.5))
    for each in (model, near, twice):
        expected = TransitionModel(each.scene, DiscreteActionSpace()).simulate(state, FORWARD)
        assert each.simulate(state, FORWARD).next_state == expected.next_state
    model.follow(task(0).scene)
    assert [near.scene, twice.scene] == scenes  # the same draws again


def test_perturbed_scenes_are_drawn_from_one_seed_of_the_generator(model: ReachableModel) -> None:
    first, again = (model.perturbed(0.05, 0.1, np.random.default_rng(3)) for _ in range(2))
    other = model.perturbed(0.05, 0.1, np.random.default_rng(4))
    assert first.scene == again.scene != other.scene
    seed = int(np.random.default_rng(3).integers(1 << 63))
    assert first.scene == perturb(model.scene, 0.05, np.random.default_rng(seed), 0.1)
    assert model.perturbed(0.0, 0.0, np.random.default_rng(0)).scene == model.scene


def test_a_perturbed_model_that_follows_takes_the_nominal_one_along(model: ReachableModel) -> None:
    near, scene = model.perturbed(0.05, 0.0, np.random.default_rng(3)), task(1).scene
    near.follow(scene)
    assert model.scene is scene and near.scene != scene


def test_models_are_assembled_when_they_are_needed_and_once(model: ReachableModel) -> None:
    near = model.perturbed(0.05, 0.0, np.random.default_rng(3))
    state = moved_gripper(task(0).state, (0.0, -0.2, 1.5))
    with (
        mock.patch.object(planned_model, "TransitionModel", wraps=TransitionModel) as made,
        mock.patch.object(planned_model, "perturb", wraps=perturb) as perturbed,
    ):
        model.follow(task(1).scene)
        model.follow(task(2).scene)
        assert made.call_count == perturbed.call_count == 0
        for _ in range(3):
            model.simulate(state, CLOSE)
            near.simulate(state, CLOSE)
            near.is_goal(state)
            model.follow(task(2).scene)  # an equal scene
        assert (made.call_count, perturbed.call_count) == (2, 1)
        model.follow(task(0).scene)
        near.simulate(state, CLOSE)
        assert (made.call_count, perturbed.call_count) == (3, 2)


@pytest.mark.parametrize("copied", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_copies_follow_on_their_own_and_together(model: ReachableModel, copied: Any) -> None:
    near = model.perturbed(0.05, 0.0, np.random.default_rng(3))
    state = moved_gripper(task(0).state, (0.0, -0.2, 1.5))
    expected = [each.simulate(state, FORWARD).next_state for each in (model, near)]
    copies = copied((model, near))
    assert [each.simulate(state, FORWARD).next_state for each in copies] == expected
    copies[0].follow(task(1).scene)
    assert copies[1].scene == perturb(
        task(1).scene, 0.05, np.random.default_rng(int(np.random.default_rng(3).integers(1 << 63)))
    )
    assert model.scene == task(0).scene


def test_the_physics_are_those_that_were_given(first: TaskInstance) -> None:
    physics = Physics(gripper_friction=0.123)
    model = ReachableModel(first.scene, DiscreteActionSpace(), REACH, physics)
    near = model.perturbed(0.05, 0.0, np.random.default_rng(0))
    assert model.transition_model.simulator.physics == near.transition_model.simulator.physics == physics
