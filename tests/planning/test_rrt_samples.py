"""Samples of the kinodynamic RRT: their distances in two ways, and the poses to which they lead the gripper."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from visualrhp.planning import KinodynamicRRT
from visualrhp.planning.rrt_samples import ExploringSample, PushingSample, Sample
from visualrhp.scene import ObjectShape, Scene, TargetRegion, geometry
from visualrhp.types import Column, FloatArray, State, wrap_angle

BOX = ObjectShape([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]])
EDGES = [[-0.3, -0.1], [0.5, -0.1], [0.5, 0.2], [-0.3, 0.2]]
SCENE = Scene(TargetRegion([0.35, 0.05], 0.06), (BOX, BOX, BOX), EDGES)
START = State.create([-0.2, 0.0, 0.4], 0.085, False, [[0.0, 0.05, 0.1], [0.1, -0.05, 0.0], [0.2, 0.15, 2.0]])
GRIPPER_ONLY: dict[str, Any] = {"object_weight": 0.0, "obstacle_weight": 0.0}


def exploring(seed: int, **parameters: Any) -> ExploringSample:
    return ExploringSample(KinodynamicRRT(**parameters), SCENE, np.random.default_rng(seed))


def pushing(seed: int, with_object: bool = True, **parameters: Any) -> PushingSample:
    return PushingSample(KinodynamicRRT(**parameters), SCENE, START, np.random.default_rng(seed), with_object)


def distance(sample: Sample, vector: FloatArray) -> float:
    """Squared, to one state."""
    return float(sample.squared_distances(vector[None])[0])


def with_gripper(vector: FloatArray, pose: tuple[float, float, float]) -> FloatArray:
    changed = vector.copy()
    changed[Column.GRIPPER_POSE] = pose
    return changed


def random_vectors(count: int) -> FloatArray:
    rng = np.random.default_rng(1)
    vectors = np.tile(START.vector, (count, 1))
    vectors[:, Column.OBJECTS] += rng.normal(0.0, 0.1, vectors[:, Column.OBJECTS].shape)
    vectors[:, Column.GRIPPER_POSE] = rng.uniform([-0.3, -0.1, -np.pi], [0.5, 0.2, np.pi], (count, 3))
    return vectors


def test_the_distance_to_a_gripper_pose_by_hand() -> None:
    sample = exploring(0, heading_weight=0.5, **GRIPPER_ONLY)
    x, y, theta = sample.gripper_pose(START.vector)
    for dx, dy, turn, expected in ((0.03, 0.04, 0.0, 0.0025), (0.0, 0.0, -0.2, 0.01), (0.1, 0.0, 0.2, 0.02)):
        assert distance(sample, with_gripper(START.vector, (x + dx, y + dy, theta + turn))) == pytest.approx(expected)


def test_a_full_turn_of_the_gripper_is_no_distance() -> None:
    for sample in (exploring(0), pushing(0), pushing(0, with_object=False)):
        vectors = random_vectors(20)
        turned = vectors.copy()
        turned[:, Column.GRIPPER_THETA] += 2.0 * np.pi
        assert sample.squared_distances(turned) == pytest.approx(sample.squared_distances(vectors), rel=1e-9)


@pytest.mark.parametrize(("column", "weight"), [(5, 2.0), (6, 2.0), (8, 0.5), (9, 0.5), (11, 0.5), (12, 0.5)])
def test_an_object_is_pulled_to_a_place_on_the_surface(column: int, weight: float) -> None:
    """A squared distance is w^2 (x - x_0)^2 + constant: three values tell w and x_0."""
    for seed in range(20):
        vectors = np.tile(START.vector, (3, 1))
        vectors[:, column] = [-1.0, 0.0, 1.0]
        left, middle, right = exploring(seed, object_weight=2.0, obstacle_weight=0.5).squared_distances(vectors)
        assert (left + right) / 2.0 - middle == pytest.approx(weight**2)
        sampled = (left - right) / 4.0 / weight**2
        low, high = ((-0.3, 0.5), (-0.1, 0.2))[(column - 5) % 3]
        assert low <= sampled <= high


@pytest.mark.parametrize("column", [Column.OPENING, Column.CLOSED, 7, 10, 13])
def test_openings_and_angles_of_objects_do_not_count(column: int) -> None:
    changed = START.vector.copy()
    changed[column] += 0.7
    for sample in (exploring(3), pushing(3), pushing(3, with_object=False)):
        assert distance(sample, changed) == distance(sample, START.vector)


def test_exploring_gripper_poses_fill_the_surface() -> None:
    poses = np.array([exploring(seed).gripper_pose(START.vector) for seed in range(300)])
    low, high = np.array([-0.3, -0.1, -np.pi]), np.array([0.5, 0.2, np.pi])
    assert (poses >= low).all() and (poses <= high).all()
    assert np.mean((poses - low) / (high - low), axis=0) == pytest.approx([0.5] * 3, abs=0.06)
    assert exploring(0).gripper_pose(START.vector) == exploring(0).gripper_pose(random_vectors(1)[0])


def test_many_states_are_measured_as_one_by_one() -> None:
    vectors = random_vectors(30)
    for sample in (exploring(5), pushing(5), pushing(5, with_object=False)):
        together = sample.squared_distances(vectors)
        assert together.shape == (30,) and (together > 0.0).all()
        assert together == pytest.approx([distance(sample, vector) for vector in vectors])


def test_the_same_generator_gives_the_same_sample() -> None:
    for make in (exploring, pushing):
        first, again, other = make(7), make(7), make(8)
        assert first.gripper_pose(START.vector) == again.gripper_pose(START.vector)
        assert distance(first, START.vector) == distance(again, START.vector) != distance(other, START.vector)


def test_an_approach_ends_where_the_gripper_is_led() -> None:
    """With the gripper there, and the obstacles as at the start, nothing is left of the distance."""
    for seed in range(20):
        sample = pushing(seed, with_object=False, standoff=0.08)
        pose = sample.gripper_pose(START.vector)
        assert distance(sample, with_gripper(START.vector, pose)) == pytest.approx(0.0, abs=1e-20)
        assert math.dist(pose[:2], START.object_poses[0, :2]) <= 0.08
        assert sample.gripper_pose(with_gripper(START.vector, pose)) == pose  # it is not led on


def test_a_gripper_behind_the_object_is_led_to_push_it_into_the_target_region() -> None:
    """It moves by the displacement that the object needs; the object's distance is that of its displacement."""
    for seed in range(50):
        sample = pushing(seed, object_weight=3.0)
        behind = sample.gripper_pose(START.vector)
        at_object = with_gripper(START.vector, behind)
        ahead = sample.gripper_pose(at_object)
        displacement = np.subtract(ahead, behind)
        assert displacement[2] == 0.0
        end = START.object_poses[0, :2] + displacement[:2]
        assert math.dist(end, SCENE.target.position) < SCENE.target.radius
        assert distance(sample, at_object) == pytest.approx(9.0 * math.hypot(*displacement[:2]) ** 2)


