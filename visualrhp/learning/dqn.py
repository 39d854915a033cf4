r"""Deep Q-learning with the :math:`\epsilon`-RHP exploration policy (Sec. 6.3.1), discrete action space."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.data import Categorical, LazyTensorStorage, ReplayBuffer
from torchrl.data.replay_buffers.samplers import RandomSampler
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss, HardUpdate, ValueEstimators

from visualrhp.errors import CheckpointError
from visualrhp.learning.configs import DQNConfig
from visualrhp.learning.reinforcement import (
    NETWORK_INPUTS,
    CollectionEnvironment,
    GreedyEvaluation,
    ReinforcementLearner,
    require_multiple,
)
from visualrhp.planning.planner import Decision, PlanningModel
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.simulation.action_spaces import ActionSpace, DiscreteActionSpace
from visualrhp.streams import Split, Stream, TrainingStream, generator_for
from visualrhp.types import Episode, Metrics, State

_REPLAYED = (
    *NETWORK_INPUTS,
    "action",
    *(("next", key) for key in (*NETWORK_INPUTS, "reward", "done", "terminated")),
)
_REMEMBERED = ("instance", "state", "action", *(("next", key) for key in ("state", "reward", "done", "terminated")))


class TaskEnvironment(CollectionEnvironment, Protocol):
    """Tasks in which a planner can act: :class:`visualrhp.environments.batched.BatchedClutterEnv`."""

    @property
    def models(self) -> Sequence[PlanningModel]:
        """N decision processes."""
        ...

    @property
    def states(self) -> Sequence[State]:
        """N current states."""
        ...

    @property
    def instances(self) -> Sequence[int]:
        """N indices of task instances."""
        ...

    @property
    def num_actions(self) -> Sequence[int]:
        """Actions taken in each of the N episodes."""
        ...

    @property
    def action_space(self) -> ActionSpace:
        """The action space."""
        ...

    @property
    def observe(self) -> Callable[[Scene, State], np.ndarray]:
        """Scene and state -> observation."""
        ...

    def recall(self, instances: torch.Tensor, states: torch.Tensor) -> TensorDictBase:
        """Compute the observations of earlier states."""
        ...


class BatchPlanner(Protocol):
    """Plans in several tasks at once: :class:`visualrhp.planning.receding_horizon.RecedingHorizon`."""

    def plan_batch(
        self, models: Sequence[PlanningModel], states: Sequence[State], rngs: Sequence[np.random.Generator]
    ) -> list[Decision]:
        """Return one decision per task."""
        ...


class EpsilonRHP:
    r"""The exploration policy: a random action with probability :math:`\epsilon`, otherwise the action of RHP.

    All tasks share the calls of the network. The random stream of a decision is a function of (seed, task instance,
    number of the action), so it depends neither on the other tasks nor on interruptions.

    Args:
        env: environment with the tasks.
        planner: receding horizon planning, guided by the network in training.
        epsilon: probability of a random action.
        seed: of the exploration.
    """

    def __init__(self, env: TaskEnvironment, planner: BatchPlanner, epsilon: float, seed: int) -> None:
        self.env = env
        self.planner = planner
        self.epsilon = epsilon
        self._seed = seed

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` [N]."""
        models, states = self.env.models, self.env.states
        rngs = [
            generator_for(self._seed, Split.REINFORCEMENT, instance, Stream.EXPLORATION, step)
            for instance, step in zip(self.env.instances, self.env.num_actions, strict=True)
        ]
        explores = [rng.random() < self.epsilon for rng in rngs]
        actions = torch.zeros(len(rngs), dtype=torch.int64)
        for slot, rng in enumerate(rngs):
            if explores[slot]:
                actions[slot] = int(self.env.action_space.sample(rng))
        planning = [slot for slot in range(len(rngs)) if not explores[slot]]
        if planning:
            decisions = self.planner.plan_batch(
                [models[slot] for slot in planning],
                [states[slot] for slot in planning],
                [rngs[slot] for slot in planning],
            )
            actions[planning] = torch.tensor([int(decision.action or 0) for decision in decisions])
        return tensordict.set("action", actions)


