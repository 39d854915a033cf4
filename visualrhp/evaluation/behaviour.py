"""How a robot moves the desired object: from which side it pushes (Sec. 7.5)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from visualrhp.scene import Scene
from visualrhp.types import FloatArray, State, wrap_angle

MIN_PROGRESS: Final = 0.005
"""An action that brings the desired object at least this much nearer to the target region is a push [m]."""

FROM_BEHIND: Final = np.pi / 3
"""A push from behind: the angle of :func:`push_angles` is below this [rad]."""


def push_angles(scene: Scene, states: Sequence[State], min_progress: float = MIN_PROGRESS) -> FloatArray:
    r"""From where the pushes of an episode were made.

    A push is an action that brings the desired object at least ``min_progress`` nearer to the target region. With r, o
    and t the positions of robot, desired object and target region when it begins, its angle is
    :math:`|\angle(t - o, o - r)|`: 0 if the robot is straight behind the desired object as seen from the target region,
    :math:`\pi` if it is in between.

    Args:
        scene: of the episode.
        states: the states that it passed through, initial first, [L + 1].
        min_progress: [m].

    Returns:
        [P] the angle of every push [rad], in order.
    """
    poses = np.array([state.vector[:7] for state in states])  # [L + 1, 7]: robot x, y, theta, gripper, object x, y
    robot, desired = poses[:, :2], poses[:, 5:7]
    to_target, to_object = scene.target.position - desired, desired - robot
    distance = np.linalg.norm(to_target, axis=1)
    is_push = distance[:-1] - distance[1:] >= min_progress
    directions = [np.arctan2(vectors[:-1, 1], vectors[:-1, 0]) for vectors in (to_target, to_object)]
    return np.abs(wrap_angle(directions[0] - directions[1]))[is_push]
