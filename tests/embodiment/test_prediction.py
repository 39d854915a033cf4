"""Objects that the arm hides are where the planner's model expects them."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.embodiment.planar_cell import PlanarCell, PlanarKinematics, PlanarPerception, planar_task
from visualrhp.embodiment.prediction import is_desired_hidden, seems_reached, with_hidden_predicted
from visualrhp.embodiment.robot_world import RobotWorld
from visualrhp.scene.scene import Scene
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.types import State

TASK = planar_task(num_objects=3)


@dataclass(frozen=True)
class Track:
    id: int
    is_hidden: bool = False
    is_held: bool = False
    is_dropped: bool = False


@dataclass(frozen=True)
class View:
    scene: Scene
    state: State
    tracks: tuple[Track, ...]


def moved(state: State, shift: float) -> State:
    poses = state.object_poses + (shift, 0.0, 0.1)
    return State.create(state.gripper_pose, state.gripper_opening, False, poses)


LAST = View(TASK.scene, TASK.state, (Track(4), Track(7), Track(9)))


def predicted_poses(*tracks, last=LAST, shift=0.01):
    view = View(TASK.scene, TASK.state, tracks)
    return with_hidden_predicted(view, last, moved(TASK.state, shift)).state.object_poses


def test_only_what_is_hidden_is_predicted():
    seen, expected = TASK.state.object_poses, moved(TASK.state, 0.01).object_poses
    poses = predicted_poses(Track(4), Track(7, is_hidden=True), Track(9, is_hidden=True, is_held=True))
    np.testing.assert_array_equal(poses, [seen[0], expected[1], seen[2]])
    np.testing.assert_array_equal(predicted_poses(Track(4), Track(7), Track(9)), seen)
    np.testing.assert_array_equal(predicted_poses(Track(4), Track(7), Track(9, is_hidden=True, is_dropped=True)), seen)


def test_tracks_are_told_apart_by_their_numbers():
    expected = moved(TASK.state, 0.01).object_poses
    poses = predicted_poses(Track(9, is_hidden=True), Track(4, is_hidden=True), Track(11, is_hidden=True))
    np.testing.assert_array_equal(poses, [expected[2], expected[0], TASK.state.object_poses[2]])


def test_a_drop_has_to_be_seen():
    poses = predicted_poses(Track(4, is_hidden=True), Track(7), Track(9), shift=1.0)
    assert abs(poses[0, 0]) < 0.25 and abs(poses[0, 1]) < 0.25
    way = TASK.state.object_poses[0, :2] + (1.0, 0.0) - TASK.scene.target.position
    part = poses[0, :2] - TASK.scene.target.position
    assert way[0] * part[1] == pytest.approx(way[1] * part[0]), "on the way from the target region"
    assert max(np.abs(poses[0, :2])) > 0.245


def test_a_view_without_tracks_is_as_it_was():
    view = object()
    assert with_hidden_predicted(view, LAST, TASK.state) is view
    assert with_hidden_predicted(LAST, view, TASK.state) is LAST


class Hiding(PlanarPerception):
    """All objects are hidden after the first two looks; keeps what is expected."""

    def __init__(self, cell):
        super().__init__(cell)
        self.num_looks, self.expected = 0, []

    def perceive(self, frame, arm, gripper, closed) -> Any:
        view = super().perceive(frame, arm, gripper, closed)
        self.num_looks += 1
        hidden = self.num_looks > 2
        if not hidden:
            self.poses = view.state.object_poses
        state = State.create(view.state.gripper_pose, view.state.gripper_opening, closed, self.poses)
        return View(view.scene, state, tuple(Track(number, hidden) for number in range(3)))

    def expect(self, poses):
        self.expected.append(poses)


def test_a_robot_that_hides_what_it_pushes_believes_its_model():
    """In a cell that is the model, the belief is the truth, over several motions."""
    cell = PlanarCell(TASK)
    space = make_action_space("continuous")
    model = TransitionModel(TASK.scene, space)
    perception = Hiding(cell)
    world = RobotWorld(cell, perception, PlanarKinematics(), space)
    world.imagine = model.advance
    world.observe()
    moved_by, state = 0.0, TASK.state
    rng = np.random.default_rng(3)
    for _ in range(5):
        towards = TASK.state.object_positions[0] - cell.state.gripper_position
        theta = cell.state.gripper_pose[2]
        ahead = [
            np.cos(theta) * towards[0] + np.sin(theta) * towards[1],
            np.cos(theta) * towards[1] - np.sin(theta) * towards[0],
        ]
        world.act(np.clip([8.0 * ahead[0], 8.0 * ahead[1], 0.2 * rng.normal(), 1.0], -1.0, 1.0))
        _, state = world.observe()
        moved_by = np.abs(cell.state.object_poses - TASK.state.object_poses).max()
        np.testing.assert_allclose(state.object_positions, cell.state.object_positions, atol=2e-3)
    assert moved_by > 0.02, "something was pushed"
    np.testing.assert_allclose(perception.expected[-1][0], state.object_poses[0], atol=1e-12)


@pytest.mark.parametrize("distance", [0.03, 0.1])
@pytest.mark.parametrize("is_hidden", [True, False])
def test_what_a_view_tells_of_the_goal(is_hidden, distance) -> None:
    poses = TASK.state.object_poses.copy()
    poses[0, :2] = TASK.scene.target.position + (distance, 0.0)
    state = State.create(TASK.state.gripper_pose, 0.085, False, poses)
    view = View(TASK.scene, state, (Track(0, is_hidden, False), Track(1, True, False)))
    assert seems_reached(view) == (distance < 0.07)
    assert is_desired_hidden(view) == is_hidden
    without = SimpleNamespace(scene=TASK.scene, state=state)
    assert not seems_reached(without) and not is_desired_hidden(without)
