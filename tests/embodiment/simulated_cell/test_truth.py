import numpy as np
import pytest
import shapely

from tests.embodiment.simulated_cell.cells import APPLE, BOX, CUP, LYING_BOTTLE
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.robot_model import CELL_GRIPPER
from visualrhp.embodiment.simulated_cell.task import CellTask
from visualrhp.embodiment.simulated_cell.truth import GroundTruth, ground_truth
from visualrhp.scene import geometry
from visualrhp.simulation import rules

THINGS = (APPLE, BOX, CUP, LYING_BOTTLE)
POSES = np.array([[0.1, 0.1, 0.0], [-0.1, 0.0, 0.5], [0.0, -0.15, 0.0], [0.1, -0.05, 2.0]])


def truth_of(positions=None, rotations=None, opening: float = 0.05) -> GroundTruth:
    if rotations is None:
        rotations = np.array([thing.rotation(pose[2]) for thing, pose in zip(THINGS, POSES, strict=True)])
    if positions is None:
        positions = np.column_stack([POSES[:, :2], [0.04] * 4])
    pose = np.array([-0.2, 0.0, 0.3])
    return ground_truth(CellTask(THINGS, POSES), positions, rotations, pose, opening, False)


def test_outlines_are_where_the_objects_are() -> None:
    truth = truth_of()
    assert truth.kinds == (Kind.APPLE, Kind.BOX, Kind.CUP, Kind.BOTTLE)
    assert truth.is_lying == (False, False, False, True)
    assert truth.is_fallen == (False,) * 4
    assert truth.scene.gripper == CELL_GRIPPER
    assert truth.state.gripper_pose.tolist() == [-0.2, 0.0, 0.3]
    assert truth.state.object_positions[:3] == pytest.approx(POSES[:3, :2], abs=2e-4)
    corners = np.array([[0.035, 0.025], [-0.035, 0.025], [-0.035, -0.025], [0.035, -0.025]])
    expected = shapely.Polygon(geometry.to_world(corners, POSES[1]))
    assert shapely.Polygon(truth.outlines[1]).symmetric_difference(expected).area < 1e-6


def test_the_scene_is_that_of_the_outlines() -> None:
    truth = truth_of()
    for shape, pose, outline in zip(truth.scene.objects, truth.state.object_poses, truth.outlines, strict=True):
        planned, exact = shapely.Polygon(geometry.to_world(shape.outline, pose)), shapely.Polygon(outline)
        assert planned.intersection(exact).area / planned.union(exact).area > 0.9
        assert planned.centroid.distance(exact.centroid) < 5e-4


def test_a_lying_bottle_is_centred_at_its_outline_not_at_half_its_length() -> None:
    offset = truth_of().state.object_positions[3] - POSES[3, :2]
    along = np.array([np.cos(2.0), np.sin(2.0)])
    assert offset @ along < -0.005, "towards the bottom, which is wider"
    assert abs(offset @ (-along[1], along[0])) < 3e-4


@pytest.mark.parametrize("place", [(0.3, 0.0), (0.1, -0.05), (0.0, 0.0), (-0.24, 0.1)])
def test_what_fell_counts_as_dropped_wherever_it_rolled(place) -> None:
    positions = np.column_stack([POSES[:, :2], [0.04] * 4])
    positions[2] = (*place, -0.71)
    truth = truth_of(positions)
    assert truth.is_fallen == (False, False, True, False)
    assert rules.dropped_objects(truth.scene, truth.state) == [2]
    if max(np.abs(place)) > 0.28:
        assert truth.state.object_positions[2] == pytest.approx(place, abs=2e-4), "it stays where it is"


def test_the_opening_is_one_of_the_gripper() -> None:
    assert truth_of(opening=0.09).state.gripper_opening == CELL_GRIPPER.stroke
    assert truth_of(opening=-1e-4).state.gripper_opening == 0.0