def test_a_pushing_gripper_is_behind_the_object_and_faces_the_target_region() -> None:
    """On average straight behind, and in nearly all samples within three standard deviations."""
    object_position = START.object_poses[0, :2]
    towards = np.arctan2(*(SCENE.target.position - object_position)[::-1])
    poses = np.array([pushing(seed, standoff=0.1).gripper_pose(START.vector) for seed in range(300)])
    headings = wrap_angle(poses[:, 2] - towards)
    assert headings.mean() == pytest.approx(0.0, abs=0.06)
    assert (np.abs(headings) < 1.2).mean() > 0.99
    ahead = geometry.to_body(poses[:, :2], (*object_position, towards))[:, 0]
    assert (ahead < 1e-3).all() and ahead.min() > -0.1 - 1e-12
    approaches = np.array([pushing(seed, with_object=False).gripper_pose(START.vector) for seed in range(300)])
    ahead = geometry.to_body(approaches[:, :2], (*object_position, towards))[:, 0]
    assert (ahead > 0.0).mean() == pytest.approx(0.5, abs=0.1)  # on any side


def test_a_gripper_that_is_not_behind_the_object_or_faces_away_does_not_push() -> None:
    sample = pushing(0)
    x, y, theta = sample.gripper_pose(START.vector)
    for elsewhere in ((x + 0.05, y, theta), (x, y - 0.05, theta), (x, y, theta + 1.5), (x, y, theta + math.pi)):
        assert sample.gripper_pose(with_gripper(START.vector, elsewhere)) == (x, y, theta)


def test_obstacles_should_stay_where_they_were() -> None:
    moved = START.vector.copy()
    moved[Column.OBSTACLES_X] += [0.03, 0.0]
    moved[Column.OBSTACLES_Y] += [0.04, 0.12]
    for with_object in (True, False):
        sample = pushing(2, with_object, obstacle_weight=0.5)
        assert distance(sample, moved) - distance(sample, START.vector) == pytest.approx(0.25 * (0.05**2 + 0.12**2))


def test_the_place_behind_the_object_moves_and_turns_with_the_task() -> None:
    """Samples at the centre of a tiny target region, in a task and in the task turned by 90 degrees."""
    poses = []
    for turn in (0.0, np.pi / 2):
        rotation = geometry.rotation_matrix(turn)
        scene = Scene(TargetRegion(rotation @ (0.15, 0.05), 1e-12), (BOX,))
        state = State.create([0, 0, 0], 0.085, False, [[*(rotation @ (-0.1, 0.02)), 0.0]])
        sample = PushingSample(KinodynamicRRT(), scene, state, np.random.default_rng(3), with_object=True)
        x, y, theta = sample.gripper_pose(state.vector)
        poses.append([*(rotation.T @ (x, y)), wrap_angle(theta - turn)])
    assert poses[0] == pytest.approx(poses[1], abs=1e-9)
