"""Shapes of the objects on the table: solids of revolution and cuboids, with their silhouettes from above.

Body frame: origin halfway up the axis of the object as it stands, z along that axis. Lengths in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import shapely

from visualrhp.scene.geometry import simplify_contour
from visualrhp.types import FloatArray

RING: int = 32
"""Vertices of a circle in meshes."""

SILHOUETTE_TOLERANCE: float = 3e-4
"""Largest deviation of a silhouette's outline from the exact one [m]."""

_FINE = 64  # points on a circle of a silhouette: 0.05 mm for a radius of 40 mm


@dataclass(frozen=True, slots=True)
class Mesh:
    """A textured triangle mesh.

    Attributes:
        vertices: [N, 3] in the body frame [m].
        texture_coordinates: [N, 2] of every vertex, from 0 to 1.
        faces: [F, 3] indices, counter-clockwise seen from outside.
    """

    vertices: FloatArray
    texture_coordinates: FloatArray
    faces: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Revolution:
    """A solid of revolution that consists of convex pieces.

    Attributes:
        profile: (z, radius) from the bottom to the top, z from 0 [m].
        pieces: index ranges [first, last] of the profile; each is convex, and together they are the solid.
        inside: further points of the profile of the mesh, from the rim inwards: the inside of a cup.
    """

    profile: tuple[tuple[float, float], ...]
    pieces: tuple[tuple[int, int], ...]
    inside: tuple[tuple[float, float], ...] = ()

    @property
    def height(self) -> float:
        """Along the axis [m]."""
        return self.profile[-1][0]

    @property
    def radius(self) -> float:
        """The largest one [m]."""
        return max(radius for _, radius in self.profile)

    @cached_property
    def rings(self) -> FloatArray:
        """[P, 2] (z, radius) of the profile in the body frame."""
        rings = np.array(self.profile, dtype=np.float64)
        rings[:, 0] -= 0.5 * self.height
        return rings

    def clearance_below(self, rotation: FloatArray) -> float:
        """Height of the body frame's origin above a surface on which the solid lies, rotated by ``rotation`` [m]."""
        z, radius = self.rings[:, 0], self.rings[:, 1]
        tilt = np.sqrt(max(0.0, 1.0 - float(rotation[2, 2]) ** 2))
        return float((radius * tilt - z * rotation[2, 2]).max())

    def silhouette(self, rotation: FloatArray) -> FloatArray:
        """[V, 2] outline seen from above, relative to the body frame's origin; counter-clockwise, in world axes.

        Args:
            rotation: [3, 3] of the body frame in the world frame.
        """
        angles = 2.0 * np.pi * np.arange(_FINE) / _FINE
        circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        # A polygon of the same area as the circle, so that neither is larger.
        circle *= np.sqrt(2.0 * np.pi / _FINE / np.sin(2.0 * np.pi / _FINE))
        z, radius = self.rings[:, 0], self.rings[:, 1]
        points = np.empty((len(z), _FINE, 3))
        points[..., :2] = radius[:, None, None] * circle
        points[..., 2] = z[:, None]
        seen = points @ rotation[:2].T
        hulls = [shapely.MultiPoint(seen[a : b + 1].reshape(-1, 2)).convex_hull for a, b in self.pieces]
        return _outline(hulls)

    @cached_property
    def mesh(self) -> Mesh:
        """The surface, for rendering; the texture runs around it (u) and along its profile (v)."""
        inside = np.array(self.inside, dtype=np.float64).reshape(-1, 2)
        inside[:, 0] -= 0.5 * self.height
        rings = np.concatenate([self.rings, inside])
        steps = np.linalg.norm(np.diff(rings, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        along /= along[-1]
        angles = 2.0 * np.pi * np.arange(RING + 1) / RING
        vertices = np.empty((len(rings), RING + 1, 3))
        vertices[..., 0] = rings[:, 1, None] * np.cos(angles)
        vertices[..., 1] = rings[:, 1, None] * np.sin(angles)
        vertices[..., 2] = rings[:, 0, None]
        coordinates = np.empty((len(rings), RING + 1, 2))
        coordinates[..., 0] = np.arange(RING + 1) / RING
        coordinates[..., 1] = along[:, None]
        return Mesh(vertices.reshape(-1, 3), coordinates.reshape(-1, 2), _strips(len(rings), RING + 1))

    def piece_vertices(self, piece: tuple[int, int]) -> FloatArray:
        """[N, 3] points in the body frame whose convex hull is a piece of the solid."""
        rings = self.rings[piece[0] : piece[1] + 1]
        rings = rings[rings[:, 1] > 0.0]
        angles = 2.0 * np.pi * np.arange(RING) / RING
        circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        flat = rings[:, 1, None, None] * circle
        return np.concatenate([flat, np.broadcast_to(rings[:, 0, None, None], (*flat.shape[:2], 1))], axis=2).reshape(
            -1, 3
        )


@dataclass(frozen=True)
class Cuboid:
    """A box.

    Attributes:
        half_extents: in x, y and z of the body frame [m].
    """

    half_extents: tuple[float, float, float]

    @property
    def height(self) -> float:
        """As it stands [m]."""
        return 2.0 * self.half_extents[2]

    @cached_property
    def corners(self) -> FloatArray:
        """[8, 3] in the body frame."""
        signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=np.float64)
        return signs * np.array(self.half_extents)

    def clearance_below(self, rotation: FloatArray) -> float:
        """Height of the body frame's origin above a surface on which the box lies, rotated by ``rotation`` [m]."""
        return float(-(self.corners @ rotation[2]).min())

    def silhouette(self, rotation: FloatArray) -> FloatArray:
        """[V, 2] outline seen from above, relative to the body frame's origin; counter-clockwise, in world axes."""
        return _outline([shapely.MultiPoint(self.corners @ rotation[:2].T).convex_hull])

    @cached_property
    def mesh(self) -> Mesh:
        """The surface, for rendering; the texture is repeated on each of the six sides."""
        vertices, coordinates, faces = [], [], []
        square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        for axis in range(3):
            for sign in (-1.0, 1.0):
                first, second = (axis + 1) % 3, (axis + 2) % 3
                side = np.empty((4, 3))
                side[:, axis], side[:, first], side[:, second] = sign, square[:, 0], square[:, 1] * sign
                start = 4 * len(vertices)
                vertices.append(side * np.array(self.half_extents))
                coordinates.append(0.5 + 0.5 * square)
                faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
        return Mesh(np.concatenate(vertices), np.concatenate(coordinates), np.array(faces))


Solid = Revolution | Cuboid


def _strips(rows: int, columns: int) -> npt.NDArray[np.int64]:
    """Triangles between neighbouring rings of vertices."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    upper = np.stack([corner, corner + columns + 1, corner + columns], axis=1)
    return np.concatenate([lower, upper])


def _outline(hulls: Sequence[shapely.Geometry]) -> FloatArray:
    union = hulls[0] if len(hulls) == 1 else shapely.union_all(hulls)
    return simplify_contour(union, SILHOUETTE_TOLERANCE)


# Shapes of kinds


def _arc(height: float, radius: float, count: int) -> list[tuple[float, float]]:
    """Profile of an ellipsoid of ``height`` and equatorial ``radius``."""
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, count)
    points = [(0.5 * height * (1.0 + float(np.sin(a))), radius * float(np.cos(a))) for a in angles]
    points[0], points[-1] = (0.0, 0.0), (height, 0.0)
    return points


def fruit(radius: float, flatness: float = 1.0) -> Revolution:
    """An apple or an orange: an ellipsoid, ``flatness`` times as high as it is wide."""
    profile = _arc(2.0 * radius * flatness, radius, 17)
    return Revolution(tuple(profile), ((0, len(profile) - 1),))


def cup(height: float, top_radius: float) -> Revolution:
    """A cup without a handle, whose bottom has 0.8 of the radius of its rim."""
    wall, bottom = 0.0035, 0.8 * top_radius
    profile = ((0.0, 0.0), (0.0, bottom), (height, top_radius))
    inside = ((height, top_radius - wall), (2.0 * wall, bottom - wall), (2.0 * wall, 0.0))
    return Revolution(profile, ((0, 2),), inside)


def bottle(radius: float, length: float) -> Revolution:
    """A bottle of ``length`` with a round shoulder, a neck and a cap."""
    neck, shoulder, top = 0.42 * radius, 0.62 * length, 0.80 * length
    angles = np.linspace(0.0, 0.5 * np.pi, 6)[1:]
    curve = [
        (
            shoulder + (top - shoulder) * float(np.sin(a)),
            neck + (radius - neck) * float(np.cos(a)),
        )
        for a in angles
    ]
    profile = [(0.0, 0.0), (0.0, 0.94 * radius), (0.002, radius), (shoulder, radius), *curve]
    first = len(profile) - 1
    profile += [(length, neck), (length, 0.0)]
    return Revolution(tuple(profile), ((0, first), (first, len(profile) - 1)))


def box(half_x: float, half_y: float, height: float) -> Cuboid:
    """A box that stands on its base of 2 ``half_x`` by 2 ``half_y``."""
    return Cuboid((half_x, half_y, 0.5 * height))
