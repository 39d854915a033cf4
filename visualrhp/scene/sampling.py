"""Random task instances, each a function of (distribution, seed, split, index) only (paper, Sec. 6.1 and 7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import shapely

from visualrhp.errors import ConfigError
from visualrhp.parameters import AsRange, AsTuple, Field, NonNegative, Positive, parameters
from visualrhp.scene import geometry
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.scene import ObjectShape, Scene, TargetRegion, TaskInstance, square_edges
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import FloatArray, ObjectSize, State

MAX_OBJECTS = 20
"""Largest number of objects that can be requested; the paper uses up to 7."""

NumObjects = Annotated[int, Field(ge=1, le=MAX_OBJECTS)]
NumVertices = Annotated[int, Field(ge=3)]

Layout = Literal["uniform", "target_at_edge", "object_in_corner", "object_behind"]
"""Where the target region and the desired object are; all but ``uniform`` are hard and not in the paper:

- ``target_at_edge``: the target's centre is at most :data:`EDGE_DISTANCE` from an edge;
- ``object_in_corner``: the desired object's centre is at most :data:`CORNER_DISTANCE` from a corner;
- ``object_behind``: an obstacle is between the gripper and the desired object.
"""

EDGE_DISTANCE = 0.03
CORNER_DISTANCE = 0.09

_ATTEMPTS_PER_OBJECT = 100
_ATTEMPTS_PER_SCENE = 500


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

    Raises:
        ConfigError: a parameter is out of range.
    """

    num_objects: Annotated[tuple[NumObjects, NumObjects], AsRange, AsTuple] = (1, 7)
    object_size: ObjectSize = "mixed"
    surface_side: Positive = 0.5
    target_radius: Positive = 0.07
    density: Positive = 1.0
    friction: Positive = 0.3
    num_vertices: Annotated[tuple[NumVertices, NumVertices], AsTuple] = (4, 8)
    clearance: NonNegative = 0.005
    start_distance: Annotated[tuple[float, float], AsTuple] = (0.01, 0.05)
    start_angle: NonNegative = np.pi / 6
    layout: Layout = "uniform"

    def __post_init__(self) -> None:
        for name in ("num_objects", "num_vertices", "start_distance"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}=[{low}, {high}]: the smaller bound comes first.")
        if self.layout == "object_behind" and self.num_objects[0] < 2:
            raise ValueError(f"layout=object_behind needs an obstacle: num_objects={list(self.num_objects)}.")


def sample_task_instance(distribution: SceneDistribution, seed: int, split: Split, index: int) -> TaskInstance:
    """Sample task instance ``index``: the same for equal arguments, independent of any other index.

    Objects lie entirely on the surface, at a distance from each other and from the gripper, which starts near an edge,
    open and heading inwards. The desired object's centre is outside the target region.

    Raises:
        ConfigError: the objects of the distribution do not fit on the surface, or it is within the target region.
    """
    rng = generator_for(seed, split, index, Stream.INSTANCE)
    num_objects = _sample_num_objects(distribution, rng)
    edges = square_edges(distribution.surface_side)
    gripper = Gripper()
    for _ in range(_ATTEMPTS_PER_SCENE):
        target = TargetRegion(_sample_target(distribution.layout, edges, rng), distribution.target_radius)
        objects = tuple(_sample_shape(distribution, rng) for _ in range(num_objects))
        gripper_pose = _sample_gripper_pose(distribution, edges, rng)
        obstacles = [shapely.Polygon(outline) for outline in gripper.outlines(gripper_pose, gripper.stroke)]
        poses = _place_objects(distribution, objects, edges, target, obstacles, rng)
        if poses is not None and (distribution.layout != "object_behind" or _is_behind(objects, poses, gripper_pose)):
            state = State.create(gripper_pose, gripper.stroke, False, poses)
            return TaskInstance(Scene(target, objects, edges, gripper), state)
    raise ConfigError(
        f"no task instance was found in {_ATTEMPTS_PER_SCENE} attempts: {num_objects} objects (scene.object_size="
        f"{distribution.object_size}) outside each other and the desired one outside the target region "
        f"(target_radius={distribution.target_radius:g} m) need a surface larger than "
        f"surface_side={distribution.surface_side:g} m, fewer objects, or a smaller target_radius or clearance."
    )


