"""How the gripper moves the desired object: from which side it pushes (Sec. 7.5)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from visualrhp.scene import Scene
from visualrhp.types import Column, FloatArray, State, wrap_angle

MIN_PROGRESS: Final = 0.005
"""An action that brings the desired object at least this much nearer to the target region is a push [m]."""

FROM_BEHIND: Final = np.pi / 3
"""A push from behind: the angle of :func:`push_angles` is below this [rad]."""


def push_angles(scene: Scene, states: Sequence[State], min_progress: float = MIN_PROGRESS) -> FloatArray:
    r"""Angles of the pushes of an episode.

    A push is an action that brings the desired object at least ``min_progress`` nearer to the target region. With r, o
    and t the positions of gripper, desired object and target region when it begins, its angle is
    :math:`|\angle(t - o, o - r)|`: 0 if the gripper is straight behind the desired object as seen from the target
    region, :math:`\pi` if it is between them.

    Args:
        scene: of the episode.
        states: L + 1 states, the initial one first.
        min_progress: [m].

    Returns:
        [P] angle of each push [rad], in order.
    """
    vectors = np.array([state.vector for state in states])  # [L + 1, 5 + 3 m]
    gripper, desired = vectors[:, Column.GRIPPER_POSITION], vectors[:, Column.DESIRED_POSITION]
    to_target, to_object = scene.target.position - desired, desired - gripper
    distance = np.linalg.norm(to_target, axis=1)
    is_push = distance[:-1] - distance[1:] >= min_progress
    directions = [np.arctan2(offset[:-1, 1], offset[:-1, 0]) for offset in (to_target, to_object)]
    return np.abs(wrap_angle(directions[0] - directions[1]))[is_push]
