"""The silhouette of the arm is that of MuJoCo's model, a little enlarged."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.embodiment.seen_bodies import top_camera
from visualrhp.embodiment.arm_silhouette import arm_mask, gripper_mask, link_poses
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.robot_model import HOME, Mounting, flange_to_gripper, robot_spec

MOUNTING = Mounting()
BODIES = ("base", "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")


@pytest.fixture(scope="module")
def robot():
    mujoco = robot_package("mujoco")

    spec = robot_spec(MOUNTING)
    camera = top_camera(position=(0.0, 0.0, 1.4), focal_length=1000.0)
    field = math.degrees(2.0 * math.atan(0.5 * camera.height / 1000.0))
    spec.worldbody.add_camera(name="top", pos=[0.0, 0.0, 1.4], fovy=field)
    model = spec.compile()
    return model, mujoco.MjData(model), camera


def test_links_are_where_the_model_has_them(robot) -> None:
    mujoco = robot_package("mujoco")

    model, data, _ = robot
    rng = np.random.default_rng(0)
    for positions in rng.uniform(-3.0, 3.0, (10, 6)):
        data.qpos[:6] = positions
        mujoco.mj_kinematics(model, data)
        poses = link_poses(positions, MOUNTING)
        for pose, name in zip(poses, BODIES, strict=False):
            assert pose[:3, 3] == pytest.approx(data.body(name).xpos, abs=1e-6)
        site = data.site("attachment_site")
        assert poses[-1][:3, 3] == pytest.approx(site.xpos, abs=1e-6)
        assert poses[-1][:3, :3] == pytest.approx(site.xmat.reshape(3, 3), abs=1e-6)


def test_a_moved_base_moves_everything() -> None:
    before = link_poses(HOME, Mounting(0.0, 0.0, 0.0, 0.0))
    after = link_poses(HOME, Mounting(-0.3, 0.2, 0.1, math.pi / 2))
    assert after[:, :3, 3] == pytest.approx(before[:, :3, 3] @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] + (-0.3, 0.2, 0.1))


def test_the_mask_covers_what_is_rendered_and_little_more(robot) -> None:
    mujoco = robot_package("mujoco")

    model, data, camera = robot
    with mujoco.Renderer(model, camera.height, camera.width) as renderer:
        renderer.enable_segmentation_rendering()
        for turn in (0.0, 1.0, -1.5):
            positions = np.array(HOME) + (0.3 * turn, 0.0, 0.0, 0.0, 0.0, turn)
            data.qpos[:] = 0.0
            data.qpos[:6] = positions
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera="top")
            seen = renderer.render()[..., 0] >= 0
            mask = arm_mask(camera, positions, 0.085, MOUNTING)
            assert (seen & ~mask).sum() < 0.005 * seen.sum()
            assert (mask & ~seen).sum() < 0.6 * seen.sum()


def test_a_margin_of_zero_is_smaller_and_the_gripper_is_a_part() -> None:
    camera = top_camera(focal_length=900.0)
    wide, narrow = (arm_mask(camera, HOME, 0.085, MOUNTING, margin) for margin in (0.01, 0.0))
    assert not (narrow & ~wide).any() and wide.sum() > narrow.sum()
    gripper = gripper_mask(camera, HOME, 0.085, MOUNTING)
    assert gripper.any() and not (gripper & ~narrow).any()


def test_the_gripper_frame_is_in_the_mask_of_a_closed_gripper() -> None:
    camera = top_camera(focal_length=900.0)
    frame = (link_poses(HOME, MOUNTING)[-1] @ flange_to_gripper())[:3, 3]
    column, row = np.round(camera.project(frame)[0]).astype(int)
    assert gripper_mask(camera, HOME, 0.0, MOUNTING)[row, column]
