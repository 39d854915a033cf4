"""N tasks solved side by side, as one torchrl environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from visualrhp.environments.task import NUM_LABELS, ClutterTask, ObservationFunction, ObservationName, Outcome
from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.scene.sampling import SceneDistribution, Split, sample_task_instance
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace, make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import Action, ActionSpaceName, State

_ROBOT_DIMENSIONS = 5


class BatchedClutterEnv(EnvBase):
    """N task instances advanced together inside one ``EnvBase`` of batch size [N].

    One environment holds all tasks because the step of a torchrl environment costs as much as simulating an action.
    Slot i solves task instances i, i + N, i + 2 N, ... of (distribution, seed, split), so the tasks do not depend on
    who finishes first. Scenes, states and models are Python objects that a planner can work on (:attr:`scenes`,
    :attr:`states`, :attr:`models`).

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
    ``truncated``      [N, 1] bool                   action limit
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

    Attributes:
        observe: scene and state -> observation.
        action_space: the action space.

    Raises:
        ConfigError: an argument is unknown or out of range.
    """

    def __init__(
        self,
        distribution: SceneDistribution,
        action_space: ActionSpaceName,
        observation: ObservationName = "image",
        num_envs: int = 10,
        seed: int = 0,
        split: Split = Split.REINFORCEMENT,
        physics: Physics | None = None,
    ) -> None:
        if num_envs < 1:
            raise ConfigError(f"num_envs is the number of tasks solved side by side and at least 1, not {num_envs}")
        super().__init__(device=torch.device("cpu"), batch_size=(num_envs,))
        self.distribution = distribution
        self.split = split
        self._instance_seed = seed
        self.observe = ObservationFunction.for_distribution(observation, distribution)
        self.action_space = make_action_space(action_space)
        self._tasks = [ClutterTask(distribution, self.action_space, physics) for _ in range(num_envs)]
        self._next_indices = list(range(num_envs))
        self._seen: list[tuple[State, npt.NDArray[Any]] | None] = [None] * num_envs
        self._state_dimension = _ROBOT_DIMENSIONS + 3 * distribution.num_objects[1]
        self._make_specs()

    @property
    def num_envs(self) -> int:
        """Number N of tasks solved side by side."""
        return len(self._tasks)

    @property
    def scenes(self) -> list[Scene]:
        """The N scenes that are being worked on."""
        return [task.instance.scene for task in self._tasks]

    @property
    def states(self) -> list[State]:
        """The N current states."""
        return [task.state for task in self._tasks]

    @property
    def models(self) -> list[TransitionModel]:
        """The N decision processes, for planners."""
        return [task.model for task in self._tasks]

    @property
    def instances(self) -> list[int]:
        """Indices of the N task instances."""
        return [task.index for task in self._tasks]

    @property
    def num_actions(self) -> list[int]:
        """How many actions each of the N episodes has taken."""
        return [task.num_actions for task in self._tasks]

    def _make_specs(self) -> None:
        batch = self.batch_size
        shape = torch.Size([*batch, *self.observe.shape])
        self.observation_spec = Composite(
            observation=Categorical(NUM_LABELS, shape=shape, dtype=torch.uint8)
            if self.observe.name == "image"
            else Unbounded(shape=shape, dtype=torch.float32),
            gripper_closed=Categorical(2, shape=batch, dtype=torch.bool),
            state=Unbounded(shape=torch.Size([*batch, self._state_dimension]), dtype=torch.float64),
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
        slots = range(self.num_envs) if chosen is None else chosen.reshape(self.num_envs).nonzero()[:, 0].tolist()
        for slot in slots:
            self._tasks[slot].start(self._instance_seed, self.split, self._next_indices[slot])
            self._next_indices[slot] += self.num_envs
        return self.current()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        outcomes = [
            task.act(action) for task, action in zip(self._tasks, self._actions(tensordict["action"]), strict=True)
        ]
        terminated = torch.tensor([[outcome.terminated] for outcome in outcomes])
        truncated = torch.tensor([[outcome.truncated] for outcome in outcomes])
        entries = self._entries(outcomes)
        entries["reward"] = torch.tensor([[outcome.reward] for outcome in outcomes], dtype=torch.float32)
        entries.update(terminated=terminated, truncated=truncated, done=terminated | truncated)
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)

    def _actions(self, actions: torch.Tensor) -> list[Action]:
        """N actions as the simulation takes them."""
        if self.action_space.name == "discrete":
            return actions.tolist()
        return list(actions.numpy().astype(np.float64))

    def _entries(self, outcomes: list[Outcome] | None) -> dict[str, torch.Tensor]:
        observations = np.stack([self._observation(slot) for slot in range(self.num_envs)])
        states = np.zeros((self.num_envs, self._state_dimension))
        for row, task in zip(states, self._tasks, strict=True):
            row[: task.state.vector.size] = task.state.vector
        return {
            "observation": torch.from_numpy(observations),
            "gripper_closed": torch.tensor([task.state.gripper_closed for task in self._tasks]),
            "state": torch.from_numpy(states),
            "instance": torch.tensor([task.index for task in self._tasks]),
            "is_goal": torch.tensor([outcome.is_goal for outcome in outcomes or ()] or [False] * self.num_envs),
            "is_dropped": torch.tensor([outcome.is_dropped for outcome in outcomes or ()] or [False] * self.num_envs),
        }

    def _observation(self, slot: int) -> npt.NDArray[Any]:
        """What slot ``slot`` shows; drawn once a state, although the reset of another slot asks for it again."""
        task, seen = self._tasks[slot], self._seen[slot]
        if seen is None or seen[0] is not task.state:
            seen = self._seen[slot] = task.state, self.observe(task.instance.scene, task.state)
        return seen[1]

    def current(self) -> TensorDict:
        """What an agent sees now, as ``reset`` returns it (no episode is over)."""
        flags = {key: torch.zeros(*self.batch_size, 1, dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        return TensorDict({**self._entries(None), **flags}, batch_size=self.batch_size, device=self.device)

    def recall(self, instances: torch.Tensor, states: torch.Tensor) -> TensorDict:
        """What an agent saw in earlier states of this environment.

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
                scenes[index] = sample_task_instance(self.distribution, self._instance_seed, self.split, index)
            instance = scenes[index]
            state = State(row[: instance.state.vector.size])
            observations.append(self.observe(instance.scene, state))
            closed.append(state.gripper_closed)
        entries = {"observation": torch.from_numpy(np.stack(observations)), "gripper_closed": torch.tensor(closed)}
        return TensorDict(entries, batch_size=[len(closed)])

    def snapshot(self) -> dict[str, torch.Tensor]:
        """Where each of the N tasks stands, to be stored in a checkpoint: N rows each."""
        entries = self._entries(None)
        return {
            "state": entries["state"],
            "instance": entries["instance"],
            "num_actions": torch.tensor(self.num_actions),
            "next_index": torch.tensor(self._next_indices),
        }

    def restore(self, snapshot: Mapping[str, torch.Tensor]) -> TensorDict:
        """Go on, to the bit, from a :meth:`snapshot` of an environment made with the same arguments.

        Returns:
            what an agent sees then (:meth:`current`).

        Raises:
            CheckpointError: the snapshot is of an environment of another size.
        """
        expected = (self.num_envs, self._state_dimension)
        if tuple(snapshot["state"].shape) != expected:
            raise CheckpointError(
                f"the checkpoint holds environment states of shape {list(snapshot['state'].shape)}, and this "
                f"environment needs {list(expected)}: another number of environments or objects wrote it"
            )
        self._next_indices = snapshot["next_index"].tolist()
        rows = zip(self._tasks, snapshot["instance"].tolist(), snapshot["num_actions"].tolist(), strict=True)
        for row, (task, index, num_actions) in zip(snapshot["state"].numpy(), rows, strict=True):
            task.start(self._instance_seed, self.split, index)
            task.resume(num_actions, State(row[: task.state.vector.size]))
        return self.current()