def demonstration_transitions(
    task: TaskInstance, episode: Episode, observe: Callable[[Scene, State], np.ndarray]
) -> TensorDict:
    """The transitions of a demonstration in the format of the replay buffer, [L]; the last one is terminal."""
    observations = torch.from_numpy(np.stack([observe(task.scene, state) for state in episode.states]))
    closed = torch.tensor([state.gripper_closed for state in episode.states])
    terminated = torch.zeros(len(episode), 1, dtype=torch.bool)
    terminated[-1] = episode.outcome is not None and episode.outcome.is_terminal
    following = {
        "observation": observations[1:],
        "gripper_closed": closed[1:],
        "reward": torch.tensor(episode.rewards, dtype=torch.float32).unsqueeze(-1),
        "done": terminated,
        "terminated": terminated,
    }
    return TensorDict(
        {
            "observation": observations[:-1],
            "gripper_closed": closed[:-1],
            "action": torch.tensor(episode.actions, dtype=torch.int64),
            "next": TensorDict(following, batch_size=[len(episode)]),
        },
        batch_size=[len(episode)],
    )


def make_q_loss(network: nn.Module, discount: float, has_target_network: bool = False) -> DQNLoss:
    r"""Make torchrl's loss of Eq. 7, for minibatches of transitions.

    .. math:: L_q(\psi) = \frac{1}{M} \sum_i (r_i + \gamma \max_{a'} q_\psi(s'_i, a') - q_\psi(s_i, a_i))^2

    A terminal s' has the value 0; truncated episodes are bootstrapped. No gradient flows through the target.
    """
    actor = QValueActor(network, in_keys=list(NETWORK_INPUTS), spec=Categorical(DiscreteActionSpace.NUM_ACTIONS))
    loss = DQNLoss(actor, loss_function="l2", delay_value=has_target_network, action_space="categorical")
    loss.make_value_estimator(ValueEstimators.TD0, gamma=discount)
    return loss


