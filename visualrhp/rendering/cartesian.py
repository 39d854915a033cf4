"""The engineered feature vector of the CartesianRHP baseline (paper, Sec. 7.5)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

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

    Angles enter as cosine and sine, which have no jump; lengths are divided by 0.25 m. The binary gripper state goes to
    the network beside the features, as it does with an image.

    Returns:
        [4 m + 6] float32: forward, left, cos, sin of every object (the desired first); forward, left of the target;
        x, y, cos, sin of the gripper.
    """
    x, y, theta = state.robot_pose
    positions = np.concatenate([state.object_poses[:, :2], scene.target.position[None]])
    relative = geometry.to_body(positions, state.robot_pose) / _LENGTH_SCALE
    angles = state.object_poses[:, 2] - theta
    objects = np.column_stack([relative[:-1], np.cos(angles), np.sin(angles)])
    robot = (x / _LENGTH_SCALE, y / _LENGTH_SCALE, np.cos(theta), np.sin(theta))
    return np.concatenate([objects.ravel(), relative[-1], robot]).astype(np.float32)


def mirror_cartesian(features: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Features [..., 4 m + 6] of the scene mirrored in the world's x axis: y, left and all angles change sign."""
    num_objects = (features.shape[-1] - 6) // 4
    signs = np.array([1.0, -1.0, 1.0, -1.0] * num_objects + [1.0, -1.0] + [1.0, -1.0, 1.0, -1.0], dtype=np.float32)
    return features * signs
