"""What the arm can reach: a precomputed map, which the planner's model asks before it simulates an action.

The mounting. No mounting of a UR5e lets a level gripper take every pose over the table: the flange, 8.5 cm behind the
gripper frame's origin, would have to come everywhere in a square of 67 cm, and it reaches a ring of 23.5 to 89.5 cm
around the base (nearer, the upper arm would touch the wrist; farther, the elbow is almost stretched). The base stands
on the table's level, where the ring is widest and no pedestal is in the way, 55 cm from the centre of the table, where
the ring covers most: 99.7% of the poses over the table, every heading within 21 cm of the centre in x and in y, and 99%
of the poses at which random tasks start (:class:`visualrhp.scene.sampling.SceneDistribution`). What is missing are
headings for which the flange would be beyond the far corners, or too close to the base. Without the bracket, the
gripper directly on the flange, whatever the posture and without regard to a continuous way, a search from 48 random
starts finds 84% of 300 poses over the table (5 x 5 places on 44 cm, 12 headings) without collision with the base 45 cm
from the centre, 80% at 54 cm, and 77% with the base raised by 30 cm; with the bracket, nearly all of the same poses.

The map. Whether the arm collides depends on where the flange is relative to the base, and where the gripper points
relative to the arm: by turning joint 1 alone, the rest of the arm stays as it is, and the table is taken for a plane
without end. So the map has two dimensions: the distance of the flange from the axis of joint 1, and the heading
relative to the direction in which the flange lies from there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.robot_model import FLANGE_ABOVE, FLANGE_BEHIND, GRIPPER_HEIGHT, Mounting
from visualrhp.errors import DataError, UnreachableError
from visualrhp.simulation.action_spaces import GripperMotion
from visualrhp.types import FloatArray, wrap_angle

RADIUS_STEP: Final = 0.005
"""Of the map [m]; the first cell begins at the axis of joint 1."""

NUM_HEADINGS: Final = 120
"""Cells of the map for the relative heading, a whole turn."""

WORKSPACE: Final = 0.33
"""The gripper frame's origin stays in a square of twice this side [m] around the centre of the table: 8 cm beyond its
edges."""

LEAVING_DISTANCE: Final = 0.01
"""A motion may begin outside the map if it is inside after this distance [m], or :data:`LEAVING_ANGLE`: where the arm
comes to rest is not exactly where it was sent. The map keeps at least as much distance from collisions."""

LEAVING_ANGLE: Final = math.radians(5.0)
"""[rad], see :data:`LEAVING_DISTANCE`."""

REACH_FILE: Final = "reach_map.npz"
_HEADING_STEP: Final = 2.0 * math.pi / NUM_HEADINGS


def geometry_of(mounting: Mounting) -> FloatArray:
    """[6] what a map was computed for: what else it depends on are the models of the arm and the gripper."""
    return np.array([mounting.height, FLANGE_BEHIND, FLANGE_ABOVE, GRIPPER_HEIGHT, RADIUS_STEP, NUM_HEADINGS])


@dataclass(frozen=True, slots=True)
class TurningRange:
    """How far wrist 3 can turn from where it is before it comes to its limit, which the map does not know.

    The flange points down, so the heading is that of joint 1 minus the angle of wrist 3. A state has no winding:
    headings are told apart up to half a turn from the present one, more than the roll-outs of receding horizon planning
    turn.

    Attributes:
        mounting: of the arm.
        lateral: distance of the flange's axis from the plane of the upper arm and the forearm [m].
        pose: [3] the present one of the gripper frame (x [m], y [m], theta [rad]).
        forwards: largest turn of wrist 3 [rad], by which the gripper turns clockwise.
        backwards: the same in the other direction [rad].
    """

    mounting: Mounting
    lateral: float
    pose: tuple[float, float, float]
    forwards: float
    backwards: float

    def allows(self, pose: FloatArray, motion: GripperMotion) -> bool:
        """Whether wrist 3 can make ``motion`` from ``pose`` [3]; it can always turn back from a limit."""
        x, y, theta = pose.tolist()
        dx, dy, rotation = displacement_of(theta, motion).tolist()
        turned = self._wrist(x, y, theta)
        after = turned + self._pan(x + dx, y + dy, theta + rotation) - self._pan(x, y, theta) - rotation
        return min(-self.backwards, turned) <= after <= max(self.forwards, turned)

    def _wrist(self, x: float, y: float, theta: float) -> float:
        """Angle of wrist 3, against the present one."""
        turn = float(wrap_angle(theta - self.pose[2]))
        return float(wrap_angle(self._pan(x, y, theta) - self._pan(*self.pose))) - turn

    def _pan(self, x: float, y: float, theta: float) -> float:
        """Direction of the arm's plane [rad]."""
        across = x - FLANGE_BEHIND * math.cos(theta) - self.mounting.x
        up = y - FLANGE_BEHIND * math.sin(theta) - self.mounting.y
        return math.atan2(up, across) - math.asin(min(1.0, self.lateral / math.hypot(across, up)))


