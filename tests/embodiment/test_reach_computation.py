"""The stored map against the models that it was computed from."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.reach import NUM_HEADINGS, RADIUS_STEP, ReachMap
from visualrhp.embodiment.reach_computation import CLEARANCE, CollisionModel, is_free, pose_at, reach_of
from visualrhp.embodiment.robot_model import HOME, Mounting, robot_spec

REACH = ReachMap.load()
KINEMATICS = ArmKinematics(reach=REACH)
COLLISIONS = CollisionModel(Mounting())


def test_a_sample_of_the_stored_map_is_computed_again() -> None:
    """Cells on both sides of where the reach begins and ends, and others."""
    rng = np.random.default_rng(0)
    borders = np.flatnonzero(np.diff(REACH.free[:, 0].astype(int)))
    cells = [(row + k, rng.integers(NUM_HEADINGS)) for row in borders for k in (-1, 0, 1, 2)]
    cells += [(rng.integers(len(REACH.free)), rng.integers(NUM_HEADINGS)) for _ in range(40)]
    for row, column in cells:
        corners = [(row + a, column + b) for a, b in ((0, 0), (0, 1), (1, 0), (1, 1), (0.5, 0.5))]
        points = [pose_at(Mounting(), r * RADIUS_STEP, 2.0 * np.pi * h / NUM_HEADINGS) for r, h in corners]
        expected = row < len(REACH.free) and REACH.free[row, column]
        assert all(is_free(KINEMATICS, COLLISIONS, point) for point in points) == expected


def test_a_pose_in_a_free_cell_is_free_wherever_the_flange_is() -> None:
    """Turning joint 1 changes nothing: the map has no dimension for it."""
    rng = np.random.default_rng(1)
    poses = np.concatenate([rng.uniform(-0.33, 0.33, (400, 2)), rng.uniform(-np.pi, np.pi, (400, 1))], axis=1)
    for pose in poses[REACH.contains(poses)][:80]:
        assert is_free(KINEMATICS, COLLISIONS, pose)


def test_poses_at_a_cell_are_in_it() -> None:
    for row, column in ((60, 7), (100, 50), (150, 119)):
        single = np.zeros_like(REACH.free)
        single[row, column] = True
        pose = pose_at(Mounting(), (row + 0.5) * RADIUS_STEP, 2.0 * np.pi * (column + 0.5) / NUM_HEADINGS)
        assert ReachMap(Mounting(), single, workspace=2.0).contains(pose)


@pytest.mark.parametrize(
    ("joints", "touching"),
    [
        (HOME, []),
        ((0.0, -0.8, 2.9, -3.7, -1.57, 0.0), ("shoulder_link", "wrist_1_link")),
        ((0.0, 0.3, 0.3, -2.2, -1.57, 0.0), ("world", "upper_arm_link")),
    ],
)
def test_collisions(joints: tuple[float, ...], touching: list | tuple) -> None:
    found = COLLISIONS.touching(joints)
    assert found == [] if touching == [] else touching in found


def test_bodies_keep_their_clearance() -> None:
    """The distance of two links, from MuJoCo's other function, where they begin to touch."""
    mujoco = robot_package("mujoco")
    spec = robot_spec(Mounting())
    model = spec.compile()
    data = mujoco.MjData(model)
    links = [[k for k in range(model.ngeom) if model.geom_bodyid[k] == model.body(name).id and model.geom_contype[k]]
             for name in ("upper_arm_link", "wrist_2_link")]  # fmt: skip
    for radius in np.arange(0.225, 0.25, 0.001):
        joints = data.qpos[:6] = KINEMATICS.inverse(*pose_at(Mounting(), radius, 1.0), near=HOME)
        mujoco.mj_kinematics(model, data)
        distance = min(mujoco.mj_geomDistance(model, data, a, b, 1.0, None) for a in links[0] for b in links[1])
        assert (("upper_arm_link", "wrist_2_link") in COLLISIONS.touching(joints)) == (distance < CLEARANCE)


def test_objects_of_20_cm_pass_below_the_arm() -> None:
    """All of the arm is higher, but what is on the axis of the flange, within the planner's outline of the palm."""
    mujoco = robot_package("mujoco")
    model = COLLISIONS.model
    data, table = mujoco.MjData(model), model.geom("table").id
    names = ("upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link")
    bodies = [model.body(name).id for name in names]
    links = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] in bodies and model.geom_contype[geom]]
    rows = np.flatnonzero(REACH.free.any(axis=1))
    for row in rows[::6]:
        data.qpos[:6] = KINEMATICS.inverse(*pose_at(Mounting(), (row + 0.5) * RADIUS_STEP, 1.0), near=HOME)
        mujoco.mj_kinematics(model, data)
        places, flange = data.geom_xpos, data.site("attachment_site").xpos
        beside = [k for k in links if places[k, 0] > -0.25 and np.hypot(*(places[k] - flange)[:2]) > 0.01]
        heights = [mujoco.mj_geomDistance(model, data, geom, table, 2.0, None) for geom in beside]
        assert min(heights, default=1.0) > 0.2


def test_the_stored_map_serves_all_mountings_at_its_height() -> None:
    mounting = Mounting(0.0, -0.6, 0.0, 0.0)
    assert (reach_of(mounting).free == REACH.free).all()
    assert reach_of(mounting).mounting == mounting


def test_the_command_explains_itself() -> None:
    command = [sys.executable, "-m", "visualrhp.embodiment.reach_computation", "--help"]
    assert "npz" in subprocess.run(command, capture_output=True, text=True, check=True).stdout
