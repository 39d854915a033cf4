"""Base of DQN and C3PO (Sec. 6.3): collection, statistics of episodes, the best network, resuming."""

from __future__ import annotations

import copy
import logging
import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn

from visualrhp.errors import CheckpointError, ConfigError, LearningError
from visualrhp.learning.history import ReinforcementProgress
from visualrhp.learning.training_state import MISFITS, load_training_state, misfit, save_training_state
from visualrhp.types import Metrics

if "RL_LOGGING_LEVEL" not in os.environ:  # by default, torchrl reports every new storage on stderr
    logging.getLogger("torchrl").setLevel(logging.WARNING)

NETWORK_INPUTS = ("observation", "gripper_closed")
"""Entries of a tensordict that networks read."""

GreedyEvaluation = Callable[[nn.Module], Mapping[str, float]]
"""Evaluates the greedy policy of a network; must return ``success_rate``, the share of solved validation tasks."""

CollectionPolicy = Callable[[TensorDictBase], TensorDictBase]
"""Writes actions, and quantities recorded with them, for the N tasks of an environment."""


class CollectionEnvironment(Protocol):
    """Environment to collect in: :class:`visualrhp.environments.batched.BatchedClutterEnv`, or an equivalent."""

    @property
    def batch_size(self) -> torch.Size:
        """[N], number of parallel tasks."""
        ...

    def reset(self) -> TensorDictBase:
        """Start N tasks."""
        ...

    def step_and_maybe_reset(self, tensordict: TensorDictBase) -> tuple[TensorDictBase, TensorDictBase]:
        """Act once in every task; start a new task where the episode is over."""
        ...

    def snapshot(self) -> dict[str, torch.Tensor]:
        """The state of the N tasks."""
        ...

    def restore(self, snapshot: Mapping[str, torch.Tensor]) -> TensorDictBase:
        """Resume from a snapshot."""
        ...


