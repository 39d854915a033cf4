"""The MuJoCo model of a cell: arm, table, floor, objects, target, lights and cameras."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.robot_model import flange_to_gripper, robot_spec
from visualrhp.embodiment.simulated_cell.looks import TARGET_RINGS, Texture, object_texture, surface_texture
from visualrhp.embodiment.simulated_cell.objects import CellObject, volume
from visualrhp.embodiment.simulated_cell.rendering import SIDE_VIEW_SIZE, rendered_size
from visualrhp.embodiment.simulated_cell.robot_meshes import use_coarse_meshes
from visualrhp.embodiment.simulated_cell.solids import Cuboid, Mesh, Revolution
from visualrhp.embodiment.simulated_cell.task import TABLE_SIDE, CellTask
from visualrhp.types import FloatArray

TIME_STEP: Final = 0.002
"""[s]; the gripper's constraints have time constants of 4 ms, which need twice the frequency."""

FLOOR: Final = -0.75
"""Height of the floor [m]: that of a table."""

TABLE_THICKNESS: Final = 0.03

STIFFNESS: Final = 10.0
"""Gain of the joints' position control over that of Menagerie's model: a real UR5e has integral control, and yields
by far less than a millimetre when it pushes."""

ARM_FRICTION: Final = 0.3
"""Coulomb coefficient of the gripper's metal and plastic."""

OBJECT_PREFIX: Final = "object_"
VISUAL_GROUP: Final = 2
COLLISION_GROUP: Final = 3

# Bits of MuJoCo's contype and conaffinity: objects touch everything; the robot touches objects only.
_ENVIRONMENT, _ROBOT = 1, 2


def cell_model(task: CellTask) -> Any:
    """Compile the model (``MjModel``) of ``task``; a function of it.

    Bodies of objects are called ``object_0`` and so on, the camera ``camera``, the gripper frame is the site
    ``gripper_frame``.

    Raises:
        ConfigError: the robot's packages are not installed.
    """
    mujoco = robot_package("mujoco")
    spec = robot_spec(task.mounting)
    use_coarse_meshes(spec)
    spec.option.timestep = TIME_STEP
    spec.option.iterations = 30
    spec.option.ls_iterations = 20
    width, height = (max(sizes) for sizes in zip(rendered_size(task.camera), SIDE_VIEW_SIZE, strict=True))
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.quality.offsamples = 0  # multisampling triples the time of a frame in software
    spec.visual.quality.shadowsize = 1024
    spec.visual.map.shadowclip = 1.6  # a smaller one leaves stripes on the floor
    spec.visual.map.znear, spec.visual.map.zfar = 0.05, 30.0
    spec.stat.extent, spec.stat.center = 1.0, [0.0, 0.0, 0.0]
    _prepare_robot(mujoco, spec, task)
    _add_surroundings(mujoco, spec, task)
    for number, (thing, pose) in enumerate(zip(task.objects, task.poses, strict=True)):
        _add_object(mujoco, spec, f"{OBJECT_PREFIX}{number}", thing, pose)
    _add_cameras(mujoco, spec, task)
    return spec.compile()


def _prepare_robot(mujoco: Any, spec: Any, task: CellTask) -> None:
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0
        for geom in body.geoms:
            if geom.contype:
                geom.contype, geom.conaffinity = _ROBOT, 0
                is_pad = geom.name.startswith(("gripper/right_pad", "gripper/left_pad"))
                geom.friction = [task.pad_friction if is_pad else ARM_FRICTION, 0.005, 0.0001]
                if is_pad:
                    geom.condim = 4
    for actuator in spec.actuators:
        if not actuator.name.startswith("gripper/"):
            actuator.gainprm[0] *= STIFFNESS
            actuator.biasprm[1] *= STIFFNESS
            actuator.biasprm[2] *= math.sqrt(STIFFNESS)
    transform = flange_to_gripper()
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, transform[:3, :3].ravel())
    spec.body("bracket").add_site(name="gripper_frame", pos=transform[:3, 3], quat=quat, size=[0.001] * 3, group=5)


