"""Coarse copies of the robot's meshes, which a renderer in software draws in a quarter of the time.

The models' meshes have 185,000 triangles, far more than there are pixels. Here, vertices within a grid of
:data:`GRID` are merged, which the camera hardly shows. What collides keeps its shape: of the gripper's
meshes MuJoCo uses the convex hull, whose vertices alone are kept.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.robot_model import Mounting, robot_spec
from visualrhp.types import FloatArray

GRID: Final = 0.003
"""Vertices are merged within cubes of this side [m]: two pixels of the camera."""


@dataclass(frozen=True)
class CoarseMesh:
    """A mesh for rendering, and one for collisions.

    Attributes:
        vertices: [N, 3] [m], in the frame of the mesh's file, scaled as in the model.
        faces: [F, 3].
        hull: [M, 3] vertices of the convex hull of the original mesh [m].
    """

    vertices: FloatArray
    faces: npt.NDArray[np.int64]
    hull: FloatArray


@dataclass(frozen=True)
class Inertia:
    """Mass [kg], centre of mass [3] [m], orientation [4] of the principal axes and moments [3] [kg m^2] of a body."""

    mass: float
    centre: FloatArray
    orientation: FloatArray
    moments: FloatArray


def use_coarse_meshes(spec: Any) -> None:
    """Replace the meshes of a robot (``MjSpec``) by coarse ones, before it is compiled; inertias stay the same."""
    mujoco = robot_package("mujoco")
    meshes, inertias = coarse_meshes()
    seen, solid = set(), set()
    for body in spec.bodies[1:]:
        inertia = inertias[body.name]
        body.mass, body.ipos, body.iquat = inertia.mass, inertia.centre, inertia.orientation
        body.inertia, body.explicitinertial = inertia.moments, True
        for geom in body.geoms:
            name = geom.meshname
            if name not in meshes:
                continue
            is_solid = bool(geom.contype)
            geom.meshname = f"{name}_{'hull' if is_solid else 'coarse'}"
            (solid if is_solid else seen).add(name)
    for name in seen:
        mesh = meshes[name]
        added = spec.add_mesh(
            name=f"{name}_coarse", uservert=mesh.vertices.ravel().tolist(), userface=mesh.faces.ravel().tolist()
        )
        added.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    for name in solid:
        added = spec.add_mesh(name=f"{name}_hull", uservert=meshes[name].hull.ravel().tolist())
        added.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    for mesh in list(spec.meshes):
        if mesh.name in meshes:
            spec.delete(mesh)


@functools.cache
def coarse_meshes() -> tuple[dict[str, CoarseMesh], dict[str, Inertia]]:
    """Meshes of the robot and inertias of its bodies, by their names. The first call takes a second."""
    mujoco = robot_package("mujoco")
    model = robot_spec(Mounting()).compile()
    meshes = {}
    for number in range(model.nmesh):
        first, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
        start, length = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.mesh_quat[number])
        # The compiler moves meshes to their centre and principal axes.
        vertices = model.mesh_vert[first : first + count].astype(np.float64)
        vertices = vertices @ rotation.reshape(3, 3).T + model.mesh_pos[number]
        faces = model.mesh_face[start : start + length].astype(np.int64)
        hull = vertices[ConvexHull(vertices).vertices]
        meshes[model.mesh(number).name] = CoarseMesh(*merged(vertices, faces, GRID), hull)
    inertias = {
        model.body(body).name: Inertia(
            float(model.body_mass[body]),
            model.body_ipos[body].copy(),
            model.body_iquat[body].copy(),
            model.body_inertia[body].copy(),
        )
        for body in range(model.nbody)
    }
    return meshes, inertias


def merged(vertices: FloatArray, faces: npt.NDArray[np.int64], grid: float) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """A mesh in which the vertices in each cube of a grid are their mean.

    Args:
        vertices: [N, 3] [m].
        faces: [F, 3].
        grid: side of the cubes [m].

    Returns:
        Vertices [M, 3] and faces [G, 3], without those that vanish.
    """
    cells, owner = np.unique(np.floor(vertices / grid).astype(np.int64), axis=0, return_inverse=True)
    owner = owner.ravel()
    sums = np.zeros((len(cells), 3))
    np.add.at(sums, owner, vertices)
    means = sums / np.bincount(owner)[:, None]
    mapped = owner[faces]
    is_face = (mapped[:, 0] != mapped[:, 1]) & (mapped[:, 1] != mapped[:, 2]) & (mapped[:, 2] != mapped[:, 0])
    mapped = mapped[is_face]
    _, first = np.unique(np.sort(mapped, axis=1), axis=0, return_index=True)
    mapped = mapped[np.sort(first)]
    used, renumbered = np.unique(mapped, return_inverse=True)
    return means[used], renumbered.reshape(-1, 3)
