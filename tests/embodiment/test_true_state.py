"""The truth in place of the camera."""

import numpy as np

from tests.embodiment.planar_cell import planar_task
from visualrhp.embodiment.robot_cell import ArmState, CameraFrame, GripperState
from visualrhp.embodiment.true_state import TruePerception, TrueSegmenter, desired_first

TASK = planar_task(num_objects=4)
ARM, GRIPPER = ArmState(np.zeros(6), np.zeros(6), 0.0), GripperState(0.085, False, 0.0)


def test_the_desired_object_comes_first_and_the_others_keep_their_order():
    view = desired_first(TASK.scene, TASK.state, 2, closed=True)
    order = [2, 0, 1, 3]
    assert list(view.scene.objects) == [TASK.scene.objects[number] for number in order]
    np.testing.assert_array_equal(view.state.object_poses, TASK.state.object_poses[order])
    np.testing.assert_array_equal(view.state.gripper_pose, TASK.state.gripper_pose)
    assert view.state.gripper_closed and view.scene.target == TASK.scene.target
    first = desired_first(TASK.scene, TASK.state, 0, closed=False)
    assert (first.scene, first.state) == (TASK.scene, TASK.state)


def test_perception_and_segmentation_give_the_truth():
    perception = TruePerception(lambda: (TASK.scene, TASK.state), 1)
    view = perception.perceive(CameraFrame(np.zeros((0, 0, 3), np.uint8), 0.0), ARM, GRIPPER, False)
    assert view.scene.objects[0] == TASK.scene.objects[1] and not perception.needs_camera
    assert TrueSegmenter(lambda: ["a mask"]).segment(np.zeros((1, 1, 3), np.uint8)) == ["a mask"]
