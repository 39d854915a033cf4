"""Scenes and task instances: the surface, the target region and the objects (paper, Sec. 4)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from visualrhp.errors import SceneError
from visualrhp.scene import geometry
from visualrhp.scene.contours import collision_outline, is_number
from visualrhp.scene.decomposition import convex_parts
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.polygons import (
    MAX_COORDINATE,
    MIN_OBJECT_AREA,
    MIN_OBJECT_THICKNESS,
    checked_polygon,
    read_only,
)
from visualrhp.types import FloatArray, IntArray, State

__all__ = [
    "CENTRE_TOLERANCE",
    "MAX_DENSITY",
    "MAX_FRICTION",
    "MIN_OBJECT_AREA",
    "MIN_OBJECT_THICKNESS",
    "ObjectShape",
    "Scene",
    "TargetRegion",
    "TaskInstance",
    "centred",
    "read_only",
    "square_edges",
]

CENTRE_TOLERANCE = 1e-9
"""How far the centre of mass of an outline may be from the origin of its frame [m], in x and in y."""

MAX_DENSITY = 1e4
"""Largest density [kg/m^2] in scene files and random scenes."""

MAX_FRICTION = 10.0
"""Largest friction coefficient in scene files and random scenes."""

_ANGLES = 2.0 * np.pi * np.arange(32) / 32
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


def centred(outline: FloatArray) -> tuple[FloatArray, FloatArray]:
    """An outline [V, 2] moved so that its centre of area is the origin, and where [2] that centre was."""
    moved, position = outline, np.zeros(2)
    for _ in range(3):  # rounding leaves an offset, which a second shift removes
        shift = geometry.centroid(moved)
        moved = moved - shift
        position = position + shift
    return moved, position


class _ReadOnlyArrays:
    """Keeps the arrays of an unpickled or deep-copied object read-only, which NumPy restores writable."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        for value in state.values():
            for array in value if isinstance(value, tuple) else (value,):
                if isinstance(array, np.ndarray):
                    array.setflags(write=False)
        self.__dict__.update(state)