class DQN(ReinforcementLearner):
    r"""DQN with :math:`\epsilon`-RHP in N environments in parallel.

    An iteration collects ``frames_per_batch`` transitions into the replay buffer, which starts with the demonstrations,
    and then makes ``epochs * frames_per_batch / batch_size`` optimization steps on random minibatches.

    Args:
        network: ``forward(observation, gripper_closed) -> q [B, 8]``; trained in place.
        env: environment with the discrete action space.
        make_planner: makes the receding horizon planner (n = h = 3 in the paper), guided by a network with its current
            weights; called before each collection.
        config: parameters.
        demonstrations: (task instance, demonstration) pairs.
        seed: of the exploration and the minibatches.
        evaluate: greedy evaluation, or None.
        evaluate_every: iterations between evaluations.

    Raises:
        ConfigError: frames_per_batch is not a multiple of the number of environments.
    """

    def __init__(
        self,
        network: nn.Module,
        env: TaskEnvironment,
        make_planner: Callable[[Any], BatchPlanner],
        config: DQNConfig,
        demonstrations: Iterable[tuple[TaskInstance, Episode]],
        *,
        seed: int,
        evaluate: GreedyEvaluation | None = None,
        evaluate_every: int = 1,
    ) -> None:
        super().__init__(network, env, evaluate, evaluate_every)
        require_multiple("frames_per_batch", config.frames_per_batch, env.batch_size[0])
        self.config = config
        self._env = env
        self._make_planner = make_planner
        self._seed = seed
        self.q_loss = make_q_loss(network, config.discount, config.target_update_interval is not None)
        # The gradient of w ||psi||^2 is 2 w psi: in Adam, a weight decay of 2 w.
        self._optimizer = torch.optim.Adam(
            network.parameters(), lr=config.lr, weight_decay=2.0 * config.l2_regularization
        )
        self._sampling = torch.Generator().manual_seed(TrainingStream.DQN_MINIBATCHES.seed(seed))
        self._target_updater = None
        if config.target_update_interval is not None:  # HardUpdate counts from 0
            interval = config.target_update_interval - 1
            self._target_updater = HardUpdate(self.q_loss, value_network_update_interval=interval)
        self.replay = ReplayBuffer(
            storage=LazyTensorStorage(config.buffer_size),
            sampler=RandomSampler(),
            batch_size=config.batch_size,
            generator=self._sampling,
        )
        self._num_demonstrated = 0
        for task, episode in demonstrations:
            self.replay.extend(demonstration_transitions(task, episode, env.observe))
            self._num_demonstrated += len(episode)
        self._remembered: list[TensorDictBase] = []

    def _parts(self) -> dict[str, Any]:
        return {"optimizer": self._optimizer, "sampling": self._sampling, "q_loss": self.q_loss}

    def _iterate(self) -> Metrics:
        explore = EpsilonRHP(self._env, self._make_planner(self.network), self.config.epsilon, self._seed)
        collected, metrics = self.collector.collect(explore, self.config.frames_per_batch)
        transitions: Any = collected.flatten(0, 1)
        self.replay.extend(transitions.select(*_REPLAYED))
        self._remember(transitions.select(*_REMEMBERED))
        start = time.perf_counter()
        num_batches = max(1, round(self.config.epochs * self.config.frames_per_batch / self.config.batch_size))
        losses = torch.stack([self.optimize(self.replay.sample()) for _ in range(num_batches)])
        metrics["q/loss"] = losses.mean().item()
        metrics["value/td_rmse"] = losses.mean().sqrt().item()
        metrics["exploration/epsilon"] = self.config.epsilon
        metrics["replay/transitions"] = float(len(self.replay))
        metrics["optimization/samples_per_s"] = num_batches * self.config.batch_size / (time.perf_counter() - start)
        return metrics

    def optimize(self, batch: TensorDictBase) -> torch.Tensor:
        """Make one step on the loss of Eq. 7, and return the loss."""
        loss = self.q_loss(batch.to(self._device))["loss"]
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        if self.config.max_grad_norm is not None:
            nn.utils.clip_grad_norm_(self.network.parameters(), self.config.max_grad_norm)
        self._optimizer.step()
        if self._target_updater is not None:
            self._target_updater.step()
        return loss.detach()

    # An image pair takes 8 kB, so a checkpoint holds the states, from which the images are rendered again. The
    # demonstrations are passed to the constructor again.

    def _remember(self, transitions: TensorDictBase) -> None:
        """Record what a checkpoint needs of the transitions in the replay buffer."""
        self._remembered.append(transitions)
        while sum(map(len, self._remembered[1:])) >= self.config.buffer_size:
            del self._remembered[0]

    def _values(self) -> dict[str, Any]:
        remembered: dict[str, torch.Tensor] = {}
        if self._remembered:
            joined: Any = TensorDict.cat(self._remembered)
            remembered = joined.flatten_keys(".").to_dict()
        return {
            "num_demonstrated": self._num_demonstrated,
            "target_updater": self._target_updater and self._target_updater.state_dict(),
            **{f"replay.{name}": tensor for name, tensor in remembered.items()},
        }

    def _restore_values(self, values: dict[str, Any]) -> None:
        if values["num_demonstrated"] != self._num_demonstrated:
            raise CheckpointError(
                f"the checkpoint was written with {values['num_demonstrated']} demonstrated transitions in the replay "
                f"buffer, but now there are {self._num_demonstrated}: pass the same demonstrations"
            )
        if self._target_updater is not None:
            self._target_updater.load_state_dict(values["target_updater"])
        prefix = "replay."
        entries = {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}
        if not entries:
            return
        remembered = TensorDict(entries, batch_size=entries["instance"].shape).unflatten_keys(".")
        self._remembered = list(remembered.split(self.config.frames_per_batch))
        # The buffer is a ring: continue at the position of the oldest recorded transition.
        written_before = self._num_demonstrated + self.collector.num_transitions - len(remembered)
        self.replay.writer.load_state_dict({"_cursor": written_before % self.config.buffer_size})
        for part in self._remembered:
            seen: Any = part.select(*_REPLAYED, strict=False)
            seen.update(self._env.recall(part["instance"], part["state"]))
            seen["next"].update(self._env.recall(part["instance"], part["next", "state"]))
            self.replay.extend(seen)