def _add_surroundings(mujoco: Any, spec: Any, task: CellTask) -> None:
    world = spec.worldbody
    look = task.look
    spec.add_texture(
        name="wall",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.75, 0.78, 0.82],
        rgb2=[0.55, 0.57, 0.6],
        width=64,
        height=384,
    )
    table = _material(mujoco, spec, "table", surface_texture(look.table))
    floor = _material(mujoco, spec, "floor", surface_texture(look.floor))
    half = 0.5 * TABLE_SIDE
    _add_mesh(spec, "table_top", _plane(TABLE_SIDE, 1.0))
    _add_mesh(spec, "floor_tiles", _plane(6.0, 6.0))
    static = {"contype": _ENVIRONMENT, "conaffinity": _ENVIRONMENT, "condim": 3}
    world.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.0, 0.0, -0.5 * TABLE_THICKNESS],
        size=[half, half, 0.5 * TABLE_THICKNESS],
        friction=[task.table_friction, 0.005, 0.0001],
        rgba=[0.35, 0.33, 0.3, 1.0],
        **static,
    )
    world.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0.0, 0.0, FLOOR],
        size=[3.0, 3.0, 0.1],
        friction=[0.6, 0.01, 0.02],
        group=COLLISION_GROUP,
        contype=_ENVIRONMENT,
        conaffinity=_ENVIRONMENT,
        condim=6,
    )
    seen = {"type": mujoco.mjtGeom.mjGEOM_MESH, "contype": 0, "conaffinity": 0, "group": VISUAL_GROUP}
    world.add_geom(name="table_look", meshname="table_top", pos=[0.0, 0.0, 0.0002], material=table, **seen)
    world.add_geom(name="floor_look", meshname="floor_tiles", pos=[0.0, 0.0, FLOOR], material=floor, **seen)
    metal = {"contype": 0, "conaffinity": 0, "rgba": [0.3, 0.3, 0.32, 1.0], "type": mujoco.mjtGeom.mjGEOM_CYLINDER}
    legs = 0.5 * (FLOOR - TABLE_THICKNESS)
    world.add_geom(name="leg", pos=[0.0, 0.0, legs], size=[0.05, -0.5 * (FLOOR + TABLE_THICKNESS), 0.0], **metal)
    base = task.mounting
    column = 0.5 * (base.height - FLOOR)
    world.add_geom(name="column", pos=[base.x, base.y, FLOOR + column], size=[0.09, column, 0.0], **metal)
    x, y = task.target.position.tolist()
    scale = task.target.radius / TARGET_RINGS[0][0]
    for number, (radius, colour) in enumerate(TARGET_RINGS):
        world.add_geom(
            name=f"target_{number}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=[x, y, 0.0004 + 0.0003 * number],
            size=[scale * radius, 0.0001, 0.0],
            rgba=[*colour, 1.0],
            contype=0,
            conaffinity=0,
        )
    spec.visual.headlight.ambient = [look.ambient] * 3
    spec.visual.headlight.diffuse = [0.15] * 3
    spec.visual.headlight.specular = [0.05] * 3
    for number, light in enumerate(look.lights):
        direction = np.array(light.direction) / np.linalg.norm(light.direction)
        world.add_light(
            name=f"light_{number}",
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=(-1.5 * direction).tolist(),
            dir=direction.tolist(),
            diffuse=[light.brightness] * 3,
            specular=[0.3 * light.brightness] * 3,
            ambient=[0.0] * 3,
            castshadow=light.casts_shadow,
        )


def _add_object(mujoco: Any, spec: Any, name: str, thing: CellObject, pose: FloatArray) -> None:
    rotation = thing.rotation(float(pose[2]))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, rotation.ravel())
    height = thing.solid.clearance_below(rotation)
    body = spec.worldbody.add_body(name=name, pos=[float(pose[0]), float(pose[1]), height], quat=quat)
    body.add_freejoint(name=name)
    material = _material(mujoco, spec, name, object_texture(thing))
    _add_mesh(spec, f"{name}_look", thing.solid.mesh)
    body.add_geom(
        name=f"{name}_look",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=f"{name}_look",
        material=material,
        contype=0,
        conaffinity=0,
        group=VISUAL_GROUP,
        mass=0.0,
    )
    shared = {
        "contype": _ENVIRONMENT,
        "conaffinity": _ENVIRONMENT | _ROBOT,
        "condim": 6,
        "friction": [thing.friction, 0.002, thing.rolling_friction],
        "group": COLLISION_GROUP,
    }
    solid = thing.solid
    if isinstance(solid, Cuboid):
        shared |= {"condim": 4, "friction": [thing.friction, 0.005, 0.0001]}
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=list(solid.half_extents), mass=thing.mass, **shared
        )
        return
    density = thing.mass / volume(solid)
    for number, piece in enumerate(solid.pieces):
        label = f"{name}_{number}"
        part = _piece(mujoco, spec, label, solid, piece)
        body.add_geom(name=label, density=density, **part, **shared)