@dataclass(frozen=True, eq=False)
class ReachMap:
    """The poses of the level gripper that the arm can take.

    Attributes:
        mounting: of the arm.
        free: [R, H] bool, whether the arm can reach all of a cell, away from singularities, limits of its joints and
            collisions with itself and the table; R cells of the flange's distance from the axis of joint 1, H of the
            heading relative to the direction of the flange from there.
        workspace: the origin of the gripper frame stays in the square of twice this side [m] around the world's origin.
    """

    mounting: Mounting
    free: npt.NDArray[np.bool_]
    workspace: float = WORKSPACE
    _padded: npt.NDArray[np.bool_] = field(init=False, repr=False)
    _cells: bytes = field(init=False, repr=False)
    _free_ring: tuple[float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.free.ndim != 2 or self.free.shape[1] != NUM_HEADINGS or self.free.dtype != np.bool_:
            raise DataError(
                f"a map of the reach has the shape [R, {NUM_HEADINGS}] of bool, not {list(self.free.shape)} of "
                f"{self.free.dtype}"
            )
        padded = np.concatenate([self.free, np.zeros((1, NUM_HEADINGS), bool)])  # beyond the last radius
        padded.setflags(write=False)
        object.__setattr__(self, "_padded", padded)
        object.__setattr__(self, "_cells", self.free.tobytes())
        object.__setattr__(self, "_free_ring", _widest_run(self.free))

    def contains(self, poses: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Whether the arm can take each pose of the gripper frame.

        Args:
            poses: [..., 3] x [m], y [m], theta [rad].

        Returns:
            [...] bool.
        """
        poses = np.asarray(poses, dtype=np.float64)
        x, y, theta = poses[..., 0], poses[..., 1], poses[..., 2]
        across = x - FLANGE_BEHIND * np.cos(theta) - self.mounting.x
        up = y - FLANGE_BEHIND * np.sin(theta) - self.mounting.y
        last = len(self._padded) - 1
        radius = np.fmin(np.hypot(across, up) / RADIUS_STEP, last).astype(np.intp)
        heading = (theta - np.arctan2(up, across)) / _HEADING_STEP % NUM_HEADINGS
        heading = np.fmin(heading, NUM_HEADINGS - 1).astype(np.intp)  # rounding can give the divisor itself
        inside = np.maximum(np.abs(x), np.abs(y)) <= self.workspace
        return self._padded[radius, heading] & inside

    def allows(self, pose: npt.ArrayLike, motion: GripperMotion) -> bool:
        """Whether the arm can make ``motion`` from ``pose`` [3]: a straight line, the heading turning in proportion.

        The way and the end must be in the map; the start may be just outside (:data:`LEAVING_DISTANCE`). Opening and
        closing the fingers is always possible.
        """
        return self._obstacle(pose, motion) is None

    def check(self, pose: npt.ArrayLike, motion: GripperMotion) -> None:
        """Check that :meth:`allows`.

        Raises:
            UnreachableError: it does not; says where.
        """
        obstacle = self._obstacle(pose, motion)
        if obstacle is not None:
            x, y, theta = obstacle
            why = "cannot be taken by the arm: it is too far, too near, or the arm would touch itself"
            if max(abs(x), abs(y)) > self.workspace:
                why = f"is outside the workspace, a square of {2 * self.workspace:g} m around the centre of the table"
            raise UnreachableError(
                f"the motion would lead through the pose ({x:.3f} m, {y:.3f} m, {math.degrees(theta):.1f} degrees), "
                f"which {why}"
            )

    def _obstacle(self, pose: npt.ArrayLike, motion: GripperMotion) -> tuple[float, float, float] | None:
        """A pose of the way, from a little after its start to its end, that is not in the map; None if there is none.

        In plain Python, which is three times as fast as NumPy for so few poses: roll-outs ask before every action.
        """
        x, y, theta = np.asarray(pose, dtype=np.float64).tolist()
        dx, dy, turn = _displacement(theta, motion)
        length = math.hypot(dx, dy)
        if self._is_far_inside(x, y, x + dx, y + dy, theta + 0.5 * turn, length + FLANGE_BEHIND * abs(turn)):
            return None
        count = math.ceil(max(length / LEAVING_DISTANCE, abs(turn) / LEAVING_ANGLE))
        for k in range(count, 0, -1):  # the end leaves the map most often
            part = k / count
            at = x + part * dx, y + part * dy, theta + part * turn
            if not self._contains_one(*at):
                return at
        return None

    def _is_far_inside(self, x: float, y: float, end_x: float, end_y: float, theta: float, travel: float) -> bool:
        """Whether a motion stays, as most do, where all headings are free.

        Args:
            x, y, end_x, end_y: both ends of the line of the gripper frame's origin [m].
            theta: heading in the middle [rad].
            travel: upper limit of the way of the flange, which is never farther than half of it from its middle [m].
        """
        if max(abs(x), abs(y), abs(end_x), abs(end_y)) > self.workspace:
            return False
        across = 0.5 * (x + end_x) - FLANGE_BEHIND * math.cos(theta) - self.mounting.x
        up = 0.5 * (y + end_y) - FLANGE_BEHIND * math.sin(theta) - self.mounting.y
        nearest, farthest = self._free_ring
        return nearest + 0.5 * travel <= math.hypot(across, up) <= farthest - 0.5 * travel

    def _contains_one(self, x: float, y: float, theta: float) -> bool:
        """:meth:`contains` of one pose."""
        across = x - FLANGE_BEHIND * math.cos(theta) - self.mounting.x
        up = y - FLANGE_BEHIND * math.sin(theta) - self.mounting.y
        radius = int(math.hypot(across, up) / RADIUS_STEP)
        heading = int((theta - math.atan2(up, across)) / _HEADING_STEP % NUM_HEADINGS)
        return (
            -self.workspace <= x <= self.workspace
            and -self.workspace <= y <= self.workspace
            and radius < len(self.free)
            and self._cells[radius * NUM_HEADINGS + min(heading, NUM_HEADINGS - 1)] != 0
        )

    def headings(self, position: Sequence[float], count: int = 72) -> npt.NDArray[np.bool_]:
        """[count] which of as many headings, from 0 counter-clockwise, the gripper can take at ``position`` [2] [m].

        A task whose objects have none cannot be completed, whatever the planner.
        """
        theta = 2.0 * np.pi * np.arange(count) / count
        x, y = np.broadcast_to(np.asarray(position, dtype=np.float64)[:2, None], (2, count))
        return self.contains(np.stack([x, y, theta], axis=1))

    def save(self, path: Path) -> None:
        """Write the map to ``path``, an npz file."""
        np.savez_compressed(
            path, geometry=geometry_of(self.mounting), free=np.packbits(self.free), radii=np.array(len(self.free))
        )

    @classmethod
    def load(cls, mounting: Mounting | None = None) -> ReachMap:
        """The map of the package, for a ``mounting`` at the height for which it was computed (the default one's).

        Raises:
            DataError: it was computed for another geometry; compute it again.
        """
        mounting = mounting or Mounting()
        with (
            (resources.files("visualrhp.embodiment") / REACH_FILE).open("rb") as file,
            np.load(file, allow_pickle=False) as stored,
        ):
            geometry, bits, radii = stored["geometry"], stored["free"], int(stored["radii"])
        if not np.allclose(geometry, geometry_of(mounting), atol=1e-9):
            raise DataError(
                f"the stored map of the reach is for a height, a bracket and cells of {geometry.tolist()}, not "
                f"{geometry_of(mounting).tolist()}; compute one with visualrhp.embodiment.reach_computation"
            )
        free = np.unpackbits(bits, count=radii * NUM_HEADINGS).reshape(radii, NUM_HEADINGS).astype(bool)
        free.setflags(write=False)
        return cls(mounting, free)


def displacement_of(theta: float, motion: GripperMotion) -> FloatArray:
    """[3] change of x, y [m] and theta [rad] in the world frame by ``motion`` from the heading ``theta`` [rad]."""
    return np.array(_displacement(theta, motion))


def _widest_run(free: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Between which radii [m] all headings of ``free`` [R, H] are free, the longest run; an empty range without any."""
    borders = np.flatnonzero(np.diff(np.concatenate([[False], free.all(axis=1), [False]]).astype(np.int8)))
    if not len(borders):
        return math.inf, -math.inf
    starts, ends = borders[::2], borders[1::2]
    longest = int(np.argmax(ends - starts))
    return float(starts[longest]) * RADIUS_STEP, float(ends[longest]) * RADIUS_STEP


def _displacement(theta: float, motion: GripperMotion) -> tuple[float, float, float]:
    cos, sin = math.cos(theta), math.sin(theta)
    return cos * motion.forward - sin * motion.left, sin * motion.forward + cos * motion.left, motion.rotation
