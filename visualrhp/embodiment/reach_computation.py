"""Computes the map of the reach (:mod:`visualrhp.embodiment.reach`)::

    python -m visualrhp.embodiment.reach_computation visualrhp/embodiment/reach_map.npz

The arm is set to the corners and the centre of every cell in MuJoCo, whose collision geometry of the arm, the bracket
and the gripper is that of the simulated cell, above a table without end.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.reach import LEAVING_DISTANCE, NUM_HEADINGS, RADIUS_STEP, ReachMap
from visualrhp.embodiment.robot_model import FLANGE_BEHIND, HOME, Mounting, robot_spec
from visualrhp.errors import DataError, UnreachableError
from visualrhp.types import FloatArray

CLEARANCE: Final = LEAVING_DISTANCE
"""Least distance between parts of the arm, and between the arm and the table [m]."""

TABLE_CLEARANCE: Final = 0.004
"""Least distance of the gripper from the table [m]; its base is 7.5 mm above it."""

_BASE_RADIUS = 0.08  # of the base and a pedestal below it; the flange of a UR5e's base has a radius of 74.5 mm
_BASE_HEIGHT = 0.09  # of the immobile part of the base
_FAR = 4.0


class CollisionModel:
    """The arm with bracket and gripper, and the table as a plane, to be tested for collisions.

    Args:
        mounting: of the base.
    """

    def __init__(self, mounting: Mounting) -> None:
        mujoco = robot_package("mujoco")
        spec = robot_spec(mounting)
        table = spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[_FAR, _FAR, 0.1])
        base = spec.body("base").add_geom(name="base", type=mujoco.mjtGeom.mjGEOM_CYLINDER)
        below = max(mounting.height - CLEARANCE, 0.0)  # a pedestal
        base.pos, base.size = (
            [0.0, 0.0, 0.5 * (_BASE_HEIGHT - below)],
            [_BASE_RADIUS, 0.5 * (_BASE_HEIGHT + below), 0.0],
        )
        for body in ("base", "world"):  # the shoulder turns on the base
            spec.add_exclude(bodyname1="shoulder_link", bodyname2=body)
        self._mujoco: Any = mujoco
        self.model: Any = spec.compile()
        self._data: Any = mujoco.MjData(self.model)
        self.model.geom_margin[:] = CLEARANCE
        self._table: int = self.model.geom(table.name).id
        for geom, body in enumerate(self.model.geom_bodyid):
            # What is fixed to the flange does not collide among itself, and visual geometry not at all.
            name, solid = self.model.body(body).name, self.model.geom_contype[geom] != 0
            is_tool = name.startswith("gripper/") or name in ("bracket", "wrist_3_link")
            self.model.geom_contype[geom] = 0 if not solid else 2 if is_tool else 1
            self.model.geom_conaffinity[geom] = 0 if not solid else 1 if is_tool else 3

    def touching(self, joints: npt.ArrayLike) -> list[tuple[str, str]]:
        """Pairs of bodies that are closer than their clearance at ``joints`` [6], the fingers open."""
        mujoco, model, data = self._mujoco, self.model, self._data
        data.qpos[:6] = joints
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = set()
        for contact in data.contact[: data.ncon]:
            clearance = TABLE_CLEARANCE if self._table in (contact.geom1, contact.geom2) else CLEARANCE
            if contact.dist < clearance:
                first, second = model.geom_bodyid[[contact.geom1, contact.geom2]]
                pairs.add((model.body(first).name, model.body(second).name))
        return sorted(pairs)


def reach_of(mounting: Mounting) -> ReachMap:
    """The map for ``mounting``: the package's if it is for this height, otherwise computed, in about 20 s."""
    try:
        return ReachMap.load(mounting)
    except DataError:
        return compute(mounting)


def compute(mounting: Mounting | None = None) -> ReachMap:
    """Compute the map for ``mounting``: a cell is free if its centre and its corners are.

    Raises:
        ConfigError: the robot's packages are not installed.
    """
    mounting = mounting or Mounting()
    everything = ReachMap(mounting, np.ones((1, NUM_HEADINGS), dtype=bool), workspace=math.inf)
    kinematics, collisions = ArmKinematics(mounting, reach=everything), CollisionModel(mounting)
    count = math.ceil(kinematics.ring()[1] / RADIUS_STEP)
    half_radius, half_heading = 0.5 * RADIUS_STEP, math.pi / NUM_HEADINGS
    radii = np.array([RADIUS_STEP * k for k in range(count + 1)])
    headings = np.array([2.0 * half_heading * k for k in range(NUM_HEADINGS)])
    corners = _free_at(kinematics, collisions, radii, headings)
    centres = _free_at(kinematics, collisions, radii[:-1] + half_radius, headings + half_heading)
    corners &= np.roll(corners, -1, axis=1)
    return ReachMap(mounting, corners[:-1] & corners[1:] & centres)


def pose_at(mounting: Mounting, radius: float, heading: float) -> FloatArray:
    """[3] pose of the gripper with the flange ``radius`` [m] in front of the base and a relative ``heading`` [rad].

    The flange lies in the direction from the base to the centre of the table.
    """
    direction = math.atan2(-mounting.y, -mounting.x)
    theta = direction + heading
    x = mounting.x + radius * math.cos(direction) + FLANGE_BEHIND * math.cos(theta)
    y = mounting.y + radius * math.sin(direction) + FLANGE_BEHIND * math.sin(theta)
    return np.array([x, y, theta])


def is_free(kinematics: ArmKinematics, collisions: CollisionModel, pose: FloatArray) -> bool:
    """Whether the level gripper can be at ``pose`` [3]: there is a solution within the limits, without collision."""
    try:
        joints = kinematics.inverse(*pose, near=HOME)
    except UnreachableError:
        return False
    return not collisions.touching(joints)


def _free_at(
    kinematics: ArmKinematics, collisions: CollisionModel, radii: FloatArray, headings: FloatArray
) -> npt.NDArray[np.bool_]:
    """[R, H] whether each combination is free."""
    mounting = kinematics.mounting
    return np.array([[is_free(kinematics, collisions, pose_at(mounting, r, h)) for h in headings] for r in radii])


def main() -> None:
    """Compute the map of the default mounting, and write it."""
    parser = argparse.ArgumentParser(prog="python -m visualrhp.embodiment.reach_computation", description=main.__doc__)
    parser.add_argument("path", type=Path, help="the npz file that is written")
    path = parser.parse_args().path
    compute().save(path)


if __name__ == "__main__":
    main()