@dataclass(frozen=True, eq=False)
class ObjectShape(_ReadOnlyArrays):
    """A rigid object: a simple polygon, convex or not, of uniform density.

    Attributes:
        outline: [V, 2] vertices [m] in the body frame, whose origin is the centre of mass; counter-clockwise.
        density: mass per area [kg/m^2].
        friction: Coulomb coefficient against the surface, and of its contacts.
        turning_resistance: torque with which the surface resists turning, relative to that of uniform pressure.

    Raises:
        SceneError: the outline is degenerate (see :func:`visualrhp.scene.polygons.polygon_fault`) or not centred, or
            density, friction or turning_resistance is not positive.
    """

    outline: FloatArray
    density: float = 1.0
    friction: float = 0.3
    turning_resistance: float = 1.0

    def __post_init__(self) -> None:
        outline = checked_polygon(self.outline, "an object's outline", solid=True)
        centre = geometry.centroid(outline)
        if np.abs(centre).max() > CENTRE_TOLERANCE:
            raise SceneError(
                f"an object's outline has its centre of mass at {centre.tolist()}, not at the origin of its frame; "
                "ObjectShape.centred moves it there"
            )
        for name in ("density", "friction", "turning_resistance"):
            if not (is_number(getattr(self, name)) and getattr(self, name) > 0.0):
                raise SceneError(f"an object's {name} must be positive, not {getattr(self, name)!r:.100}")
        object.__setattr__(self, "outline", outline)

    @classmethod
    def centred(cls, outline: npt.ArrayLike, density: float = 1.0, friction: float = 0.3) -> ObjectShape:
        """Make a shape from vertices in any frame, moved so that the centre of mass is the origin.

        Raises:
            SceneError: as the constructor.
        """
        return cls.located(outline, density, friction)[0]

    @classmethod
    def located(
        cls, outline: npt.ArrayLike, density: float = 1.0, friction: float = 0.3
    ) -> tuple[ObjectShape, FloatArray]:
        """Make a shape from vertices in any frame; also return the position [2] of its centre of mass in that frame.

        Raises:
            SceneError: as the constructor.
        """
        given = read_only(outline)
        if not (given.size and np.abs(given).max() <= MAX_COORDINATE and given.ndim == 2 and len(given) > 2):
            checked_polygon(given, "an object's outline", solid=True)
        if not geometry.signed_area(given) > 0.0:  # without an area, there is no centre
            checked_polygon(given, "an object's outline", solid=True)
        moved, position = centred(given)
        try:
            return cls(moved, density, friction), position
        except SceneError:
            checked_polygon(given, "an object's outline", solid=True)  # reports the vertices as given
            raise

    @classmethod
    def from_contour(
        cls, points: Any, tolerance: float = 1e-3, density: float = 1.0, friction: float = 0.3
    ) -> ObjectShape:
        """Make a shape from a camera contour: hundreds of points, in any frame and with either orientation.

        The outline deviates from the contour by at most ``tolerance`` [m] and is centred. For the position of its
        centre in the frame of the points, use :func:`visualrhp.scene.geometry.simplify_contour` and :meth:`located`.

        Args:
            points: an array or a list [N, 2], OpenCV's contour [N, 1, 2], or a shapely polygon or ring; in metres.
            tolerance: [m].
            density: as the constructor.
            friction: as the constructor.

        Raises:
            SceneError: the points are no contour or a degenerate one, or as the constructor.

        Warns:
            UserWarning: the contour is longer than a metre, and so probably in millimetres or pixels.
        """
        return cls.centred(geometry.simplify_contour(points, tolerance), density, friction)

    @cached_property
    def convex_parts(self) -> tuple[FloatArray, ...]:
        """Convex polygons [V, 2] in the body frame, counter-clockwise, whose union is the outline; they may overlap.

        The outline itself, unchanged, if it is convex. With very many vertices, see :attr:`contact_tolerance`.
        """
        parts = convex_parts(self.outline)
        for part in parts:
            part.setflags(write=False)
        return parts

    @cached_property
    def contact_tolerance(self) -> float:
        """How far the outline that collides deviates at most from :attr:`outline` [m].

        0 for convex outlines, and for others of up to :data:`visualrhp.scene.contours.MAX_EXACT_VERTICES`.
        """
        reduced = None if geometry.is_convex(self.outline) else collision_outline(self.outline)
        return 0.0 if reduced is None else reduced[1]

    @cached_property
    def area(self) -> float:
        """Area [m^2]."""
        return geometry.signed_area(self.outline)

    @cached_property
    def mass(self) -> float:
        """Mass [kg]."""
        return self.density * self.area

    @cached_property
    def moment_of_inertia(self) -> float:
        """Moment of inertia about the centre of mass [kg m^2]."""
        return self.density * geometry.second_moment_of_area(self.outline)

    @cached_property
    def friction_lever(self) -> float:
        """Friction torque over friction force [m]: under uniform pressure, the mean distance of the area from the
        centre of mass."""
        return self.turning_resistance * geometry.first_moment_of_distance(self.outline) / self.area

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, ObjectShape)
            and np.array_equal(self.outline, other.outline)
            and self.density == other.density
            and self.friction == other.friction
            and self.turning_resistance == other.turning_resistance
        )


@dataclass(frozen=True, eq=False)
class TargetRegion(_ReadOnlyArrays):
    """The disc into which the desired object is to be moved.

    Attributes:
        position: [2] centre [m] in the world frame.
        radius: [m].
    """

    position: FloatArray
    radius: float = 0.07

    def __post_init__(self) -> None:
        position = read_only(self.position)
        if position.shape != (2,) or not np.isfinite(position).all():
            raise SceneError(f"the target region's position must be two finite numbers, not {position.tolist()!s:.200}")
        if not (is_number(self.radius) and self.radius > 0.0):
            raise SceneError(f"the target region's radius must be positive, not {self.radius!r:.100}")
        object.__setattr__(self, "position", position)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, TargetRegion)
            and np.array_equal(self.position, other.position)
            and self.radius == other.radius
        )