def sampled_num_objects(distribution: SceneDistribution, seed: int, split: Split, index: int) -> int:
    """Number of objects of task instance ``index``, without sampling the instance."""
    return _sample_num_objects(distribution, generator_for(seed, split, index, Stream.INSTANCE))


def _sample_num_objects(distribution: SceneDistribution, rng: np.random.Generator) -> int:
    return int(rng.integers(distribution.num_objects[0], distribution.num_objects[1] + 1))


def _sample_position(edges: FloatArray, rng: np.random.Generator) -> FloatArray:
    """[2] uniform over the surface."""
    while True:
        position = rng.uniform(edges.min(axis=0), edges.max(axis=0))
        if geometry.contains(edges, *position):
            return position


def _sample_target(layout: Layout, edges: FloatArray, rng: np.random.Generator) -> FloatArray:
    """[2] centre of the target region."""
    border = shapely.LinearRing(edges)
    while True:
        position = _sample_position(edges, rng)
        if layout != "target_at_edge" or border.distance(shapely.Point(position)) <= EDGE_DISTANCE:
            return position


def _is_behind(objects: tuple[ObjectShape, ...], poses: FloatArray, gripper_pose: FloatArray) -> bool:
    """Whether an obstacle intersects the segment from the gripper to the desired object."""
    segment = shapely.LineString([gripper_pose[:2], poses[0, :2]])
    outlines = [geometry.to_world(shape.outline, pose) for shape, pose in zip(objects[1:], poses[1:], strict=True)]
    return any(segment.intersects(shapely.Polygon(outline)) for outline in outlines)


def _sample_shape(distribution: SceneDistribution, rng: np.random.Generator) -> ObjectShape:
    """A convex polygon whose vertices lie on an ellipse at jittered, equally spaced angles."""
    shape_classes = SIZE_CLASSES[distribution.object_size]
    shape_class = shape_classes[rng.integers(len(shape_classes))]
    half_length = rng.uniform(*shape_class.half_length)
    half_width = half_length * rng.uniform(*shape_class.aspect)
    num_vertices = int(rng.integers(distribution.num_vertices[0], distribution.num_vertices[1] + 1))
    angles = 2.0 * np.pi * (np.arange(num_vertices) + rng.uniform(-0.3, 0.3, num_vertices)) / num_vertices
    outline = np.stack([half_length * np.cos(angles), half_width * np.sin(angles)], axis=1)
    return ObjectShape.centred(outline, distribution.density, distribution.friction)


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


def _place_objects(
    distribution: SceneDistribution,
    objects: tuple[ObjectShape, ...],
    edges: FloatArray,
    target: TargetRegion,
    obstacles: list[shapely.Polygon],
    rng: np.random.Generator,
) -> FloatArray | None:
    """[m, 3] poses by rejection sampling, or None if there was no place for an object."""
    clearance = distribution.clearance
    surface = shapely.Polygon(edges).buffer(-clearance)
    occupied = list(obstacles)
    poses = []
    for number, shape in enumerate(objects):
        for _ in range(_ATTEMPTS_PER_OBJECT):
            pose = np.array([*_sample_position(edges, rng), rng.uniform(-np.pi, np.pi)])
            if number == 0 and not _may_start(distribution.layout, pose[:2], edges, target):
                continue
            outline = shapely.Polygon(geometry.to_world(shape.outline, pose))
            if surface.contains(outline) and (shapely.distance(outline, occupied) >= clearance).all():
                occupied.append(outline)
                poses.append(pose)
                break
        else:
            return None
    return np.array(poses)


def _may_start(layout: Layout, position: FloatArray, edges: FloatArray, target: TargetRegion) -> bool:
    """Whether the desired object may start with its centre at ``position`` [2]."""
    if np.hypot(*(position - target.position)) <= target.radius:
        return False
    return layout != "object_in_corner" or bool(np.linalg.norm(edges - position, axis=1).min() <= CORNER_DISTANCE)
