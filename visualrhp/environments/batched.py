"""N tasks in parallel, as one torchrl environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from visualrhp.environments.backends import Backend, make_backend
from visualrhp.environments.slots import TaskFamily
from visualrhp.errors import ActionError, CheckpointError, ConfigError
from visualrhp.observation import observation_for
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace, make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.streams import Split
from visualrhp.types import ActionSpaceName, State

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

    Args:
        distribution: of the task instances.
        action_space: ``discrete`` or ``continuous``.
        observation: ``image`` or ``cartesian`` (which needs a fixed number of objects).
        num_envs: N, at least 1.
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
        if num_envs < 1:
            raise ConfigError(f"num_envs is the number of parallel tasks and at least 1, not {num_envs}")
        if num_workers is not None and num_workers < 0:
            raise ConfigError(f"num_workers is the number of worker processes and at least 0, not {num_workers}")
        super().__init__(device=torch.device("cpu"), batch_size=(num_envs,))
        self.distribution = distribution
        self.split = split
        self._instance_seed = seed
        self.observe = observation_for(observation, distribution)
        self.action_space = make_action_space(action_space)
        self._family = TaskFamily(distribution, split, self.action_space.name, self.observe, physics or Physics())
        self._num_workers = num_workers
        self._next_indices = list(range(num_envs))
        self.backend: Backend | None = None
        self._make_specs()

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

    def _lazy_backend(self) -> Backend:
        """The backend that simulates, created lazily."""
        if self.backend is None:
            self.backend = make_backend(self._family, self.num_envs, self._num_workers)
            self.is_closed = False
        return self.backend

    def _make_specs(self) -> None:
        batch = self.batch_size
        shape = torch.Size([*batch, *self.observe.shape])
        self.observation_spec = Composite(
            observation=Categorical(int(self.observe.high) + 1, shape=shape, dtype=torch.uint8)
            if self.observe.dtype is np.uint8
            else Unbounded(shape=shape, dtype=torch.float32),
            gripper_closed=Categorical(2, shape=batch, dtype=torch.bool),
            state=Unbounded(shape=torch.Size([*batch, self._family.state_dimension]), dtype=torch.float64),
            instance=Unbounded(shape=batch, dtype=torch.int64),
            is_goal=Categorical(2, shape=batch, dtype=torch.bool),
            is_dropped=Categorical(2, shape=batch, dtype=torch.bool),
            shape=batch,
        )
        if self.action_space.name == "discrete":
            self.action_spec = Categorical(DiscreteActionSpace.NUM_ACTIONS, shape=batch, dtype=torch.int64)
        else:
            shape = torch.Size([*batch, ContinuousActionSpace.DIMENSION])
            self.action_spec = Bounded(-1.0, 1.0, shape=shape, dtype=torch.float32)
        column = torch.Size([*batch, 1])
        self.reward_spec = Unbounded(shape=column, dtype=torch.float32)
        flag = Binary(1, shape=column, dtype=torch.bool)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=batch)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self._instance_seed = seed
        self._next_indices = list(range(self.num_envs))

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        chosen = None if tensordict is None else tensordict.get("_reset", None)
        slots = list(range(self.num_envs))
        if chosen is not None and self.backend is not None:
            slots = chosen.reshape(self.num_envs).nonzero()[:, 0].tolist()
        self._lazy_backend().start(self._instance_seed, slots, [self._next_indices[slot] for slot in slots])
        for slot in slots:
            self._next_indices[slot] += self.num_envs
        return self.current()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        backend, arrays = self._started, self._started.arrays
        actions: Any = tensordict["action"]
        arrays.action[:] = self._checked(actions.numpy())
        # torchrl excludes tasks that are over while it waits for the others
        active = tensordict.get("_step", None)
        arrays.is_active[:] = True if active is None else active.reshape(self.num_envs).numpy()
        arrays.reward[:] = 0.0
        backend.act()
        entries = self._shown(backend)
        for key in ("reward", "terminated", "truncated"):
            entries[key] = torch.from_numpy(getattr(arrays, key)[:, None].copy())
        entries["done"] = torch.from_numpy((arrays.terminated | arrays.truncated)[:, None])
        # as torchrl's own environments do: checking the shapes costs more than the rest of this method
        return TensorDict._new_unsafe(entries, batch_size=self.batch_size, device=self.device)

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        """The actions, if all are of the action space: a batch is executed as a whole or not at all."""
        if self.action_space.name == "discrete":
            if not ((actions >= 0) & (actions < DiscreteActionSpace.NUM_ACTIONS)).all():
                raise ActionError(
                    f"discrete actions are from 0 to {DiscreteActionSpace.NUM_ACTIONS - 1}, not {actions}"
                )
        elif not np.isfinite(actions).all():
            raise ActionError(f"continuous actions are finite numbers, not {actions}")
        return actions

    def _shown(self, backend: Backend) -> dict[str, torch.Tensor]:
        """Copies of the observations: the next step overwrites the arrays."""
        return {key: torch.from_numpy(getattr(backend.arrays, key).copy()) for key in _SHOWN}

    def current(self) -> TensorDict:
        """The current observations, as ``reset`` returns them (no episode is over)."""
        flags = {key: torch.zeros(*self.batch_size, 1, dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        causes = {key: torch.zeros(*self.batch_size, dtype=torch.bool) for key in ("is_goal", "is_dropped")}
        entries = {**self._shown(self._started), **causes, **flags}
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)

    def recall(self, instances: torch.Tensor, states: torch.Tensor) -> TensorDict:
        """Observations of earlier states of this environment.

        Args:
            instances: [K] int64, indices of task instances.
            states: [K, 5 + 3 max m] float64, the ``state`` entries.

        Returns:
            ``observation`` and ``gripper_closed``, [K].
        """
        scenes: dict[int, TaskInstance] = {}
        observations, closed = [], []
        for index, row in zip(instances.tolist(), states.numpy(), strict=True):
            if index not in scenes:
                scenes[index] = self._family.instance(self._instance_seed, index)
            instance = scenes[index]
            state = State(row[: instance.state.vector.size])
            observations.append(self.observe(instance.scene, state))
            closed.append(state.gripper_closed)
        entries = {"observation": torch.from_numpy(np.stack(observations)), "gripper_closed": torch.tensor(closed)}
        return TensorDict(entries, batch_size=[len(closed)])

    def snapshot(self) -> dict[str, torch.Tensor]:
        """The state of the N tasks, to be stored in a checkpoint: N rows each."""
        arrays = self._started.arrays
        return {
            "state": torch.from_numpy(arrays.state.copy()),
            "instance": torch.from_numpy(arrays.instance.copy()),
            "num_actions": torch.from_numpy(arrays.num_actions.copy()),
            "next_index": torch.tensor(self._next_indices),
        }

    def restore(self, snapshot: Mapping[str, torch.Tensor]) -> TensorDict:
        """Resume bit-exactly from a :meth:`snapshot` of an environment made with the same arguments.

        Returns:
            the current observations (:meth:`current`).

        Raises:
            CheckpointError: the snapshot is of an environment of another size.
        """
        expected = (self.num_envs, self._family.state_dimension)
        if tuple(snapshot["state"].shape) != expected:
            raise CheckpointError(
                f"the checkpoint holds environment states of shape {list(snapshot['state'].shape)}, and this "
                f"environment needs {list(expected)}: it was written with another number of environments or objects"
            )
        self._next_indices = snapshot["next_index"].tolist()
        instances, num_actions = snapshot["instance"].tolist(), snapshot["num_actions"].tolist()
        self._lazy_backend().resume(self._instance_seed, instances, num_actions, snapshot["state"].numpy())
        return self.current()

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
