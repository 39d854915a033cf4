"""The slots of a batched environment: N parallel tasks, and the arrays that hold their states.

:class:`SlotArrays` are one block of memory with one row per slot, so that a process can work on some rows of a block
that it shares with others (:mod:`visualrhp.environments.backends`). Worker processes import this module, so it imports
no torch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from visualrhp.execution.episode import RunningEpisode
from visualrhp.execution.world import SimulatedWorld
from visualrhp.observation import Observation
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.simulation.action_spaces import ContinuousActionSpace, make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.streams import Split
from visualrhp.types import ActionSpaceName, Column, FloatArray, IntArray, Outcome, State, state_dimension

BoolArray = npt.NDArray[np.bool_]

_ALIGNMENT = 64


@dataclass(frozen=True)
class TaskFamily:
    """Shared parameters of all tasks of a batched environment; sent to worker processes.

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
    observe: Observation
    physics: Physics = field(default_factory=Physics)

    @property
    def state_dimension(self) -> int:
        """5 + 3 max m, length of the longest state vector."""
        return state_dimension(self.distribution.num_objects[1])

    def instance(self, seed: int, index: int) -> TaskInstance:
        """Task instance ``index`` of ``seed``."""
        return sample_task_instance(self.distribution, seed, self.split, index)

    def model(self, scene: Scene) -> TransitionModel:
        """The decision process of ``scene``."""
        return TransitionModel(scene, make_action_space(self.action_space), self.physics)

    def start(self, instance: TaskInstance, num_actions: int = 0) -> RunningEpisode:
        """An episode of ``instance`` in which ``num_actions`` actions have been taken."""
        return RunningEpisode(SimulatedWorld(instance, self.model(instance.scene)), num_actions)