def square_edges(side: float) -> FloatArray:
    """[4, 2] vertices of a square surface centred at the origin of the world frame, ``side`` in metres."""
    half = side / 2.0
    return read_only([[-half, -half], [half, -half], [half, half], [-half, half]])


@dataclass(frozen=True, eq=False)
class Scene(_ReadOnlyArrays):
    """The fixed part of a task: ``edges``, ``tarReg`` and ``ver`` of Sec. 4.

    Attributes:
        target: the target region; its centre lies within the edges.
        objects: the desired object first, then the obstacles.
        edges: [E, 2] vertices of the surface [m] in the world frame, counter-clockwise.
        gripper: geometry of the end effector.

    Raises:
        SceneError: no objects, a degenerate surface, or a target centre outside it.
    """

    target: TargetRegion
    objects: tuple[ObjectShape, ...]
    edges: FloatArray = field(default_factory=lambda: square_edges(0.5))
    gripper: Gripper = field(default_factory=Gripper)

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges", checked_polygon(self.edges, "the surface", solid=False))
        if not isinstance(self.target, TargetRegion) or not isinstance(self.gripper, Gripper):
            raise SceneError("a scene has a target (TargetRegion), objects and edges, and may have a gripper (Gripper)")
        objects = self.objects if isinstance(self.objects, list | tuple) else ()
        if not all(isinstance(shape, ObjectShape) for shape in objects):
            raise SceneError("the objects of a scene are a tuple of ObjectShape; the desired object comes first")
        object.__setattr__(self, "objects", tuple(objects))
        if not self.objects:
            raise SceneError("a scene has no objects; the desired object comes first")
        if not geometry.contains(self.edges, *self.target.position):
            raise SceneError(f"the target region's centre {self.target.position.tolist()} is not within the edges")

    @property
    def num_objects(self) -> int:
        """Number of objects m, including the desired one."""
        return len(self.objects)

    @cached_property
    def stacked_outlines(self) -> tuple[npt.NDArray[np.complex128], IntArray, list[slice]]:
        """All outlines in one array: surface, target region, palm, left finger, right finger, then the objects.

        Returns:
            Vertices x + i y [m] in the frames of their bodies (surface and target: the world), [sum of V]; the index
            of the outline of each vertex, [sum of V]; and the slice of each outline, [5 + m].
        """
        gripper, target = self.gripper, self.target
        outlines = [self.edges, target.position + target.radius * _CIRCLE]
        outlines += [gripper.palm, gripper.finger(1), gripper.finger(-1)]
        outlines += [shape.outline for shape in self.objects]
        counts = [len(outline) for outline in outlines]
        ends = np.cumsum(counts).tolist()
        places = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
        vertices = np.concatenate(outlines).view(np.complex128)[:, 0]
        return vertices, np.repeat(np.arange(len(counts)), counts), places

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Scene)
            and self.target == other.target
            and self.objects == other.objects
            and np.array_equal(self.edges, other.edges)
            and self.gripper == other.gripper
        )


@dataclass(frozen=True)
class TaskInstance:
    """A scene and the state from which the task starts.

    Only cheap checks are made here. A start from an external source (a file, a camera, a caller) should also be checked
    with :func:`visualrhp.scene.start.check_start`, which finds overlapping bodies.

    Raises:
        SceneError: the numbers of poses and objects differ, a number is not finite, or the opening is out of range.
    """

    scene: Scene
    state: State

    def __post_init__(self) -> None:
        if self.state.num_objects != self.scene.num_objects:
            raise SceneError(f"the state has {self.state.num_objects} objects and the scene {self.scene.num_objects}")
        if not np.isfinite(self.state.vector).all():
            raise SceneError(f"the state has a number that is not finite: {self.state.vector.tolist()!s:.300}")
        fault = self.scene.gripper.opening_fault(self.state.gripper_opening)
        if fault is not None:
            raise SceneError(f"the gripper's opening {fault}")
