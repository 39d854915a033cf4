"""N tasks in parallel, as one torchrl environment."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from visualrhp.environments import specs
from visualrhp.environments.actions import batch_of_actions
from visualrhp.environments.arguments import checked_integer, checked_name, checked_seed, checked_split, shown
from visualrhp.environments.backends import Backend, make_backend
from visualrhp.environments.slots import TaskFamily
from visualrhp.environments.snapshots import checked_states, read_snapshot, take_snapshot
from visualrhp.errors import ActionError, CheckpointError, ConfigError, SceneError
from visualrhp.observation import observation_for
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.streams import Split
from visualrhp.types import ActionSpaceName, State

MAX_ENVS = 100_000
"""Largest number of parallel tasks of one environment."""

_SHOWN = ("observation", "gripper_closed", "state", "instance", "is_goal", "is_dropped")


class BatchedClutterEnv(EnvBase):
    """N task instances advanced together inside one ``EnvBase`` of batch size [N].

    One environment holds all tasks because the step of a torchrl environment costs as much as simulating an action.
    Slot i solves task instances i, i + N, i + 2 N, ... of (distribution, seed, split), so the tasks do not depend on
    the order in which episodes end. Planners use the scenes, states and models
    (:attr:`scenes`, :attr:`states`, :attr:`models`).

    Entries of the tensordicts (N slots):

    ================== ============================= ==============================================================
    key                shape, type                   meaning
    ================== ============================= ==============================================================
    ``observation``    [N, 64, 64] uint8 or          label image (Sec. 5.1) or Cartesian features (Sec. 7.5)
                       [N, 4 m + 6] float32
    ``gripper_closed`` [N] bool                      the gripper was last commanded to close
    ``state``          [N, 5 + 3 max m] float64      ``State.vector``, zero beyond the scene's own objects
    ``instance``       [N] int64                     index of the task instance
    ``action``         [N] int64 or [N, 4] float32   see :mod:`visualrhp.simulation.action_spaces`; continuous actions
                                                     outside [-1, 1] are clipped for execution
    ``reward``         [N, 1] float32                -1, or -50 for a drop
    ``terminated``     [N, 1] bool                   goal or drop
    ``truncated``      [N, 1] bool                   action limit, or the physics diverged
    ``is_goal``        [N] bool                      the action reached the goal (false after a reset)
    ``is_dropped``     [N] bool                      the action dropped an object (false after a reset)
    ================== ============================= ==============================================================

    ``reset(seed=s)`` is ``set_seed(s)`` followed by a reset. The tensors are on the device of the environment
    (:meth:`to`), the simulation is on the CPU. A step is taken in all slots or refused in all: a refused action changes
    nothing and does not count. A step after the end of a slot's episode is warned of; torchrl's roll-outs and
    collectors reset such slots, or leave them out (``_step``).

    Args:
        distribution: of the task instances.
        action_space: ``discrete`` or ``continuous``.
        observation: ``image`` or ``cartesian`` (which needs a fixed number of objects).
        num_envs: N, 1 to :data:`MAX_ENVS`.
        seed: of the task instances.
        split: stream of the task instances.
        physics: of the simulation.
        num_workers: worker processes in addition to this one; every process, this one included, simulates and draws
            an equal share of the slots. None: one process per core, this one included, with at least 2 slots each; no
            workers in a child process of multiprocessing or joblib. Results do not depend on it. Workers start with the
            first reset and end with :meth:`close`, the environment or this process.

    Attributes:
        observe: scene and state -> observation.
        action_space: the action space.
        backend: steps the slots; None before the first ``reset`` and after :meth:`close`.

    Raises:
        ConfigError: an argument is unknown or out of range.
    """

    def __init__(
        self,
        distribution: SceneDistribution,
        action_space: ActionSpaceName,
        observation: str = "image",
        num_envs: int = 10,
        seed: int = 0,
        split: Split = Split.REINFORCEMENT,
        physics: Physics | None = None,
        num_workers: int | None = None,
    ) -> None:
        num_envs = checked_integer("num_envs", "the number of parallel tasks", num_envs, 1, MAX_ENVS)
        if num_workers is not None:
            num_workers = checked_integer("num_workers", "the number of worker processes or None", num_workers, 0)
        if not isinstance(distribution, SceneDistribution):
            raise ConfigError(f"distribution is a visualrhp.scene.SceneDistribution, not {shown(distribution)}")
        if physics is not None and not isinstance(physics, Physics):
            raise ConfigError(f"physics is a visualrhp.simulation.Physics or None, not {shown(physics)}")
        super().__init__(device=torch.device("cpu"), batch_size=(num_envs,))
        self.distribution = distribution
        self.split = checked_split(split)
        self._instance_seed = checked_seed(seed)
        self.observe = observation_for(checked_name("observation", observation), distribution)
        self.action_space = make_action_space(checked_name("action_space", action_space))
        self._is_discrete = self.action_space.name == "discrete"
        self._family = TaskFamily(distribution, self.split, self.action_space.name, self.observe, physics or Physics())
        self._num_workers = num_workers
        self._next_indices = list(range(num_envs))
        self._slot_seeds = [self._instance_seed] * num_envs  # of the running episodes
        self._after_end: set[int] = set()  # slots that were stepped after the end of their episodes
        self.backend: Backend | None = None
        self.observation_spec = specs.observation_spec(self._family, self.batch_size)
        self.action_spec = specs.action_spec(self._family, self.batch_size)
        self.reward_spec = specs.reward_spec(self.batch_size)
        self.done_spec = specs.done_spec(self.batch_size)

    @property
    def num_envs(self) -> int:
        """Number N of parallel tasks."""
        return self.batch_size[0]

    @property
    def scenes(self) -> list[Scene]:
        """The N scenes of the running episodes."""
        return self._started.scenes

    @property
    def states(self) -> list[State]:
        """The N current states."""
        return self._started.states

    @property
    def models(self) -> list[TransitionModel]:
        """The N decision processes, for planners."""
        return self._started.models

    @property
    def instances(self) -> list[int]:
        """Indices of the N task instances."""
        return self._started.arrays.instance.tolist()

    @property
    def num_actions(self) -> list[int]:
        """Number of actions taken in each of the N episodes."""
        return self._started.arrays.num_actions.tolist()

    @property
    def _started(self) -> Backend:
        if self.backend is None:
            raise ActionError("the environment has no tasks yet, or was closed; call reset first")
        return self.backend

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self._instance_seed = checked_seed(seed)
        self._next_indices = list(range(self.num_envs))

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        seed = kwargs.pop("seed", None)
        unknown = [name for name, value in kwargs.items() if name != "set_state" or value]  # torchrl's, not supported
        if unknown:
            raise ConfigError(f"reset got the unknown arguments {shown(unknown)}; it takes a tensordict and seed=...")
        slots = self._slots_to_reset(None if tensordict is None else tensordict.get("_reset", None))
        if seed is not None:
            self._set_seed(seed)
        backend = self.backend or self._new_backend()
        try:
            backend.start(self._instance_seed, slots, [self._next_indices[slot] for slot in slots])
        except Exception:
            self._drop_unless_current(backend)
            raise
        self._enter(backend)
        for slot in slots:
            self._next_indices[slot] += self.num_envs
            self._slot_seeds[slot] = self._instance_seed
        self._after_end.difference_update(slots)
        return self.current()

    def _slots_to_reset(self, chosen: Any) -> list[int]:
        """The slots that the entry ``_reset`` [N] or [N, 1] selects; all without it, or where none has a task."""
        if chosen is None:
            return list(range(self.num_envs))
        is_mask = isinstance(chosen, torch.Tensor) and chosen.dtype is torch.bool and chosen.numel() == self.num_envs
        if not is_mask:
            raise ConfigError(f"'_reset' should be a tensor of {self.num_envs} booleans, not {shown(chosen)}")
        if self.backend is None:
            return list(range(self.num_envs))
        return chosen.reshape(self.num_envs).nonzero()[:, 0].tolist()

    def _new_backend(self) -> Backend:
        return make_backend(self._family, self.num_envs, self._num_workers)

    def _enter(self, backend: Backend) -> None:
        """Step in ``backend`` from now on: all its slots have tasks."""
        self.backend = backend
        self.is_closed = False

    def _drop_unless_current(self, backend: Backend) -> None:
        if backend is not self.backend:
            backend.close()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        backend, arrays = self._started, self._started.arrays
        actions = batch_of_actions(tensordict.get("action", None), self._is_discrete, self.num_envs)
        # torchrl excludes tasks that are over while it waits for the others
        active: Any = tensordict.get("_step", None)
        is_active = np.ones(self.num_envs, bool) if active is None else active.reshape(self.num_envs).cpu().numpy()
        self._warn_after_end(np.flatnonzero((arrays.terminated | arrays.truncated) & is_active).tolist())
        arrays.action[:] = actions
        arrays.is_active[:] = is_active
        arrays.reward[:] = 0.0
        backend.act()
        entries = self._shown(backend)
        for key in ("reward", "terminated", "truncated"):
            entries[key] = self._tensor(getattr(arrays, key)[:, None].copy())
        entries["done"] = self._tensor((arrays.terminated | arrays.truncated)[:, None])
        # as torchrl's own environments do: checking the shapes costs more than the rest of this method
        return TensorDict._new_unsafe(entries, batch_size=self.batch_size, device=self.device)

    def _warn_after_end(self, over: list[int]) -> None:
        """Warn, once for each episode, that the slots ``over`` are stepped after the end of their episodes."""
        new = [slot for slot in over if slot not in self._after_end]
        if new:
            self._after_end.update(new)
            warnings.warn(
                f"step was called after the end of the episodes in the slots {shown(new)}: what follows is no part of "
                "the task; reset these slots (step_and_maybe_reset does), or leave them out of the step (_step)",
                stacklevel=3,
            )

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        """``array``, which nobody else writes to, on the device of the environment."""
        tensor = torch.from_numpy(array)
        return tensor if self.device is None or self.device.type == "cpu" else tensor.to(self.device)

    def _assert_tensordict_shape(self, tensordict: TensorDictBase) -> None:
        if tensordict.batch_size != self.batch_size:
            raise ConfigError(
                f"the tensordict should be of the batch size {list(self.batch_size)} of the environment, not "
                f"{list(tensordict.batch_size)}"
            )

    def _shown(self, backend: Backend) -> dict[str, torch.Tensor]:
        """Copies of the observations: the next step overwrites the arrays."""
        return {key: self._tensor(getattr(backend.arrays, key).copy()) for key in _SHOWN}

    def current(self) -> TensorDict:
        """The current observations, as ``reset`` returns them, with the flags of the last step."""
        backend = self._started
        over = {key: self._tensor(getattr(backend.arrays, key)[:, None].copy()) for key in ("terminated", "truncated")}
        entries = {**self._shown(backend), **over, "done": over["terminated"] | over["truncated"]}
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)

    def recall(self, instances: torch.Tensor, states: torch.Tensor) -> TensorDict:
        """Observations of earlier states of this environment, of its current seed.

        Args:
            instances: [K] int64, indices of task instances.
            states: [K, 5 + 3 max m] float64, the ``state`` entries.

        Returns:
            ``observation`` and ``gripper_closed``, [K].

        Raises:
            ConfigError: the tensors have other shapes or types, an index is negative, or a state is not finite.
        """
        indices, rows = checked_states(instances, states, self._family.state_dimension)
        scenes: dict[int, TaskInstance] = {}
        observations, closed = [], []
        for index, row in zip(indices, rows, strict=True):
            if index not in scenes:
                scenes[index] = self._family.instance(self._instance_seed, index)
            instance = scenes[index]
            state = State(row[: instance.state.vector.size])
            observations.append(self.observe(instance.scene, state))
            closed.append(state.gripper_closed)
        seen = np.stack(observations) if observations else np.zeros((0, *self.observe.shape), self.observe.dtype)
        entries = {"observation": torch.from_numpy(seen), "gripper_closed": torch.tensor(closed, dtype=torch.bool)}
        return TensorDict(entries, batch_size=[len(closed)], device=self.device)

    def snapshot(self) -> dict[str, torch.Tensor]:
        """The state of the N tasks, to be stored in a checkpoint: N rows each, and what the tasks are a function of.

        Raises:
            ActionError: before the first ``reset``, or after ``close``.
        """
        arrays = self._started.arrays
        return take_snapshot(self._family, self._instance_seed, self._slot_seeds, self._next_indices, arrays)

    def restore(self, snapshot: Mapping[str, torch.Tensor]) -> TensorDict:
        """Resume bit-exactly from a :meth:`snapshot` of an environment made with the same arguments.

        Returns:
            the current observations (:meth:`current`).

        Raises:
            CheckpointError: the snapshot is damaged, or of an environment of another size, seed or configuration.
                Nothing has changed.
        """
        content = read_snapshot(self._family, self.num_envs, self._instance_seed, snapshot)
        backend = self.backend or self._new_backend()
        try:
            backend.resume(content.seeds, content.instances, content.num_actions, content.states)
        except SceneError as error:
            self._drop_unless_current(backend)
            raise CheckpointError(f"the snapshot of the environment is damaged: {error}") from error
        content.mark_ended(backend.arrays)
        self._enter(backend)
        self._next_indices, self._slot_seeds = content.next_indices, content.seeds
        self._after_end.clear()
        return self.current()

    def to(self, device: Any) -> Self:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return and take tensors on ``device`` from now on; the simulation stays on the CPU.

        Raises:
            ConfigError: there is no such device.
        """
        return super().to(specs.usable_device(device))  # pyright: ignore[reportReturnType]

    def cuda(self, device: int | torch.device | None = None) -> Self:
        """As :meth:`to` with a CUDA device, or its number."""
        number = "" if device is None else f":{device}"
        return self.to(device if isinstance(device, torch.device) else f"cuda{number}")

    def cpu(self) -> Self:
        """As ``to("cpu")``."""
        return self.to("cpu")

    def close(self, *, raise_if_closed: bool = True) -> None:
        """End the worker processes, if there are any; a later ``reset`` starts them again."""
        super().close(raise_if_closed=raise_if_closed)
        backend, self.backend = self.backend, None
        if backend is not None:
            backend.close()

    def __getstate__(self) -> dict[str, Any]:
        """A copy resumes from the state of this environment, with its own backend."""
        state = {**super().__getstate__(), "backend": None}
        return {**state, "_snapshot": None if self.backend is None else self.snapshot()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        snapshot = state.pop("_snapshot")
        super().__setstate__(state)
        if snapshot is not None:
            self.restore(snapshot)