def _piece(mujoco: Any, spec: Any, label: str, solid: Revolution, piece: tuple[int, int]) -> dict[str, Any]:
    """Arguments of the geom of a convex piece of a solid of revolution."""
    rings = solid.rings[piece[0] : piece[1] + 1]
    middle, half = 0.5 * float(rings[0, 0] + rings[-1, 0]), 0.5 * float(rings[-1, 0] - rings[0, 0])
    if _is_ellipsoid(rings):
        radius = float(rings[:, 1].max())
        if abs(radius - half) < 1e-6:
            return {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [radius, 0.0, 0.0]}
        return {"type": mujoco.mjtGeom.mjGEOM_ELLIPSOID, "size": [radius, radius, half]}
    radii = rings[rings[:, 1] > 0.0, 1]
    if np.ptp(radii) < 1e-9:
        return {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [float(radii[0]), half, 0.0], "pos": [0.0, 0.0, middle]}
    points = solid.piece_vertices(piece)
    mesh = spec.add_mesh(name=label, uservert=points.ravel().tolist())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    return {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": label}


def _is_ellipsoid(rings: FloatArray) -> bool:
    z = rings[:, 0] / np.abs(rings[:, 0]).max()
    radius = rings[:, 1] / rings[:, 1].max()
    return len(rings) > 8 and bool(np.abs(z**2 + radius**2 - 1.0).max() < 1e-6)


def _add_mesh(spec: Any, name: str, mesh: Mesh) -> None:
    spec.add_mesh(
        name=name,
        uservert=mesh.vertices.ravel().tolist(),
        usertexcoord=mesh.texture_coordinates.ravel().tolist(),
        userface=mesh.faces.ravel().tolist(),
        inertia=robot_package("mujoco").mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )


def _plane(side: float, repetitions: float) -> Mesh:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    vertices = np.concatenate([side * (corners - 0.5), np.zeros((4, 1))], axis=1)
    return Mesh(vertices, repetitions * corners, np.array([[0, 1, 2], [0, 2, 3]]))


def _material(mujoco: Any, spec: Any, name: str, texture: Texture) -> str:
    added = spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=texture.shape[1],
        height=texture.shape[0],
        nchannel=3,
    )
    added.data = texture.tobytes()
    material = spec.add_material(name=name, specular=0.2, shininess=0.3)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return name


def _add_cameras(mujoco: Any, spec: Any, task: CellTask) -> None:
    camera = task.camera
    rotation = camera.pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])  # MuJoCo looks along -z, with y upwards
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, rotation.ravel())
    matrix = camera.intrinsics
    width, height = rendered_size(camera)
    # MuJoCo counts from the image's centre; OpenCV from the centre of the first pixel.
    offset = [matrix[0, 2] - 0.5 * (camera.width - 1), matrix[1, 2] - 0.5 * (camera.height - 1)]
    spec.worldbody.add_camera(
        name="camera",
        pos=camera.pose[:3, 3].tolist(),
        quat=quat,
        resolution=[width, height],
        sensor_size=[0.001 * width, 0.001 * height],
        focal_pixel=[matrix[0, 0], matrix[1, 1]],
        principal_pixel=[-offset[0], -offset[1]],
    )
    eye, centre = np.array([0.5, -0.85, 0.62]), np.array([-0.1, 0.0, 0.1])
    back = (eye - centre) / np.linalg.norm(eye - centre)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    mujoco.mju_mat2Quat(quat, np.stack([right, np.cross(back, right), back], axis=1).ravel())
    spec.worldbody.add_camera(name="side", pos=eye.tolist(), quat=quat, fovy=45.0)
