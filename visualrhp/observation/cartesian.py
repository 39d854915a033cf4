"""The engineered feature vector of the CartesianRHP baseline (paper, Sec. 7.5)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from visualrhp.observation.observation import Observation
from visualrhp.scene import geometry
from visualrhp.scene.scene import Scene
from visualrhp.types import State

_LENGTH_SCALE = 0.25
"""Lengths are divided by half the side of the paper's surface [m], so that features are of the order of 1."""


def cartesian_dimension(num_objects: int) -> int:
    """Number of features for ``num_objects`` objects."""
    return 4 * num_objects + 6


def cartesian_features(scene: Scene, state: State) -> npt.NDArray[np.float32]:
    """Poses of the objects and position of the target in the gripper frame, and the gripper's pose in the world frame.

    Angles are encoded as cosine and sine, which are continuous; lengths are divided by 0.25 m. The binary gripper state
    is a separate input of the network, as with images.

    Returns:
        [4 m + 6] float32: forward, left, cos, sin of every object (the desired first); forward, left of the target;
        x, y, cos, sin of the gripper.
    """
    x, y, theta = state.gripper_pose
    positions = np.concatenate([state.object_positions, scene.target.position[None]])
    relative = geometry.to_body(positions, state.gripper_pose) / _LENGTH_SCALE
    angles = state.object_angles - theta
    objects = np.column_stack([relative[:-1], np.cos(angles), np.sin(angles)])
    gripper = (x / _LENGTH_SCALE, y / _LENGTH_SCALE, np.cos(theta), np.sin(theta))
    return np.concatenate([objects.ravel(), relative[-1], gripper]).astype(np.float32)


def mirror_cartesian(features: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Features [..., 4 m + 6] of the scene mirrored about the world's x axis: y, left and all angles change sign."""
    num_objects = (features.shape[-1] - 6) // 4
    signs = np.array([1.0, -1.0, 1.0, -1.0] * num_objects + [1.0, -1.0] + [1.0, -1.0, 1.0, -1.0], dtype=np.float32)
    return features * signs


class CartesianObservation(Observation):
    """The Cartesian features of Sec. 7.5: [4 m + 6] float32, for one number of objects m."""

    name = "cartesian"
    fixes_num_objects = True
    dtype = np.float32
    # Bodies of a scene file lie within 283 m of each other, which is 1132 in units of the features, and 49 actions
    # move the gripper by 7 m, which is 28.
    low = -2000.0
    high = 2000.0

    @property
    def shape(self) -> tuple[int, ...]:
        return (cartesian_dimension(self.num_objects or 0),)

    def __call__(self, scene: Scene, state: State) -> npt.NDArray[np.float32]:
        return cartesian_features(scene, state)

    def mirror(self, observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return mirror_cartesian(observations)
