"""The abstract image against what one draws by hand, and under motion, rotation and mirroring."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.observation.label_image import (
    IMAGE_SIZE,
    PALETTE,
    VIEW_BEHIND,
    VIEW_SIDE,
    Label,
    colour_image,
    label_image,
    mirror_image,
)
from visualrhp.scene import ObjectShape, Scene, SceneDistribution, TargetRegion, geometry, sample_task_instance
from visualrhp.streams import Split
from visualrhp.types import State

SQUARE = ObjectShape([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]])
METRE = IMAGE_SIZE / VIEW_SIDE


def pixel(forward: float, left: float) -> tuple[int, int]:
    """Row and column of a point of the gripper frame [m]."""
    return int(IMAGE_SIZE - (VIEW_BEHIND + forward) * METRE), int(IMAGE_SIZE / 2 - left * METRE)


def test_each_thing_is_where_it_should_be() -> None:
    """Gripper at the lower edge of the surface, heading up the world's y axis: x right is the gripper's right."""
    scene = Scene(TargetRegion([-0.15, 0.05]), (SQUARE, SQUARE))
    state = State.create([0.0, -0.2, np.pi / 2], 0.085, False, [[0.1, 0.0, 0.0], [0.0, 0.15, 0.5]])
    image = label_image(scene, state)
    assert image.shape == (64, 64)
    assert image.dtype == np.uint8
    assert image[pixel(0.2, -0.1)] == Label.DESIRED_OBJECT
    assert image[pixel(0.35, 0.0)] == Label.OBSTACLE
    assert image[pixel(0.25, 0.15)] == Label.TARGET
    assert image[pixel(0.1, 0.0)] == Label.BACKGROUND
    assert image[pixel(-0.06, 0.0)] == Label.GRIPPER  # palm
    assert image[pixel(0.0, 0.049)] == Label.GRIPPER  # left finger
    assert image[pixel(0.0, -0.049)] == Label.GRIPPER  # right finger
    assert image[pixel(0.0, 0.0)] == Label.BACKGROUND  # between the fingers
    assert image[pixel(0.0, 0.27)] == Label.EDGE
    assert image[pixel(-0.15, 0.0)] == Label.EDGE


def test_area_of_a_square_in_pixels() -> None:
    scene = Scene(TargetRegion([-0.2, -0.2]), (SQUARE,))
    image = label_image(scene, State.create([-0.2, 0.0, 0.0], 0.0, True, [[0.1, 0.0, 0.0]]))
    assert np.count_nonzero(image == Label.DESIRED_OBJECT) == pytest.approx((0.06 * METRE) ** 2, rel=0.35)


def test_closing_moves_the_fingers() -> None:
    scene = Scene(TargetRegion([-0.2, -0.2]), (SQUARE,))
    closed = label_image(scene, State.create([-0.2, 0.0, 0.0], 0.0, True, [[0.1, 0.0, 0.0]]))
    assert closed[pixel(0.0, 0.006)] == Label.GRIPPER
    assert closed[pixel(0.0, 0.049)] == Label.BACKGROUND


def moved(instance_scene: Scene, state: State, turn: float, shift: tuple[float, float]) -> tuple[Scene, State]:
    """Scene and state turned about the origin and shifted, everything together."""
    pose = (*shift, turn)
    poses = state.object_poses.copy()
    poses[:, :2], poses[:, 2] = geometry.to_world(poses[:, :2], pose), poses[:, 2] + turn
    robot = np.array([*geometry.to_world(state.gripper_pose[:2], pose), state.gripper_pose[2] + turn])
    scene = Scene(
        TargetRegion(geometry.to_world(instance_scene.target.position, pose), instance_scene.target.radius),
        instance_scene.objects,
        geometry.to_world(instance_scene.edges, pose),
        instance_scene.gripper,
    )
    return scene, State.create(robot, state.gripper_opening, state.gripper_closed, poses)


def test_the_image_is_robot_centric() -> None:
    """Moving and turning the world with the gripper leaves the image as it is, but for the rounding of vertices."""
    for index in range(10):
        instance = sample_task_instance(SceneDistribution(), 0, Split.TUNING, index)
        image = label_image(instance.scene, instance.state)
        again = label_image(*moved(instance.scene, instance.state, 0.1 + 0.6 * index, (0.3, -0.7)))
        assert np.count_nonzero(image != again) <= 8


def test_mirrored_scene_gives_the_mirrored_image() -> None:
    for index in range(10):
        instance = sample_task_instance(SceneDistribution(), 0, Split.TUNING, index)
        scene, state = instance.scene, instance.state
        flip = (1.0, -1.0)
        mirrored_scene = Scene(
            TargetRegion(scene.target.position * flip, scene.target.radius),
            tuple(ObjectShape.centred(shape.outline[::-1] * flip) for shape in scene.objects),
            scene.edges[::-1] * flip,
        )
        mirrored_state = State.create(
            state.gripper_pose * (1, -1, -1), state.gripper_opening, False, state.object_poses * (1, -1, -1)
        )
        image = mirror_image(label_image(scene, state))
        # OpenCV fills the border of a polygon with a rule that is not symmetric: a few pixels on outlines differ
        assert np.count_nonzero(image != label_image(mirrored_scene, mirrored_state)) < 0.02 * image.size


def test_colours_are_those_of_section_5_1() -> None:
    colours = {label.name: tuple(int(c) for c in PALETTE[label]) for label in Label}
    assert colours["BACKGROUND"] == (255, 255, 255)
    assert colours["EDGE"] == (0, 0, 0)
    assert colours["OBSTACLE"] == (255, 0, 0)
    assert colours["GRIPPER"] == (0, 0, 255)
    assert colour_image(np.array([[Label.GRIPPER]], dtype=np.uint8)).tolist() == [[[0, 0, 255]]]
