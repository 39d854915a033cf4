"""Samples of the kinodynamic RRT, and their distances from the states of its tree (Sec. 6.1)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np

from visualrhp.scene.scene import Scene
from visualrhp.types import Column, FloatArray, State, wrap_angle

if TYPE_CHECKING:
    from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT


class Sample(Protocol):
    """A sampled arrangement. ``vectors`` are states as in :class:`State`: [N, 5 + 3 m]."""

    def squared_distances(self, vectors: FloatArray) -> FloatArray:
        """[N] squared weighted distance of the states to the sample [m^2]."""
        ...

    def gripper_pose(self, vector: FloatArray) -> tuple[float, float, float]:
        """The pose that the gripper should move to from the state ``vector`` [5 + 3 m]: x, y [m], theta [rad]."""
        ...


class ExploringSample:
    """Gripper and objects anywhere on the surface."""

    def __init__(self, planner: KinodynamicRRT, scene: Scene, rng: np.random.Generator) -> None:
        low, high = scene.edges.min(axis=0), scene.edges.max(axis=0)
        self._x, self._y = rng.uniform(low, high).tolist()
        self._theta = float(rng.uniform(-np.pi, np.pi))
        self._objects = rng.uniform(low, high, (scene.num_objects, 2))
        weights = np.full(scene.num_objects, planner.obstacle_weight)
        weights[0] = planner.object_weight
        self._squared_weights = weights**2
        self._heading_weight = planner.heading_weight

    def squared_distances(self, vectors: FloatArray) -> FloatArray:
        turn = self._heading_weight * wrap_angle(vectors[:, Column.GRIPPER_THETA] - self._theta)
        gripper = (
            (vectors[:, Column.GRIPPER_X] - self._x) ** 2 + (vectors[:, Column.GRIPPER_Y] - self._y) ** 2 + turn**2
        )
        dx, dy = vectors[:, Column.OBJECTS_X] - self._objects[:, 0], vectors[:, Column.OBJECTS_Y] - self._objects[:, 1]
        return gripper + (dx**2 + dy**2) @ self._squared_weights

    def gripper_pose(self, vector: FloatArray) -> tuple[float, float, float]:
        return self._x, self._y, self._theta


_TARGET_SHARE = 0.5
"""The desired object is sampled within this share of the target region's radius, rather than at its border."""

_SIDE_DEVIATION = 0.3
"""Standard deviation of the direction from the object to a pushing gripper, around straight behind [rad]."""

_HEADING_DEVIATION = 0.15
"""Standard deviation of a pushing gripper's heading from the direction of the object [rad]."""

_BEHIND_DISTANCE = 0.04
_BEHIND_ANGLE = 0.6
"""A gripper this close [m, rad] to its place behind the object may push."""


class PushingSample:
    """The gripper at the desired object; ``with_object``: behind it, and the object in the target region."""

    def __init__(
        self, planner: KinodynamicRRT, scene: Scene, start: State, rng: np.random.Generator, with_object: bool
    ) -> None:
        radius = _TARGET_SHARE * scene.target.radius * math.sqrt(rng.random())
        angle = rng.uniform(-np.pi, np.pi)
        self._x = float(scene.target.position[0]) + radius * math.cos(angle)
        self._y = float(scene.target.position[1]) + radius * math.sin(angle)
        self._standoff = float(rng.uniform(0.0, planner.standoff))
        side = rng.normal(0.0, _SIDE_DEVIATION) if with_object else rng.uniform(-np.pi, np.pi)
        self._side, self._turn = float(side), float(rng.normal(0.0, _HEADING_DEVIATION))
        self._obstacles = start.object_positions[1:]
        self._heading_weight = planner.heading_weight
        self._object_weight = planner.object_weight if with_object else 0.0
        self._obstacle_weight = planner.obstacle_weight

    def squared_distances(self, vectors: FloatArray) -> FloatArray:
        # The displacement of the object to its sampled position.
        dx, dy = self._x - vectors[:, Column.DESIRED_X], self._y - vectors[:, Column.DESIRED_Y]
        direction = np.arctan2(dy, dx) + self._side
        behind_x = vectors[:, Column.DESIRED_X] - self._standoff * np.cos(direction)
        behind_y = vectors[:, Column.DESIRED_Y] - self._standoff * np.sin(direction)
        turn = self._heading_weight * wrap_angle(vectors[:, Column.GRIPPER_THETA] - direction - self._turn)
        squared = (
            (vectors[:, Column.GRIPPER_X] - behind_x) ** 2 + (vectors[:, Column.GRIPPER_Y] - behind_y) ** 2 + turn**2
        )
        squared += self._object_weight**2 * (dx**2 + dy**2)
        if len(self._obstacles):
            moved_x = vectors[:, Column.OBSTACLES_X] - self._obstacles[:, 0]
            moved_y = vectors[:, Column.OBSTACLES_Y] - self._obstacles[:, 1]
            squared += self._obstacle_weight**2 * (moved_x**2 + moved_y**2).sum(axis=1)
        return squared

    def gripper_pose(self, vector: FloatArray) -> tuple[float, float, float]:
        (x, y, theta), (object_x, object_y) = (
            vector[Column.GRIPPER_POSE].tolist(),
            vector[Column.DESIRED_POSITION].tolist(),
        )
        dx, dy = self._x - object_x, self._y - object_y
        direction = math.atan2(dy, dx) + self._side
        behind_x = object_x - self._standoff * math.cos(direction)
        behind_y = object_y - self._standoff * math.sin(direction)
        is_behind = (
            math.hypot(x - behind_x, y - behind_y) < _BEHIND_DISTANCE
            and abs(wrap_angle(theta - direction)) < _BEHIND_ANGLE
        )
        if self._object_weight and is_behind:
            behind_x, behind_y = behind_x + dx, behind_y + dy
        return behind_x, behind_y, direction + self._turn
