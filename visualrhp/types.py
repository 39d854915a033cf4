"""Immutable values shared by all layers: states, actions, transitions, episodes.

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
from enum import StrEnum
from typing import Final, Literal, overload

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

Metrics = dict[str, float]
"""Metrics that a training or an evaluation reports, by name; names are paths, such as ``greedy/success_rate``."""


class Column:
    """Columns of a state vector [5 + 3 m] (see :class:`State`), as indices and slices of its last axis.

    Attributes:
        GRIPPER_X, GRIPPER_Y: position of the gripper frame [m].
        GRIPPER_THETA: heading of the gripper [rad].
        OPENING: distance between the fingers [m].
        CLOSED: commanded gripper state, 1 closed, 0 open.
        GRIPPER_POSE: x, y, theta of the gripper, [3].
        GRIPPER_POSITION: x, y of the gripper, [2].
        DESIRED_X, DESIRED_Y: position of the desired object [m].
        DESIRED_POSITION: both, [2].
        OBJECTS: x, y, theta of every object, [3 m].
        OBJECTS_X, OBJECTS_Y, OBJECTS_THETA: one coordinate of every object, [m].
        OBSTACLES_X, OBSTACLES_Y: one coordinate of every object except the desired one, [m - 1].
    """

    GRIPPER_X: Final = 0
    GRIPPER_Y: Final = 1
    GRIPPER_THETA: Final = 2
    OPENING: Final = 3
    CLOSED: Final = 4
    DESIRED_X: Final = 5
    DESIRED_Y: Final = 6
    GRIPPER_POSE: Final = slice(0, 3)
    GRIPPER_POSITION: Final = slice(0, 2)
    DESIRED_POSITION: Final = slice(5, 7)
    OBJECTS: Final = slice(5, None)
    OBJECTS_X: Final = slice(5, None, 3)
    OBJECTS_Y: Final = slice(6, None, 3)
    OBJECTS_THETA: Final = slice(7, None, 3)
    OBSTACLES_X: Final = slice(8, None, 3)
    OBSTACLES_Y: Final = slice(9, None, 3)


_GRIPPER_COLUMNS: Final = 5
_OBJECT_COLUMNS: Final = 3


@overload
def state_dimension(num_objects: int) -> int: ...
@overload
def state_dimension(num_objects: IntArray) -> IntArray: ...
def state_dimension(num_objects: int | IntArray) -> int | IntArray:
    """Length 5 + 3 m of the state vector of m objects."""
    return _GRIPPER_COLUMNS + _OBJECT_COLUMNS * num_objects


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: FloatArray) -> FloatArray: ...
def wrap_angle(angle: float | FloatArray) -> float | FloatArray:
    """Wrap ``angle`` [rad] into [-pi, pi); an angle in that range is unchanged."""
    return angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))


def _numbers(values: npt.ArrayLike, what: str) -> FloatArray:
    """The array of ``values``; a SceneError if they are not real numbers, which NumPy would partly convert."""
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{what} holds real numbers, not a {type(values).__name__} of unequal rows") from error
    if array.dtype.kind not in "fiu":
        raise SceneError(f"{what} holds real numbers, not entries of type {array.dtype}")
    return array.astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """The variable part of a task: pose and opening of the gripper, and poses of the objects (Sec. 4).

    A state is at rest (quasi-static assumption, Sec. 4), so it holds no velocities. It is one read-only vector, so that
    states are easy to copy, to compare bit for bit and to store.

    Attributes:
        vector: [5 + 3 m] float64, read-only (in unpickled and copied states, too): gripper x [m], y [m], theta [rad],
            opening between the fingers [m], commanded gripper state (1 closed, 0 open), then x [m], y [m], theta [rad]
            of every object.

    Raises:
        SceneError: the vector has another shape, or entries that are not real numbers.
    """

    vector: FloatArray

    def __post_init__(self) -> None:
        given = self.vector
        is_plain = isinstance(given, np.ndarray) and given.dtype == np.float64
        vector = np.array(given if is_plain else _numbers(given, "a state vector"))
        if vector.ndim != 1 or vector.size < state_dimension(1) or (vector.size - _GRIPPER_COLUMNS) % _OBJECT_COLUMNS:
            raise SceneError(f"a state vector has the shape [5 + 3 m] with m >= 1, not {list(vector.shape)}")
        vector.setflags(write=False)
        object.__setattr__(self, "vector", vector)

    def __reduce__(self) -> tuple[type[State], tuple[FloatArray]]:
        """Unpickled and copied states are made by the constructor, because NumPy restores arrays writable."""
        return type(self), (self.vector,)

    @classmethod
    def create(
        cls, gripper_pose: npt.ArrayLike, gripper_opening: float, gripper_closed: bool, object_poses: npt.ArrayLike
    ) -> State:
        """Assemble a state from its parts (shapes and units as in the properties).

        Raises:
            SceneError: a part is no number or not finite, or the shapes do not match.
        """
        pose, poses = _numbers(gripper_pose, "a gripper pose"), _numbers(object_poses, "object poses")
        opening = _numbers(gripper_opening, "a gripper opening")
        if not isinstance(gripper_closed, (bool, int, float, np.bool_, np.number)):
            raise SceneError(f"the commanded gripper state is true or false, not a {type(gripper_closed).__name__}")
        vector = np.concatenate([pose.ravel(), opening.ravel(), [float(gripper_closed)], poses.ravel()])
        if not np.isfinite(vector).all():
            entry = int(np.argmin(np.isfinite(vector)))
            raise SceneError(f"a state holds finite numbers only; entry {entry} of its vector is {vector[entry]}")
        return cls(vector)

    @property
    def gripper_pose(self) -> FloatArray:
        """[3] x [m], y [m], theta [rad] of the gripper frame in the world frame."""
        return self.vector[Column.GRIPPER_POSE]

    @property
    def gripper_position(self) -> FloatArray:
        """[2] x [m], y [m] of the gripper frame in the world frame."""
        return self.vector[Column.GRIPPER_POSITION]

    @property
    def gripper_opening(self) -> float:
        """Distance between the inner faces of the fingers [m]."""
        return float(self.vector[Column.OPENING])

    @property
    def gripper_closed(self) -> bool:
        """Whether the gripper was last commanded to close (the paper's binary gripper state, Sec. 7.2)."""
        return bool(self.vector[Column.CLOSED])

    @property
    def object_poses(self) -> FloatArray:
        """[m, 3] x [m], y [m], theta [rad] of the objects, the desired object first."""
        return self.vector[Column.OBJECTS].reshape(-1, _OBJECT_COLUMNS)

    @property
    def object_positions(self) -> FloatArray:
        """[m, 2] x [m], y [m] of the objects, the desired object first."""
        return self.object_poses[:, :2]

    @property
    def object_angles(self) -> FloatArray:
        """[m] theta [rad] of the objects, the desired object first."""
        return self.vector[Column.OBJECTS_THETA]

    @property
    def desired_position(self) -> FloatArray:
        """[2] x [m], y [m] of the desired object."""
        return self.vector[Column.DESIRED_POSITION]

    @property
    def num_objects(self) -> int:
        """Number of objects m."""
        return (self.vector.size - _GRIPPER_COLUMNS) // _OBJECT_COLUMNS

    def __eq__(self, other: object) -> bool:
        return isinstance(other, State) and self.vector.tobytes() == other.vector.tobytes()

    def __hash__(self) -> int:
        return hash(self.vector.tobytes())


@dataclass(frozen=True, slots=True)
class Transition:
    """One step of the decision process: (s, a, r, s'), and whether s' is terminal (Sec. 4).

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


class Outcome(StrEnum):
    """How an episode ended (Sec. 7.3). An episode in progress has none."""

    SUCCESS = "success"
    """The desired object reached the target region in under 50 actions and nothing was dropped."""
    DROPPED = "dropped"
    """An object's centre left the surface edges."""
    OUT_OF_ACTIONS = "out of actions"
    """49 actions without success."""
    NO_PLAN = "no plan"
    """The planner gave up before its first action."""
    PLAN_FAILED = "plan failed"
    """The planner gave up after its first action: an open-loop plan ended without success."""
    DIVERGED = "diverged"
    """The physics of the world failed."""
    UNREACHABLE = "unreachable"
    """The planner chose a motion that the arm of a robot cell cannot make; nothing has moved."""
    STOPPED = "stopped"
    """A fault of a robot cell, or an image that cannot be interpreted, brought the robot to rest."""

    @classmethod
    def of_state(cls, is_goal: bool, is_dropped: bool) -> Outcome | None:
        """The outcome in a terminal state, where a drop takes precedence over the goal; None in any other state."""
        return cls.DROPPED if is_dropped else cls.SUCCESS if is_goal else None

    @property
    def is_terminal(self) -> bool:
        """Whether the last state is terminal (Sec. 4), with no return after it; otherwise the episode was truncated."""
        return self in (Outcome.SUCCESS, Outcome.DROPPED)

    @property
    def is_failed_action(self) -> bool:
        """Whether the last action failed, so that no state was observed after it."""
        return self in (Outcome.DIVERGED, Outcome.UNREACHABLE, Outcome.STOPPED)


@dataclass(frozen=True, slots=True)
class Episode:
    """A sequence of transitions from an initial state: an executed episode, a plan, a demonstration.

    Attributes:
        states: L + 1 states.
        actions: L actions.
        rewards: L rewards.
        outcome: how it ended in the last state; None if it has not ended.
    """

    states: tuple[State, ...]
    actions: tuple[Action, ...]
    rewards: tuple[float, ...]
    outcome: Outcome | None

    @classmethod
    def from_transitions(cls, transitions: Sequence[Transition]) -> Episode:
        """Join consecutive transitions (at least one)."""
        last = transitions[-1]
        return cls(
            states=(*(transition.state for transition in transitions), last.next_state),
            actions=tuple(transition.action for transition in transitions),
            rewards=tuple(transition.reward for transition in transitions),
            outcome=Outcome.of_state(last.is_goal, last.is_dropped),
        )

    @property
    def is_goal(self) -> bool:
        """Whether the last state is a goal state, reached within the action limit."""
        return self.outcome is Outcome.SUCCESS

    @property
    def is_dropped(self) -> bool:
        """Whether the last action dropped an object."""
        return self.outcome is Outcome.DROPPED

    def __len__(self) -> int:
        return len(self.actions)