@dataclass(frozen=True, eq=False)
class SlotArrays:
    """The state of N tasks: arrays over one block of memory, one row per slot.

    Attributes:
        action: [N] int64 or [N, 4] float64, the next actions.
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
        entries = {entry.name: special.get(entry.name, ((), np.bool_)) for entry in fields(SlotArrays)}
        return {name: ((num_slots, *shape), np.dtype(dtype)) for name, (shape, dtype) in entries.items()}

    @classmethod
    def num_bytes(cls, family: TaskFamily, num_slots: int) -> int:
        """Size of the block of memory."""
        return sum(
            _aligned(math.prod(shape) * dtype.itemsize) for shape, dtype in cls._layout(family, num_slots).values()
        )

    @classmethod
    def over(cls, family: TaskFamily, num_slots: int, memory: Any) -> SlotArrays:
        """The arrays in ``memory``, a writable buffer of :meth:`num_bytes` (zeros at the start)."""
        arrays: dict[str, Any] = {}
        offset = 0
        for name, (shape, dtype) in cls._layout(family, num_slots).items():
            arrays[name] = np.frombuffer(memory, dtype, math.prod(shape), offset).reshape(shape)
            offset += _aligned(arrays[name].nbytes)
        return cls(**arrays)

    def state_of(self, slot: int) -> State:
        """The state of one slot, of the length that its scene has."""
        return State(self.state[slot, : state_dimension(int(self.num_objects[slot]))])


def _aligned(num_bytes: int) -> int:
    return -(-num_bytes // _ALIGNMENT) * _ALIGNMENT


class Slots:
    """Simulates the tasks in some rows of the arrays.

    Args:
        family: shared parameters of the tasks.
        arrays: written to in the rows ``rows`` only.
        rows: the slots of these tasks.

    Attributes:
        rows: as given.
        episodes: one per row, from the first :meth:`start` on.
    """

    def __init__(self, family: TaskFamily, arrays: SlotArrays, rows: range) -> None:
        self.rows = rows
        self.episodes: list[RunningEpisode] = []
        self._family = family
        self._arrays = arrays
        self._columns = np.arange(family.state_dimension)

    def start(self, seed: int, slots: Sequence[int], instances: Sequence[int]) -> None:
        """Begin task instance ``instances[i]`` of ``seed`` in slot ``slots[i]``; the first call begins all slots."""
        if not slots:
            return
        started = [self._family.start(self._family.instance(seed, instance)) for instance in instances]
        self._enter(slots, instances, started)

    def resume(
        self, seeds: int | Sequence[int], instances: Sequence[int], num_actions: Sequence[int], states: FloatArray
    ) -> None:
        """Resume, in every row, task instances that have reached ``states`` [N, 5 + 3 max m].

        The sequences have one entry for every slot of the arrays, not of these rows alone; one seed stands for all.
        """
        resumed = []
        for slot in self.rows:
            instance = self._family.instance(seeds if isinstance(seeds, int) else seeds[slot], instances[slot])
            state = State(states[slot, : instance.state.vector.size])
            resumed.append(self._family.start(TaskInstance(instance.scene, state), num_actions[slot]))
        self._enter(self.rows, [instances[slot] for slot in self.rows], resumed)

    def scenes(self, slots: Sequence[int]) -> list[Scene]:
        """The scenes of the running episodes in ``slots``."""
        return [self.episodes[slot - self.rows.start].scene for slot in slots]

    def _enter(self, slots: Sequence[int], instances: Sequence[int], episodes: Sequence[RunningEpisode]) -> None:
        arrays = self._arrays
        if not self.episodes:
            self.episodes = list(episodes)
        for slot, instance, episode in zip(slots, instances, episodes, strict=True):
            self.episodes[slot - self.rows.start] = episode
            arrays.instance[slot] = instance
            arrays.num_objects[slot] = episode.scene.num_objects
            arrays.num_actions[slot] = episode.num_actions
            arrays.reward[slot] = 0.0
            for flag in (arrays.terminated, arrays.truncated, arrays.is_goal, arrays.is_dropped):
                flag[slot] = False
        self._show(list(slots), episodes)

    def act(self) -> None:
        """Take the actions in the arrays, in the slots that are active."""
        arrays, episodes = self._arrays, self.episodes
        rows: slice | list[int] = slice(self.rows.start, self.rows.stop)
        if not arrays.is_active[rows].all():
            rows = [slot for slot in self.rows if arrays.is_active[slot]]
            episodes = [self.episodes[slot - self.rows.start] for slot in rows]
        if not episodes:
            return
        actions = arrays.action[rows].copy()  # an episode keeps its actions
        for episode, action in zip(episodes, actions.tolist() if actions.ndim == 1 else actions, strict=True):
            episode.act(action)
        self._show(rows, episodes)
        outcomes = [episode.outcome for episode in episodes]
        arrays.num_actions[rows] = [episode.num_actions for episode in episodes]
        arrays.reward[rows] = [episode.reward for episode in episodes]
        arrays.terminated[rows] = [outcome is not None and outcome.is_terminal for outcome in outcomes]
        arrays.truncated[rows] = [outcome is not None and not outcome.is_terminal for outcome in outcomes]
        arrays.is_goal[rows] = [outcome is Outcome.SUCCESS for outcome in outcomes]
        arrays.is_dropped[rows] = [outcome is Outcome.DROPPED for outcome in outcomes]

    def _show(self, rows: slice | list[int], episodes: Sequence[RunningEpisode]) -> None:
        """Write the observations and states of ``rows``."""
        arrays, observe = self._arrays, self._family.observe
        states = [episode.state for episode in episodes]
        slots = self.rows if isinstance(rows, slice) else rows
        for slot, episode, state in zip(slots, episodes, states, strict=True):
            arrays.observation[slot] = observe(episode.scene, state)
        padded = np.zeros((len(episodes), self._columns.size))
        is_used = self._columns < state_dimension(arrays.num_objects[rows, None])
        padded[is_used] = np.concatenate([state.vector for state in states])
        arrays.state[rows] = padded
        arrays.gripper_closed[rows] = padded[:, Column.CLOSED]
