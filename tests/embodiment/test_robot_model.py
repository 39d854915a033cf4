"""The arm, the bracket and the gripper against the models that they are made of."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.robot_model import (
    CELL_GRIPPER,
    FLANGE_ABOVE,
    FLANGE_BEHIND,
    GRIPPER_FRAME_DISTANCE,
    GRIPPER_HEIGHT,
    HOME,
    PLATE,
    Mounting,
    flange_to_gripper,
    flange_to_mount,
    robot_spec,
)


@pytest.fixture(scope="module")
def model() -> Any:
    return robot_spec(Mounting()).compile()


def posed(model: Any, joints: Any = HOME, fingers: float = 0.0) -> Any:
    """The model with the arm at ``joints``, and the fingers where the actuator holds them at the signal ``fingers``."""
    mujoco = robot_package("mujoco")
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0.0
    data.qpos[:6] = data.ctrl[:6] = joints
    data.ctrl[6] = fingers
    for _ in range(400):
        mujoco.mj_step(model, data)
    return data


def transform(position: Any, rotation: Any) -> Any:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.reshape(rotation, (3, 3)), position
    return pose


def in_gripper_frame(data: Any, points: Any) -> Any:
    flange = data.site("attachment_site")
    gripper = transform(flange.xpos, flange.xmat) @ flange_to_gripper()
    return (np.asarray(points) - gripper[:3, 3]) @ gripper[:3, :3]


@pytest.mark.parametrize("pose", [flange_to_mount(), flange_to_gripper(), Mounting(0.1, 0.2, 0.3, 0.7).base_transform])
def test_transforms_are_rigid(pose: Any) -> None:
    assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3))
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_the_mount_lies_behind_the_gripper_frame_on_its_axis() -> None:
    mount = np.linalg.inv(flange_to_gripper()) @ flange_to_mount()
    assert np.allclose(mount[:3, 3], [-GRIPPER_FRAME_DISTANCE, 0.0, 0.0])
    assert np.allclose(mount[:3, 2], [1.0, 0.0, 0.0])  # z towards the fingertips
    assert np.allclose(mount[:3, 0], [0.0, 1.0, 0.0])  # x to the left


def test_the_arm_at_home_holds_the_gripper_level(model: Any) -> None:
    flange = posed(model).site("attachment_site")
    gripper = transform(flange.xpos, flange.xmat) @ flange_to_gripper()
    assert math.degrees(math.acos(min(1.0, gripper[2, 2]))) < 1.0


def test_the_pads_are_on_both_sides_of_the_gripper_frame(model: Any) -> None:
    data = posed(model)
    for side, name in ((1, "right"), (-1, "left")):  # Menagerie's right is at positive x of the mount, to the left
        tip, middle = in_gripper_frame(data, [data.geom(f"gripper/{name}_pad{k}").xpos for k in (1, 2)])
        assert side * tip[1] == pytest.approx(0.5 * CELL_GRIPPER.stroke + 0.004, abs=1e-3)
        assert tip[2] == pytest.approx(0.0, abs=1e-3)
        assert middle[0] < 0.0 < tip[0] + 0.0095 < CELL_GRIPPER.finger_reach


@pytest.mark.parametrize(("signal", "opening"), [(0.0, CELL_GRIPPER.stroke), (255.0, 0.0)])
def test_the_planners_outline_covers_the_gripper(model: Any, signal: float, opening: float) -> None:
    """Every vertex of bracket and gripper, seen from above, is within 14 mm of the planner's outline, most are in it.

    The linkages of the open fingers are wider than the palm, and closed fingers reach 8.5 mm farther, on their arcs.
    """
    import shapely

    data = posed(model, fingers=signal)
    outline = shapely.union_all([shapely.Polygon(p) for p in CELL_GRIPPER.outlines([0.0, 0.0, 0.0], opening)])
    points = []
    for k in range(model.ngeom):
        name = model.body(model.geom_bodyid[k]).name
        if not (name.startswith("gripper/") or name == "bracket"):
            continue
        if model.geom_dataid[k] >= 0:
            start, count = (a[model.geom_dataid[k]] for a in (model.mesh_vertadr, model.mesh_vertnum))
            local = model.mesh_vert[start : start + count]
        else:
            local = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T * model.geom_size[k]
        points.append(in_gripper_frame(data, local @ data.geom_xmat[k].reshape(3, 3).T + data.geom_xpos[k]))
    seen = np.concatenate(points)
    low = seen[seen[:, 2] < FLANGE_ABOVE - 2 * PLATE]
    distances = shapely.distance(outline, shapely.points(low[:, :2]))
    assert distances.max() < 14.5e-3
    assert (distances < 1e-3).mean() > 0.85
    assert seen[:, 2].min() > -GRIPPER_HEIGHT + 5e-3  # nothing touches the table


def test_the_flange_is_above_what_passes_below_the_wrist() -> None:
    assert flange_to_gripper()[:3, 3] == pytest.approx([0.0, FLANGE_BEHIND, FLANGE_ABOVE])


def test_the_mounting_moves_the_arm() -> None:
    here, there = (robot_spec(Mounting(yaw=yaw)).compile() for yaw in (0.0, 0.5 * math.pi))
    first, second = (posed(m).site("attachment_site").xpos - [Mounting().x, Mounting().y, 0.0] for m in (here, there))
    assert second == pytest.approx([-first[1], first[0], first[2]], abs=1e-6)
