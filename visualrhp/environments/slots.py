"""Tasks side by side, and the arrays in which they show where they stand: what a batched environment is made of.

A :class:`Board` is one block of memory with one row a slot, so that a process can work on some of the rows of a block
that it shares with others (:mod:`visualrhp.environments.crew`). This module does without torch: it is what a worker
process imports.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from visualrhp.environments.task import ClutterTask, ObservationFunction
from visualrhp.scene.sampling import SceneDistribution, Split
from visualrhp.simulation.action_spaces import ContinuousActionSpace, make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.types import ActionSpaceName, FloatArray, IntArray, State

BoolArray = npt.NDArray[np.bool_]

_ROBOT_DIMENSIONS = 5
_ALIGNMENT = 64


@dataclass(frozen=True)
class TaskFamily:
    """What all tasks of a batched environment have in common; sent to worker processes.

    Attributes:
        distribution: of the task instances.
        split: stream of the task instances.
        action_space: ``discrete`` or ``continuous``.
        observe: scene and state -> observation.
        physics: of the simulation.
    """

    distribution: SceneDistribution
    split: Split
    action_space: ActionSpaceName
    observe: ObservationFunction
    physics: Physics = field(default_factory=Physics)

    @property
    def state_dimension(self) -> int:
        """5 + 3 max m, length of the longest state vector."""
        return _ROBOT_DIMENSIONS + 3 * self.distribution.num_objects[1]

    def make_task(self) -> ClutterTask:
        """A task of the family, not started."""
        return ClutterTask(self.distribution, make_action_space(self.action_space), self.physics)


@dataclass(frozen=True, eq=False)
class Board:
    """Where N tasks stand: arrays over one block of memory, one row a slot.

    Attributes:
        action: [N] int64 or [N, 4] float64, to be taken next.
        is_active: [N] bool, whether the slot takes part in the next step.
        observation: [N, 64, 64] uint8 or [N, 4 m + 6] float32.
        gripper_closed: [N] bool, the gripper was last commanded to close.
        state: [N, 5 + 3 max m] float64, ``State.vector``, zero beyond the scene's own objects.
        num_objects: [N] int64, objects m of the slot's scene.
        instance: [N] int64, index of the task instance.
        num_actions: [N] int64, actions taken in the episode.
        reward: [N] float32, of the last step, as are the four flags [N] bool that follow.
    """

    action: IntArray | FloatArray
    is_active: BoolArray
    observation: npt.NDArray[Any]
    gripper_closed: BoolArray
    state: FloatArray
    num_objects: IntArray
    instance: IntArray
    num_actions: IntArray
    reward: npt.NDArray[np.float32]
    terminated: BoolArray
    truncated: BoolArray
    is_goal: BoolArray
    is_dropped: BoolArray

    @staticmethod
    def _layout(family: TaskFamily, num_slots: int) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
        action = (ContinuousActionSpace.DIMENSION,) if family.action_space == "continuous" else ()
        special: dict[str, tuple[tuple[int, ...], type]] = {
            "action": (action, np.float64 if action else np.int64),
            "observation": (family.observe.shape, family.observe.dtype),
            "state": ((family.state_dimension,), np.float64),
            "num_objects": ((), np.int64),
            "instance": ((), np.int64),
            "num_actions": ((), np.int64),
            "reward": ((), np.float32),
        }
        entries = {entry.name: special.get(entry.name, ((), np.bool_)) for entry in fields(Board)}
        return {name: ((num_slots, *shape), np.dtype(dtype)) for name, (shape, dtype) in entries.items()}

    @classmethod
    def num_bytes(cls, family: TaskFamily, num_slots: int) -> int:
        """Size of the block of memory."""
        return sum(
            _aligned(math.prod(shape) * dtype.itemsize) for shape, dtype in cls._layout(family, num_slots).values()
        )

    @classmethod
    def over(cls, family: TaskFamily, num_slots: int, memory: Any) -> Board:
        """The board in ``memory``, a writable buffer of :meth:`num_bytes` (zeros at the start)."""
        arrays: dict[str, Any] = {}
        offset = 0
        for name, (shape, dtype) in cls._layout(family, num_slots).items():
            arrays[name] = np.frombuffer(memory, dtype, math.prod(shape), offset).reshape(shape)
            offset += _aligned(arrays[name].nbytes)
        return cls(**arrays)

    def state_of(self, slot: int) -> State:
        """The state of one slot, of the length that its scene has."""
        return State(self.state[slot, : _ROBOT_DIMENSIONS + 3 * self.num_objects[slot]])


def _aligned(num_bytes: int) -> int:
    return -(-num_bytes // _ALIGNMENT) * _ALIGNMENT


class Slots:
    """Simulates the tasks in some rows of a board.

    Args:
        family: what the tasks have in common.
        board: written to in the rows ``rows`` only.
        rows: the slots of these tasks.

    Attributes:
        rows: as given.
        tasks: one a row.
    """

    def __init__(self, family: TaskFamily, board: Board, rows: range) -> None:
        self.rows = rows
        self.tasks = [family.make_task() for _ in rows]
        self._family = family
        self._board = board
        self._columns = np.arange(family.state_dimension)

    def start(self, seed: int, slots: Sequence[int], instances: Sequence[int]) -> None:
        """Begin task instance ``instances[i]`` of ``seed`` in slot ``slots[i]``."""
        if not slots:
            return
        board = self._board
        for slot, instance in zip(slots, instances, strict=True):
            task = self._task(slot)
            task.start(seed, self._family.split, instance)
            board.instance[slot] = instance
            board.num_objects[slot] = task.instance.scene.num_objects
            board.num_actions[slot] = 0
            board.reward[slot] = 0.0
            for flag in (board.terminated, board.truncated, board.is_goal, board.is_dropped):
                flag[slot] = False
        self._show(list(slots), [self._task(slot) for slot in slots])

    def resume(self, seed: int, instances: Sequence[int], num_actions: Sequence[int], states: FloatArray) -> None:
        """Go on, in every row, with task instances that had come as far as ``states`` [N, 5 + 3 max m].

        The sequences have one entry for every slot of the board, not of this part of it alone.
        """
        self.start(seed, self.rows, [instances[slot] for slot in self.rows])
        for slot, task in zip(self.rows, self.tasks, strict=True):
            task.resume(num_actions[slot], State(states[slot, : task.state.vector.size]))
            self._board.num_actions[slot] = num_actions[slot]
        self._show(list(self.rows), self.tasks)

    def act(self) -> None:
        """Take the actions on the board in the slots that are active."""
        board, tasks = self._board, self.tasks
        rows: slice | list[int] = slice(self.rows.start, self.rows.stop)
        if not board.is_active[rows].all():
            rows = [slot for slot in self.rows if board.is_active[slot]]
            tasks = [self._task(slot) for slot in rows]
        if not tasks:
            return
        actions = board.action[rows].copy()  # a transition keeps its action
        outcomes = [
            task.act(action)
            for task, action in zip(tasks, actions.tolist() if actions.ndim == 1 else actions, strict=True)
        ]
        self._show(rows, tasks)
        rewards, terminated, truncated, is_goal, is_dropped = zip(*outcomes, strict=True)
        board.num_actions[rows] += 1
        board.reward[rows] = rewards
        board.terminated[rows] = terminated
        board.truncated[rows] = truncated
        board.is_goal[rows] = is_goal
        board.is_dropped[rows] = is_dropped

    def _task(self, slot: int) -> ClutterTask:
        return self.tasks[slot - self.rows.start]

    def _show(self, rows: slice | list[int], tasks: Sequence[ClutterTask]) -> None:
        """Write what the agents of ``rows`` see."""
        board, observe = self._board, self._family.observe
        states = [task.state for task in tasks]
        slots = self.rows if isinstance(rows, slice) else rows
        for slot, task, state in zip(slots, tasks, states, strict=True):
            board.observation[slot] = observe(task.instance.scene, state)
        padded = np.zeros((len(tasks), self._columns.size))
        is_used = self._columns < _ROBOT_DIMENSIONS + 3 * board.num_objects[rows, None]
        padded[is_used] = np.concatenate([state.vector for state in states])
        board.state[rows] = padded
        board.gripper_closed[rows] = padded[:, 4]