class Collector:
    """Runs a policy in N parallel tasks and joins the transitions; an episode may span several collections.

    Args:
        env: torchrl environment of batch size [N].

    Attributes:
        num_transitions: transitions collected so far.
    """

    def __init__(self, env: CollectionEnvironment) -> None:
        self.env = env
        self.num_transitions = 0
        self._current: TensorDictBase | None = None
        self._returns = torch.zeros(env.batch_size)

    def collect(self, policy: CollectionPolicy, num_transitions: int) -> tuple[TensorDictBase, Metrics]:
        """Collect ``num_transitions`` transitions, a multiple of N.

        Returns:
            the transitions, [N, T] in chronological order, and statistics of the episodes that ended in them:
            ``collection/episodes``, ``/success_rate``, ``/dropped_rate``, ``/return`` (mean undiscounted sum of
            rewards) and ``/transitions_per_s``. The rates and the return are omitted if no episode ended.
        """
        start = time.perf_counter()
        current = self.env.reset() if self._current is None else self._current
        steps = []
        with torch.no_grad():
            for _ in range(num_transitions // self.env.batch_size[0]):
                step, current = self.env.step_and_maybe_reset(policy(current))
                steps.append(step)
        self._current = current
        transitions: Any = TensorDict.stack(steps, 1)
        self.num_transitions += transitions.numel()
        metrics = self._episode_statistics(transitions["next"])
        metrics["collection/transitions_per_s"] = transitions.numel() / (time.perf_counter() - start)
        metrics["collection/transitions"] = float(self.num_transitions)
        return transitions, metrics

    def _episode_statistics(self, following: TensorDictBase) -> Metrics:
        done = following["done"].squeeze(-1)  # [N, T]
        returns = []
        for step in range(done.shape[1]):
            self._returns += following["reward"][:, step, 0]
            returns += self._returns[done[:, step]].tolist()
            self._returns[done[:, step]] = 0.0
        metrics = {"collection/episodes": float(len(returns))}
        if returns:
            metrics["collection/success_rate"] = following["is_goal"][done].float().mean().item()
            metrics["collection/dropped_rate"] = following["is_dropped"][done].float().mean().item()
            metrics["collection/return"] = sum(returns) / len(returns)
        return metrics

    def snapshot(self) -> dict[str, torch.Tensor]:
        """The state for :meth:`restore`."""
        return {
            **(self.env.snapshot() if self._current is not None else {}),
            "returns": self._returns,
            "num_transitions": torch.tensor(self.num_transitions),
        }

    def restore(self, snapshot: Mapping[str, torch.Tensor]) -> None:
        """Resume from a snapshot.

        Raises:
            CheckpointError, KeyError: it does not fit the environment.
        """
        for name, own in (("returns", self._returns), ("num_transitions", torch.tensor(0))):
            found = snapshot[name]
            if found.shape != own.shape or found.dtype != own.dtype:
                raise CheckpointError(
                    f"{name} of the collection is {found.dtype} {list(found.shape)}, not {own.dtype} {list(own.shape)}"
                )
        if snapshot["num_transitions"] < 0:
            raise CheckpointError(f"the collection has made {int(snapshot['num_transitions'])} transitions")
        self._returns = snapshot["returns"].clone()
        self.num_transitions = int(snapshot["num_transitions"])
        self._current = self.env.restore(snapshot) if self.num_transitions else None


class ReinforcementLearner(ABC):
    """A training that yields one row of metrics per iteration and can be saved between iterations.

    The result is a function of the arguments and the seed. A training that is saved, loaded into a new object with the
    same arguments, and continued is bit-exact: it gives the result of an uninterrupted one.

    Args:
        network: trained in place.
        env: environment to collect in.
        evaluate: greedy evaluation, or None.
        evaluate_every: iterations between evaluations; the initial network and the last iteration are always evaluated.

    Attributes:
        iteration: number of finished iterations.
        history: the rows of metrics so far, including those before a restart.
        network: the network after the last iteration.
        best_network: a copy of the network with the best success rate of the greedy policy so far, including the
            initial one (ties are broken by action efficiency).
        best_iteration: the iteration after which it was copied.
    """

    def __init__(
        self,
        network: nn.Module,
        env: CollectionEnvironment,
        evaluate: GreedyEvaluation | None = None,
        evaluate_every: int = 1,
    ) -> None:
        if evaluate_every < 1:
            raise ConfigError(f"evaluate_every is a number of iterations and at least 1, not {evaluate_every}")
        self.network = network
        self._device = next(network.parameters()).device
        self.best_network = copy.deepcopy(network)
        self.best_iteration = 0
        self.iteration = 0
        self.history: list[Metrics] = []
        self._best_score: list[float] | None = None
        self.collector = Collector(env)
        self._evaluate = evaluate
        self._evaluate_every = evaluate_every

    def run(self, num_iterations: int) -> Iterator[Metrics]:
        """Train until ``num_iterations`` iterations are done, including those before a restart.

        Yields:
            one row of metrics per iteration, each with ``iteration``; first, as iteration 0, the greedy evaluation
            of the initial network, if there is an evaluation.

        Raises:
            LearningError: the training diverged.
        """
        if self._evaluate is not None and self._best_score is None:
            yield self._record(self._measure())
        while self.iteration < num_iterations:
            metrics = self._iterate()
            self.iteration += 1
            if self.iteration % self._evaluate_every == 0 or self.iteration == num_iterations:
                metrics.update(self._measure())
            yield self._record(metrics)

    def _record(self, metrics: Metrics) -> Metrics:
        infinite = sorted(name for name, value in metrics.items() if not math.isfinite(value))
        if infinite:
            raise LearningError(
                f"the training diverged in iteration {self.iteration}: {', '.join(infinite)} are not finite; use a "
                "smaller learning rate or limit the norm of the gradient (max_grad_norm)"
            )
        row = {"iteration": float(self.iteration), **metrics}
        self.history.append(row)
        return row

    @abstractmethod
    def _iterate(self) -> Metrics:
        """Collect and optimize once."""

    @abstractmethod
    def _parts(self) -> dict[str, Any]:
        """Modules, optimizers and generators in addition to the networks; restored in place."""

    def _values(self) -> dict[str, Any]:
        """Further tensors and JSON values to be stored."""
        return {}

    def _restore_values(self, values: dict[str, Any]) -> None:  # noqa: B027 - a learner may have none
        """Restore the result of :meth:`_values`."""

    def _measure(self) -> Metrics:
        """Evaluate the greedy policy and keep the network if it is the best so far."""
        if self._evaluate is None:
            return {}
        start = time.perf_counter()
        results = self._evaluate(self.network)
        score = [results["success_rate"], results.get("action_efficiency", 0.0)]
        if self._best_score is None or score > self._best_score:
            self._best_score = score
            self.best_iteration = self.iteration
            self.best_network.load_state_dict(self.network.state_dict())
        metrics = {f"greedy/{name}": float(value) for name, value in results.items()}
        metrics["greedy/best_success_rate"] = self._best_score[0]
        metrics["greedy/evaluation_time_s"] = time.perf_counter() - start
        return metrics

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the state of the training to one file, atomically."""
        collector = {f"collector.{name}": tensor for name, tensor in self.collector.snapshot().items()}
        counters = {
            "iteration": self.iteration,
            "best_iteration": self.best_iteration,
            "best_score": self._best_score,
            "history": self.history,
        }
        save_training_state(path, {**self._all_parts(), **collector, **counters, **self._values()})

    def load(self, path: str | os.PathLike[str]) -> None:
        """Resume from a file of :meth:`save`.

        Raises:
            CheckpointError: the file is missing or damaged, or was written by another training; the message says what
                to delete.
        """
        values = load_training_state(path, self._all_parts(), ReinforcementProgress)
        prefix = "collector."
        try:
            self.collector.restore(
                {name.removeprefix(prefix): tensor for name, tensor in values.items() if name.startswith(prefix)}
            )
            self.iteration = values["iteration"]
            self.best_iteration = values["best_iteration"]
            self._best_score = values["best_score"]
            self.history = values["history"]
            self._restore_values(values)
        except MISFITS as error:
            raise misfit(path, error) from error

    def _all_parts(self) -> dict[str, Any]:
        return {"network": self.network, "best_network": self.best_network, **self._parts()}


def require_multiple(name: str, value: int, divisor: int) -> None:
    """Check that ``value`` is a positive multiple of the number of environments ``divisor``.

    Raises:
        ConfigError: it is not; the message names ``name``.
    """
    if value < 1 or value % divisor:
        raise ConfigError(f"{name}={value} must be a positive multiple of the {divisor} environments")


def mean_metrics(rows: list[TensorDict]) -> Metrics:
    """Mean over minibatches of their scalar entries."""
    if not rows:
        return {}
    joined: Any = TensorDict.stack([row.detach() for row in rows])
    return {str(name): value.float().mean().item() for name, value in joined.items()}
