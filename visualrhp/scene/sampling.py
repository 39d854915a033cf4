"""Random task instances, each a function of (distribution, seed, split, index) only (paper, Sec. 6.1 and 7)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import shapely

from visualrhp.errors import ConfigError
from visualrhp.parameters import AsRange, AsTuple, Field, parameters
from visualrhp.scene import geometry
from visualrhp.scene.gripper import GRIPPERS, GripperName
from visualrhp.scene.placement import CORNER_DISTANCE as CORNER_DISTANCE
from visualrhp.scene.placement import place_objects, sample_position
from visualrhp.scene.polygons import MAX_COORDINATE
from visualrhp.scene.scene import (
    MAX_DENSITY,
    MAX_FRICTION,
    ObjectShape,
    Scene,
    TargetRegion,
    TaskInstance,
    centred,
    square_edges,
)
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import FloatArray, ObjectSize, State

MAX_OBJECTS = 20
"""Largest number of objects that can be requested; the paper uses up to 7."""

NumObjects = Annotated[int, Field(ge=1, le=MAX_OBJECTS)]
NumVertices = Annotated[int, Field(ge=3, le=1000)]
Place = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]

Layout = Literal["uniform", "target_at_edge", "object_in_corner", "object_behind"]
"""Where the target region and the desired object are; all but ``uniform`` are hard and not in the paper:

- ``target_at_edge``: the target's centre is at most :data:`EDGE_DISTANCE` from an edge;
- ``object_in_corner``: the desired object's centre is at most :data:`CORNER_DISTANCE` from a corner;
- ``object_behind``: an obstacle is between the gripper and the desired object.
"""

EDGE_DISTANCE = 0.03


ATTEMPTS_PER_SCENE = 500
_ATTEMPTS_PER_TARGET = 100_000
_FEW_OBJECTS = 10
_LARGEST_WITH_CORNERS = 8.0  # beyond, one place in 2,500 is in a corner
_GRIPPER_AREA = 0.01  # [m^2], fingers and the room between them included
_GRIPPER_PERIMETER = 0.45  # [m]


@dataclass(frozen=True, slots=True)
class ShapeClass:
    """Convex polygons inscribed in ellipses.

    Attributes:
        half_length: range of the longer semi-axis [m].
        aspect: range of the shorter semi-axis over the longer.
    """

    half_length: tuple[float, float]
    aspect: tuple[float, float]


GRASPABLE = ShapeClass(half_length=(0.018, 0.032), aspect=(0.75, 1.0))
"""Fits between the fingers (85 mm) from any direction."""

DIRECTIONAL = ShapeClass(half_length=(0.045, 0.060), aspect=(0.40, 0.60))
"""Longer than the stroke and narrower than it: graspable from some directions."""

BULKY = ShapeClass(half_length=(0.050, 0.060), aspect=(0.88, 1.0))
"""Too large for the gripper in (nearly) every direction."""

SIZE_CLASSES: dict[ObjectSize, tuple[ShapeClass, ...]] = {
    "small": (GRASPABLE,),
    "mixed": (GRASPABLE, DIRECTIONAL, BULKY),
    "large": (DIRECTIONAL, BULKY),
}
"""Shape classes, sampled with equal probability, for each average object size of Sec. 8.1."""


@parameters
class SceneDistribution:
    """Parameters of the random task instances. Defaults: Sec. 7 and footnote 3. SI units.

    Attributes:
        num_objects: smallest and largest number of objects m, sampled uniformly, including the desired object. A
            single number stands for both.
        object_size: size class of all objects.
        surface_side: side of the square surface.
        target_radius: radius of the target region, whose centre is uniform over the surface.
        density: mass per area of the objects [kg/m^2].
        friction: Coulomb coefficient of the objects.
        num_vertices: smallest and largest number of vertices of an object.
        clearance: least distance between bodies, and of objects to the edges, at the start.
        start_distance: range of the distance of the gripper frame's origin from its edge at the start.
        start_angle: largest deviation of the gripper's heading from the inward normal of its edge [rad].
        layout: see :data:`Layout`.
        gripper: see :data:`~visualrhp.scene.gripper.GRIPPERS`.

    Raises:
        ConfigError: a parameter is out of range, or no instances can be found: the clearance leaves no room, the target
            region covers the surface, or the largest number of objects would lie too densely.
    """

    num_objects: Annotated[tuple[NumObjects, NumObjects], AsRange, AsTuple] = (1, 7)
    object_size: ObjectSize = "mixed"
    surface_side: Annotated[float, Field(gt=0, le=2.0 * MAX_COORDINATE)] = 0.5
    target_radius: Annotated[float, Field(gt=0, le=MAX_COORDINATE)] = 0.07
    density: Annotated[float, Field(gt=0, le=MAX_DENSITY)] = 1.0
    friction: Annotated[float, Field(gt=0, le=MAX_FRICTION)] = 0.3
    num_vertices: Annotated[tuple[NumVertices, NumVertices], AsTuple] = (4, 8)
    clearance: Annotated[float, Field(ge=0, le=MAX_COORDINATE)] = 0.005
    start_distance: Annotated[tuple[Place, Place], AsTuple] = (0.01, 0.05)
    start_angle: Annotated[float, Field(ge=0, le=3.1416)] = np.pi / 6
    layout: Layout = "uniform"
    gripper: GripperName = "paper"

    def __post_init__(self) -> None:
        for name in ("num_objects", "num_vertices", "start_distance"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}=[{low}, {high}]: the smaller bound comes first.")
        if self.layout == "object_behind" and self.num_objects[0] < 2:
            raise ValueError(f"layout=object_behind needs an obstacle: num_objects={list(self.num_objects)}.")
        fault = feasibility_fault(self)
        if fault is not None:
            raise ValueError(fault)


def feasibility_fault(distribution: SceneDistribution) -> str | None:
    """Why no instance of a distribution can be found, or only after many attempts; None if there are some."""
    side, clearance, classes = distribution.surface_side, distribution.clearance, SIZE_CLASSES[distribution.object_size]
    smallest = 0.4 * min(kind.half_length[0] * kind.aspect[0] for kind in classes)  # a circle within any object
    room = 0.5 * side - smallest
    if clearance > room:
        return (
            f"clearance={clearance:g} leaves no room on surface_side={side:g} m: no object has {clearance:g} m on "
            f"every side. It should be at most about {max(room - smallest, 0.0):.2g} m, on a larger surface more."
        )
    if distribution.layout == "object_in_corner" and clearance + smallest > CORNER_DISTANCE / math.sqrt(2.0):
        return (
            f"clearance={clearance:g} is too large for layout=object_in_corner, which wants the desired object's "
            f"centre within {CORNER_DISTANCE:g} m of a corner. It should be at most about "
            f"{CORNER_DISTANCE / math.sqrt(2.0) - 2.0 * smallest:.2g} m."
        )
    if distribution.layout == "object_in_corner" and side > _LARGEST_WITH_CORNERS:
        return (
            f"surface_side={side:g} is too large for layout=object_in_corner: places are drawn from the whole surface. "
            f"It should be at most {_LARGEST_WITH_CORNERS:g} m."
        )
    farthest = math.sqrt(2.0) * (side - clearance - smallest)
    if distribution.target_radius >= farthest:
        return (
            f"target_radius={distribution.target_radius:g} covers all places of the desired object, which starts "
            f"outside the target region: on surface_side={side:g} m, it should be far below {farthest:.2g} m."
        )
    if not _fits(distribution, distribution.num_objects[1]):
        most = max((m for m in range(1, MAX_OBJECTS + 1) if _fits(distribution, m)), default=0)
        advice = f"It should be at most {most}, or on a larger surface more." if most else "Increase surface_side."
        return (
            f"num_objects={list(distribution.num_objects)} is too many for object_size={distribution.object_size} and "
            f"clearance={clearance:g} on surface_side={side:g} m: objects at random places do not lie that densely. "
            f"{advice}"
        )
    return None


def coverage(distribution: SceneDistribution, num_objects: int, clearance: float) -> float:
    """The share of the surface that objects and gripper are expected to take, each with half the clearance around."""
    num_vertices = 0.5 * sum(distribution.num_vertices)
    inscribed = 0.5 * num_vertices / math.pi * math.sin(2.0 * math.pi / num_vertices)  # area of a polygon in a circle
    classes = SIZE_CLASSES[distribution.object_size]
    total = 0.0
    for kind in classes:
        half_length = 0.5 * sum(kind.half_length)
        half_width = 0.5 * sum(kind.aspect) * half_length
        perimeter = 1.9 * math.pi * math.sqrt(0.5 * (half_length**2 + half_width**2))  # of a polygon in an ellipse
        total += math.pi * half_length * half_width * inscribed + 0.5 * perimeter * clearance
    around = 0.25 * math.pi * clearance**2
    bodies = num_objects * (total / len(classes) + around) + _GRIPPER_AREA + 0.5 * _GRIPPER_PERIMETER * clearance
    return bodies / (distribution.surface_side - clearance) ** 2


def _fits(distribution: SceneDistribution, num_objects: int) -> bool:
    """Whether random places for so many objects are found, and for more than a few within some 50 ms."""
    if num_objects <= _FEW_OBJECTS:  # which have much room along the edges
        return coverage(distribution, num_objects, 0.0) <= 0.8
    return coverage(distribution, num_objects, distribution.clearance) <= 0.501


def sample_task_instance(distribution: SceneDistribution, seed: int, split: Split, index: int) -> TaskInstance:
    """Sample task instance ``index``: the same for equal arguments, independent of any other index.

    Objects lie entirely on the surface, at a distance from each other and from the gripper, which starts near an edge,
    open and heading inwards. The desired object's centre is outside the target region.

    Raises:
        ConfigError: no instance was found in :data:`ATTEMPTS_PER_SCENE` attempts, or the seed or the index is negative.
    """
    for name, value in (("seed", seed), ("index", index)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
            raise ConfigError(f"{name}={value!r:.60} is out of range: it should be an integer, at least 0.")
    rng = generator_for(seed, split, index, Stream.INSTANCE)
    num_objects = _sample_num_objects(distribution, rng)
    edges = square_edges(distribution.surface_side)
    gripper = GRIPPERS[distribution.gripper]
    for _ in range(ATTEMPTS_PER_SCENE):
        target = TargetRegion(_sample_target(distribution, edges, rng), distribution.target_radius)
        outlines = [_sample_outline(distribution, rng) for _ in range(num_objects)]
        gripper_pose = _sample_gripper_pose(distribution, edges, rng)
        poses = place_objects(
            distribution, outlines, edges, target, gripper.outlines(gripper_pose, gripper.stroke), rng
        )
        if poses is not None and (distribution.layout != "object_behind" or _is_behind(outlines, poses, gripper_pose)):
            objects = tuple(ObjectShape(each, distribution.density, distribution.friction) for each in outlines)
            state = State.create(gripper_pose, gripper.stroke, False, poses)
            return TaskInstance(Scene(target, objects, edges, gripper), state)
    raise ConfigError(
        f"No task instance was found in {ATTEMPTS_PER_SCENE} attempts: there should be {num_objects} objects "
        f"(scene.object_size={distribution.object_size}) at scene.clearance={distribution.clearance:g} m from each "
        f"other, and the first outside the target region (scene.target_radius={distribution.target_radius:g} m), with "
        f"scene.layout={distribution.layout}, on scene.surface_side={distribution.surface_side:g} m. "
        + ("Increase scene.surface_side" if distribution.layout == "uniform" else "Choose scene.layout=uniform")
        + ", or decrease scene.num_objects, scene.clearance or scene.target_radius."
    )


def sampled_num_objects(distribution: SceneDistribution, seed: int, split: Split, index: int) -> int:
    """Number of objects of task instance ``index``, without sampling the instance."""
    return _sample_num_objects(distribution, generator_for(seed, split, index, Stream.INSTANCE))


def _sample_num_objects(distribution: SceneDistribution, rng: np.random.Generator) -> int:
    return int(rng.integers(distribution.num_objects[0], distribution.num_objects[1] + 1))


def _sample_target(distribution: SceneDistribution, edges: FloatArray, rng: np.random.Generator) -> FloatArray:
    """[2] centre of the target region."""
    border = shapely.LinearRing(edges)
    low, high = float(edges.min()), float(edges.max())
    for _ in range(_ATTEMPTS_PER_TARGET):
        position = sample_position(low, high, rng)
        if distribution.layout != "target_at_edge" or border.distance(shapely.Point(position)) <= EDGE_DISTANCE:
            return np.array(position)
    raise ConfigError(
        f"No target region was found in {_ATTEMPTS_PER_TARGET} attempts: scene.layout={distribution.layout} wants it "
        f"within {EDGE_DISTANCE:g} m of an edge, which is hardly ever on scene.surface_side="
        f"{distribution.surface_side:g} m. Decrease scene.surface_side."
    )


def _is_behind(outlines: list[FloatArray], poses: FloatArray, gripper_pose: FloatArray) -> bool:
    """Whether an obstacle intersects the segment from the gripper to the desired object."""
    segment = shapely.LineString([gripper_pose[:2], poses[0, :2]])
    obstacles = [geometry.to_world(outline, pose) for outline, pose in zip(outlines[1:], poses[1:], strict=True)]
    return any(segment.intersects(shapely.Polygon(obstacle)) for obstacle in obstacles)


def _sample_outline(distribution: SceneDistribution, rng: np.random.Generator) -> FloatArray:
    """A convex polygon, centred, whose vertices lay on an ellipse at jittered, equally spaced angles."""
    shape_classes = SIZE_CLASSES[distribution.object_size]
    shape_class = shape_classes[rng.integers(len(shape_classes))]
    half_length = rng.uniform(*shape_class.half_length)
    half_width = half_length * rng.uniform(*shape_class.aspect)
    num_vertices = int(rng.integers(distribution.num_vertices[0], distribution.num_vertices[1] + 1))
    angles = 2.0 * np.pi * (np.arange(num_vertices) + rng.uniform(-0.3, 0.3, num_vertices)) / num_vertices
    outline = np.stack([half_length * np.cos(angles), half_width * np.sin(angles)], axis=1)
    return centred(outline)[0]


def _sample_gripper_pose(distribution: SceneDistribution, edges: FloatArray, rng: np.random.Generator) -> FloatArray:
    """[3] near a uniformly chosen point of the border, heading inwards."""
    following = np.roll(edges, -1, axis=0)
    lengths = np.linalg.norm(following - edges, axis=1)
    side = rng.choice(len(edges), p=lengths / lengths.sum())
    along = (following[side] - edges[side]) / lengths[side]
    inward = np.array([-along[1], along[0]])  # counter-clockwise edges have the surface on their left
    margin = 0.1 * lengths[side]
    position = edges[side] + rng.uniform(margin, lengths[side] - margin) * along
    position = position + rng.uniform(*distribution.start_distance) * inward
    heading = np.arctan2(inward[1], inward[0]) + rng.uniform(-1.0, 1.0) * distribution.start_angle
    return np.array([*position, heading])
