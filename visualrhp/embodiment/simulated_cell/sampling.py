"""Random cells, each a function of (distribution, seed, split, index) only."""

from __future__ import annotations

import functools
import math
from typing import Annotated, Final

import numpy as np
import shapely

from visualrhp.embodiment.arm_silhouette import arm_mask
from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.reach import ReachMap
from visualrhp.embodiment.robot_model import CELL_GRIPPER, HOME, Mounting
from visualrhp.embodiment.segmentation.detection import Mask
from visualrhp.embodiment.simulated_cell.looks import CellLook, sample_look
from visualrhp.embodiment.simulated_cell.objects import FRICTION, ROLLING_FRICTION, CellObject, sample_object
from visualrhp.embodiment.simulated_cell.task import (
    CAMERA_HEIGHT,
    FOCAL_LENGTH,
    IMAGE_SIZE,
    TABLE_SIDE,
    CellTask,
    nominal_camera,
)
from visualrhp.errors import ConfigError
from visualrhp.parameters import AsRange, AsTuple, Field, NonNegative, Positive, parameters
from visualrhp.scene import geometry
from visualrhp.scene.placement import place_objects, sample_position
from visualrhp.scene.sampling import EDGE_DISTANCE, Layout, SceneDistribution
from visualrhp.scene.scene import TargetRegion, centred, square_edges
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import FloatArray, ObjectSize

ATTEMPTS: Final = 40
"""Sets of objects that are tried before a distribution counts as impossible, each in :data:`ARRANGEMENTS`."""

ARRANGEMENTS: Final = 15
"""Places of the target, the gripper and the objects that are tried for a set of objects."""

MOST_HIDDEN: Final = 0.3
"""Share of an object, and of the target, that the arm hides at most at the start: the paper assumes full observability
(Sec. 4), and nobody begins a task before he has seen it."""

MAX_OBJECTS: Final = 10
"""Objects on the table of 50 cm."""

_SEEN_HEIGHT: Final = 0.04  # at which objects are about as wide as seen from above [m]
_DISC: Final = np.stack(
    [r * np.array([np.cos(a), np.sin(a)]) for r in (0.3, 0.6, 0.95) for a in np.linspace(0.0, 2.0 * np.pi, 12, False)]
)

Range = Annotated[tuple[NonNegative, NonNegative], AsRange, AsTuple]
PositiveRange = Annotated[tuple[Positive, Positive], AsRange, AsTuple]
Kinds = Annotated[tuple[Annotated[Kind, Field(strict=False)], ...], Field(min_length=1, strict=False)]
NumObjects = Annotated[int, Field(ge=1, le=MAX_OBJECTS)]


@parameters(kw_only=True)
class CellDistribution:
    """Parameters of the random cells. SI units.

    Attributes:
        num_objects: smallest and largest number of objects, with the desired one; a single number stands for both.
        desired: kinds of the desired object, equally likely.
        kinds: kinds of the obstacles, equally likely.
        desired_size: size class of the desired object.
        object_size: size class of the obstacles.
        layout: where target and desired object are, see :data:`visualrhp.scene.sampling.Layout`.
        target_radius: of the printed target, which lies on the table entirely.
        clearance: least distance between objects, gripper and edges at the start.
        start_distance: range of the distance of the gripper frame's origin from its edge at the start.
        start_angle: largest deviation of the gripper's heading from the inward normal of its edge [rad].
        friction: range of the objects' Coulomb coefficient.
        rolling_friction: range of the lever of their rolling resistance [m].
        mass_factor: range of a factor on their masses.
        camera_offset: standard deviation of the camera's place [m], each of three coordinates.
        camera_tilt: standard deviation of its direction [rad], about each of three axes.
        focal_error: standard deviation of its focal length, relative.
        lens_distortion: largest radial distortion k1; a webcam has a few percent.
        camera_noise: range of the standard deviation of its noise [grey values of 255].
        camera_blur: range of the standard deviation of its blur [px].
        varied_look: whether light and textures vary; otherwise they are those of a default :class:`CellLook`.

    Raises:
        ConfigError: a parameter is out of range.
    """

    num_objects: Annotated[tuple[NumObjects, NumObjects], AsRange, AsTuple] = (1, 7)
    desired: Kinds = tuple(Kind)
    kinds: Kinds = tuple(Kind)
    desired_size: ObjectSize = "small"
    object_size: ObjectSize = "mixed"
    layout: Layout = "uniform"
    target_radius: Annotated[float, Field(gt=0, le=0.2)] = 0.07
    clearance: NonNegative = 0.008
    start_distance: Annotated[tuple[float, float], AsTuple] = (0.01, 0.05)
    start_angle: Annotated[float, Field(ge=0, le=3.1416)] = math.pi / 6.0
    friction: PositiveRange = FRICTION
    rolling_friction: PositiveRange = ROLLING_FRICTION
    mass_factor: PositiveRange = (1.0, 1.0)
    camera_offset: NonNegative = 0.005
    camera_tilt: NonNegative = math.radians(0.7)
    focal_error: NonNegative = 0.01
    lens_distortion: NonNegative = 0.04
    camera_noise: Range = (1.0, 4.0)
    camera_blur: Range = (0.3, 0.9)
    varied_look: bool = True

    def __post_init__(self) -> None:
        for name in (
            "num_objects",
            "start_distance",
            "friction",
            "rolling_friction",
            "mass_factor",
            "camera_noise",
            "camera_blur",
        ):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}=[{low}, {high}]: the smaller bound comes first.")
        if self.layout == "object_behind" and self.num_objects[0] < 2:
            raise ValueError(f"layout=object_behind needs an obstacle: num_objects={list(self.num_objects)}.")


