"""What a problem is: the surface, the target region and the objects (paper, Sec. 4)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
import shapely

from visualrhp.errors import SceneError
from visualrhp.scene import geometry
from visualrhp.scene.gripper import Gripper
from visualrhp.types import FloatArray, IntArray, State

MIN_OBJECT_AREA = 1e-5
"""Smallest area of an object [m^2]; below it (3 mm x 3 mm) the outline is taken for degenerate."""

_CENTRE_TOLERANCE = 1e-9
_CONVEXITY_TOLERANCE = -1e-12


def read_only(values: npt.ArrayLike) -> FloatArray:
    """A float64 copy that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def _polygon(values: npt.ArrayLike, what: str) -> FloatArray:
    """A checked simple polygon [V, 2], counter-clockwise."""
    polygon = read_only(values)
    if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
        raise SceneError(f"{what} needs at least three vertices (x, y), not an array of shape {list(polygon.shape)}")
    if not np.isfinite(polygon).all():
        raise SceneError(f"{what} has a vertex that is not finite: {polygon.tolist()}")
    if not shapely.Polygon(polygon).is_valid:
        raise SceneError(f"{what} crosses or touches itself: {polygon.tolist()}; give a simple polygon")
    if geometry.signed_area(polygon) < MIN_OBJECT_AREA:
        raise SceneError(
            f"{what} has the signed area {geometry.signed_area(polygon):.3g} m^2; at least {MIN_OBJECT_AREA:g} m^2 is "
            "needed, with the vertices counter-clockwise"
        )
    return polygon


@dataclass(frozen=True, eq=False)
class ObjectShape:
    """A rigid object: a convex outline of uniform density.

    Attributes:
        outline: [V, 2] vertices [m] in the body frame, whose origin is the centre of mass; counter-clockwise.
        density: mass per area [kg/m^2].
        friction: Coulomb coefficient against the surface, and of its contacts.

    Raises:
        SceneError: the outline is degenerate, not convex or not centred, or density or friction is not positive.
    """

    outline: FloatArray
    density: float = 1.0
    friction: float = 0.3

    def __post_init__(self) -> None:
        outline = _polygon(self.outline, "an object's outline")
        edge = np.roll(outline, -1, axis=0) - outline
        following = np.roll(edge, -1, axis=0)
        if (edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0] < _CONVEXITY_TOLERANCE).any():
            raise SceneError(f"an object's outline is not convex: {outline.tolist()}")
        if np.abs(geometry.centroid(outline)).max() > _CENTRE_TOLERANCE:
            raise SceneError(
                f"an object's outline has its centre of mass at {geometry.centroid(outline).tolist()}, not at the "
                "origin of its frame; ObjectShape.centred moves it there"
            )
        for name in ("density", "friction"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise SceneError(f"an object's {name} must be positive, not {getattr(self, name)}")
        object.__setattr__(self, "outline", outline)

    @classmethod
    def centred(cls, outline: npt.ArrayLike, density: float = 1.0, friction: float = 0.3) -> ObjectShape:
        """A shape from vertices in any frame, moved so that the centre of mass is the origin."""
        outline = np.asarray(outline, dtype=np.float64)
        for _ in range(3):  # rounding leaves an offset that a second shift removes
            outline = outline - geometry.centroid(outline)
        return cls(outline, density, friction)

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
        """Mean distance of the area from the centre of mass [m]: friction torque over friction force under uniform
        pressure."""
        return geometry.first_moment_of_distance(self.outline) / self.area

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, ObjectShape)
            and np.array_equal(self.outline, other.outline)
            and (self.density, self.friction) == (other.density, other.friction)
        )


@dataclass(frozen=True, eq=False)
class TargetRegion:
    """The disc into which the desired object is to be brought.

    Attributes:
        position: [2] centre [m] in the world frame.
        radius: [m].
    """

    position: FloatArray
    radius: float = 0.07

    def __post_init__(self) -> None:
        position = read_only(self.position)
        if position.shape != (2,) or not np.isfinite(position).all():
            raise SceneError(f"the target region's position must be two finite numbers, not {position.tolist()}")
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise SceneError(f"the target region's radius must be positive, not {self.radius}")
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
class Scene:
    """What stays fixed during a task: ``edges``, ``tarReg`` and ``ver`` of Sec. 4.

    Attributes:
        target: the target region; its centre lies within the edges.
        objects: the desired object first, then the obstacles.
        edges: [E, 2] vertices of the surface [m] in the world frame, counter-clockwise.
        gripper: outline of the end-effector.

    Raises:
        SceneError: no objects, a degenerate surface, or a target centre outside it.
    """

    target: TargetRegion
    objects: tuple[ObjectShape, ...]
    edges: FloatArray = field(default_factory=lambda: square_edges(0.5))
    gripper: Gripper = field(default_factory=Gripper)

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges", _polygon(self.edges, "the surface"))
        object.__setattr__(self, "objects", tuple(self.objects))
        if not self.objects:
            raise SceneError("a scene has no objects; the desired object comes first")
        if not geometry.contains(self.edges, *self.target.position):
            raise SceneError(f"the target region's centre {self.target.position.tolist()} is not within the edges")

    @property
    def num_objects(self) -> int:
        """Number of objects m, the desired one included."""
        return len(self.objects)

    @cached_property
    def stacked_outlines(self) -> tuple[FloatArray, IntArray]:
        """Vertices of all objects [sum of V, 2] in their body frames, and the object each belongs to [sum of V]."""
        counts = [len(shape.outline) for shape in self.objects]
        return np.concatenate([shape.outline for shape in self.objects]), np.repeat(np.arange(len(counts)), counts)

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
    """A scene and the state from which the task starts."""

    scene: Scene
    state: State

    def __post_init__(self) -> None:
        if self.state.num_objects != self.scene.num_objects:
            raise SceneError(f"the state has {self.state.num_objects} objects and the scene {self.scene.num_objects}")
