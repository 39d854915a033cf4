"""Frozen values that every layer speaks: states, actions, transitions, episodes.

Legend, used in every docstring and shape comment of the package:

====== ==========================================================================
symbol meaning
====== ==========================================================================
``m``  objects in a scene, the desired object first (paper, Sec. 4)
``B``  batch (states that are evaluated together)
``n``  roll-outs of receding horizon planning (Sec. 5.2)
``h``  horizon depth of a roll-out (Sec. 5.2)
``L``  actions of a demonstration or an episode (Sec. 6.1)
``V``  vertices of a polygon, counter-clockwise
====== ==========================================================================

SI units: metres, radians, kilograms, seconds. World frame: x right, y up, angles counter-clockwise from x. The gripper
frame has its origin between the fingertips, x forward (longitudinal), y to the left (lateral).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, overload

import numpy as np
import numpy.typing as npt

from visualrhp.errors import SceneError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
LabelImage = npt.NDArray[np.uint8]

Action = int | FloatArray
"""One action: an index in [0, 8) (discrete) or an array [4] nominally in [-1, 1] (continuous)."""

ActionSpaceName = Literal["discrete", "continuous"]
ObjectSize = Literal["small", "mixed", "large"]

_ROBOT_DIMENSIONS = 5


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: FloatArray) -> FloatArray: ...
def wrap_angle(angle: float | FloatArray) -> float | FloatArray:
    """Wrap ``angle`` [rad] into [-pi, pi); one that is there already stays to the bit."""
    return angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What changes during a task: the pose of the gripper, its opening and the poses of the objects (Sec. 4).

    A state is at rest (quasi-static assumption, Sec. 4), so it holds no velocities. It is one read-only vector, so that
    states are copied, compared to the bit and stored without ceremony.

    Attributes:
        vector: [5 + 3 m] float64, read-only: gripper x [m], y [m], theta [rad], opening between the fingers [m],
            commanded gripper state (1 closed, 0 open), then x [m], y [m], theta [rad] of every object.
    """

    vector: FloatArray

    def __post_init__(self) -> None:
        vector = np.array(self.vector, dtype=np.float64)
        if vector.ndim != 1 or vector.size < _ROBOT_DIMENSIONS + 3 or (vector.size - _ROBOT_DIMENSIONS) % 3:
            raise SceneError(f"a state vector has the shape [5 + 3 m] with m >= 1, not {list(vector.shape)}")
        vector.setflags(write=False)
        object.__setattr__(self, "vector", vector)

    @classmethod
    def create(
        cls, robot_pose: npt.ArrayLike, gripper_opening: float, gripper_closed: bool, object_poses: npt.ArrayLike
    ) -> State:
        """Assemble a state from its parts (shapes and units as in the properties).

        Raises:
            SceneError: a number is not finite, or the shapes do not fit.
        """
        gripper = [gripper_opening, float(gripper_closed)]
        vector = np.concatenate([np.ravel(robot_pose), gripper, np.ravel(object_poses)]).astype(np.float64)
        if not np.isfinite(vector).all():
            raise SceneError(f"a state holds finite numbers only, not {vector.tolist()}")
        return cls(vector)

    @property
    def robot_pose(self) -> FloatArray:
        """[3] x [m], y [m], theta [rad] of the gripper frame in the world frame."""
        return self.vector[:3]

    @property
    def gripper_opening(self) -> float:
        """Distance between the inner faces of the fingers [m]."""
        return float(self.vector[3])

    @property
    def gripper_closed(self) -> bool:
        """Whether the gripper was last commanded to close (the paper's binary gripper state, Sec. 7.2)."""
        return bool(self.vector[4])

    @property
    def object_poses(self) -> FloatArray:
        """[m, 3] x [m], y [m], theta [rad] of the objects, the desired object first."""
        return self.vector[_ROBOT_DIMENSIONS:].reshape(-1, 3)

    @property
    def num_objects(self) -> int:
        """Number of objects m."""
        return (self.vector.size - _ROBOT_DIMENSIONS) // 3

    def __eq__(self, other: object) -> bool:
        return isinstance(other, State) and self.vector.tobytes() == other.vector.tobytes()

    def __hash__(self) -> int:
        return hash(self.vector.tobytes())


@dataclass(frozen=True, slots=True)
class Transition:
    """One step of the decision process: (s, a, r, s') and why it may have ended there (Sec. 4).

    Attributes:
        reward: -1 per action, -50 when an object was dropped (Sec. 7).
        is_goal: the desired object is in the target region and nothing was dropped.
        is_dropped: an object's centre left the surface edges; the state is invalid.
    """

    state: State
    action: Action
    reward: float
    next_state: State
    is_goal: bool
    is_dropped: bool

    @property
    def is_terminal(self) -> bool:
        """Whether the episode ends in ``next_state`` (truncation by the action limit is not terminal)."""
        return self.is_goal or self.is_dropped


@dataclass(frozen=True, slots=True)
class Episode:
    """A sequence of transitions from an initial state.

    Attributes:
        states: L + 1 states.
        actions: L actions.
        rewards: L rewards.
        is_goal: whether the last state is a goal state reached within the action limit.
        is_dropped: whether the last action dropped an object.
    """

    states: tuple[State, ...]
    actions: tuple[Action, ...]
    rewards: tuple[float, ...]
    is_goal: bool
    is_dropped: bool

    @classmethod
    def from_transitions(cls, transitions: Sequence[Transition]) -> Episode:
        """Join consecutive transitions (at least one)."""
        last = transitions[-1]
        return cls(
            states=(*(transition.state for transition in transitions), last.next_state),
            actions=tuple(transition.action for transition in transitions),
            rewards=tuple(transition.reward for transition in transitions),
            is_goal=last.is_goal,
            is_dropped=last.is_dropped,
        )

    def __len__(self) -> int:
        return len(self.actions)