def sample_cell(distribution: CellDistribution, seed: int, split: Split, index: int) -> CellTask:
    """Sample cell ``index``: the same for equal arguments, independent of any other index.

    Objects stand and lie apart from each other and from the gripper, which starts near an edge that it can reach, open
    and heading inwards. The desired object's centre is outside the target region. The arm hides neither the target nor
    an object from a camera above the table.

    Raises:
        ConfigError: no arrangement was found, or the seed or the index is negative.
    """
    for name, value in (("seed", seed), ("index", index)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
            raise ConfigError(f"{name}={value!r:.60} is out of range: it should be an integer, at least 0.")
    rng = generator_for(seed, split, index, Stream.CELL)
    looks = generator_for(seed, split, index, Stream.CELL_LOOK)
    camera = _sample_camera(distribution, looks)
    look = CellLook()
    if distribution.varied_look:
        look = sample_look(looks, distribution.camera_noise, distribution.camera_blur)
    count = int(rng.integers(distribution.num_objects[0], distribution.num_objects[1] + 1))
    for _ in range(ATTEMPTS):
        objects = [_sample_object(distribution, number == 0, rng) for number in range(count)]
        hulls = [geometry.convex_hull(thing.solid.silhouette(thing.rotation(0.0))) for thing in objects]
        found = next(filter(None, (_arrange(distribution, hulls, rng) for _ in range(ARRANGEMENTS))), None)
        if found is not None:
            poses, target, gripper_pose = found
            return CellTask(
                tuple(objects),
                poses,
                target,
                gripper_pose,
                camera,
                look,
                pad_friction=float(looks.uniform(0.7, 1.0)),
                seed=int(looks.integers(2**31)),
            )
    raise ConfigError(
        f"No cell was found in {ATTEMPTS * ARRANGEMENTS} attempts: there should be {count} objects at cell.clearance="
        f"{distribution.clearance:g} m from each other, and the first outside the target region, with cell.layout="
        f"{distribution.layout}. Decrease cell.num_objects or cell.clearance, or choose cell.layout=uniform."
    )


def _sample_object(distribution: CellDistribution, is_desired: bool, rng: np.random.Generator) -> CellObject:
    kinds = distribution.desired if is_desired else distribution.kinds
    size = distribution.desired_size if is_desired else distribution.object_size
    thing = sample_object(
        kinds[int(rng.integers(len(kinds)))],
        size,
        rng,
        friction=distribution.friction,
        rolling_friction=distribution.rolling_friction,
        mass_factor=distribution.mass_factor,
    )
    return thing


def _arrange(
    distribution: CellDistribution, hulls: list[FloatArray], rng: np.random.Generator
) -> tuple[FloatArray, TargetRegion, tuple[float, float, float]] | None:
    """Poses [m, 3] of the objects' body frames, the target and the gripper's pose; None if there is no room.

    Args:
        distribution: the rules.
        hulls: of the objects seen from above, [V, 2] in their body frames.
        rng: source of the random numbers.
    """
    edges = square_edges(TABLE_SIDE)
    target = TargetRegion(_sample_target(distribution, edges, rng), distribution.target_radius)
    gripper_pose = _sample_gripper_pose(distribution, edges, rng)
    if not _reach().contains(gripper_pose):
        return None
    hidden = _hidden(gripper_pose.tolist())
    if _hidden_share(hidden, target.position + target.radius * _DISC, 0.0) > MOST_HIDDEN:
        return None
    outlines, centres = zip(*(centred(hull) for hull in hulls), strict=True)
    rules = SceneDistribution(
        clearance=distribution.clearance, layout=distribution.layout, num_objects=(2, MAX_OBJECTS)
    )
    fingers = CELL_GRIPPER.outlines(gripper_pose, CELL_GRIPPER.stroke)
    placed = place_objects(rules, outlines, edges, target, fingers, rng)
    if placed is None:
        return None
    if distribution.layout == "object_behind" and not _is_behind(outlines, placed, gripper_pose):
        return None
    for outline, pose in zip(outlines, placed, strict=True):
        if _hidden_share(hidden, geometry.to_world(_within(outline), pose), _SEEN_HEIGHT) > MOST_HIDDEN:
            return None
    poses = placed.copy()
    for pose, centre in zip(poses, centres, strict=True):  # of the hull in the body frame
        pose[:2] -= geometry.rotation_matrix(float(pose[2])) @ centre
    x, y, theta = gripper_pose.tolist()
    return poses, target, (x, y, theta)


def _hidden(gripper_pose: tuple[float, float, float]) -> Mask:
    """[H, W] pixels of the nominal camera in which the arm is at the start."""
    joints = _kinematics().inverse(*gripper_pose, near=HOME)
    return arm_mask(nominal_camera(), joints, CELL_GRIPPER.stroke, Mounting())


def _hidden_share(hidden: Mask, points: FloatArray, height: float) -> float:
    """Share of ``points`` [N, 2] at a height [m] that the arm hides."""
    pixels = nominal_camera().project(np.concatenate([points, np.full((len(points), 1), height)], axis=1))
    columns, rows = np.clip(np.round(pixels).astype(int), 0, np.array(hidden.shape[::-1]) - 1).T
    return float(hidden[rows, columns].mean())


def _within(outline: FloatArray) -> FloatArray:
    """[N, 2] points all over a convex outline [V, 2] that contains the origin."""
    return np.concatenate([share * outline for share in (0.25, 0.5, 0.75, 1.0)])


def _is_behind(outlines: tuple[FloatArray, ...], poses: FloatArray, gripper_pose: FloatArray) -> bool:
    segment = shapely.LineString([gripper_pose[:2], poses[0, :2]])
    placed = zip(outlines[1:], poses[1:], strict=True)
    return any(segment.intersects(shapely.Polygon(geometry.to_world(outline, pose))) for outline, pose in placed)


def _sample_target(distribution: CellDistribution, edges: FloatArray, rng: np.random.Generator) -> FloatArray:
    """[2] centre of the target, printed on the table: its disc is within the edges."""
    limit = float(edges.max()) - distribution.target_radius
    while True:
        x, y = sample_position(-limit, limit, rng)
        if distribution.layout != "target_at_edge" or limit - max(abs(x), abs(y)) <= EDGE_DISTANCE:
            return np.array([x, y])


def _sample_gripper_pose(distribution: CellDistribution, edges: FloatArray, rng: np.random.Generator) -> FloatArray:
    """[3] near a uniformly chosen point of the border, heading inwards, as in the planner's scenes."""
    side = int(rng.integers(4))
    along = (edges[(side + 1) % 4] - edges[side]) / TABLE_SIDE
    inward = np.array([-along[1], along[0]])
    margin = 0.1 * TABLE_SIDE
    position = edges[side] + rng.uniform(margin, TABLE_SIDE - margin) * along
    position = position + rng.uniform(*distribution.start_distance) * inward
    heading = math.atan2(inward[1], inward[0]) + rng.uniform(-1.0, 1.0) * distribution.start_angle
    return np.array([*position, math.remainder(heading, 2.0 * math.pi)])


def _sample_camera(distribution: CellDistribution, rng: np.random.Generator) -> Camera:
    offset = distribution.camera_offset * rng.standard_normal(3)
    tilt = CAMERA_HEIGHT * distribution.camera_tilt * rng.standard_normal(2)
    roll = distribution.camera_tilt * float(rng.standard_normal())
    focal = FOCAL_LENGTH * (1.0 + distribution.focal_error * float(rng.standard_normal()))
    radial = distribution.lens_distortion * float(rng.uniform(-1.0, 1.0))
    place = offset + (0.0, 0.0, CAMERA_HEIGHT)
    level = Camera.above(
        place,
        focal,
        *IMAGE_SIZE,
        look_at=(offset[0] + tilt[0], offset[1] + tilt[1], 0.0),
        distortion=[radial, 0, 0, 0, 0],
    )
    pose = level.pose.copy()
    c, s = math.cos(roll), math.sin(roll)
    pose[:3, :3] = pose[:3, :3] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Camera(level.intrinsics, level.distortion, pose, *IMAGE_SIZE)


@functools.cache
def _kinematics() -> ArmKinematics:
    return ArmKinematics()


@functools.cache
def _reach() -> ReachMap:
    return ReachMap.load(Mounting())
