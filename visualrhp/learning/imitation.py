r"""Imitation of the kinodynamic RRT's demonstrations (Sec. 6.2).

Time indices: a demonstration has the states :math:`s_0 \dots s_L` and the actions :math:`a_0 \dots a_{L-1}`; the pair
:math:`(s_l, a_l)` is followed by the rewards :math:`r_{l+1} \dots r_L`, and ``steps_to_go`` is :math:`L - l`.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import torch
from torch import nn

from visualrhp.errors import ConfigError, LearningError
from visualrhp.heuristics.networks import ActorCritic, QNetwork
from visualrhp.learning.configs import ActorCriticImitationConfig, QImitationConfig
from visualrhp.learning.history import ImitationProgress
from visualrhp.learning.imitation_data import ImitationBatch, ImitationData
from visualrhp.learning.imitation_losses import actor_critic_imitation_loss, q_imitation_loss, value_margin
from visualrhp.learning.training_state import load_training_state, save_training_state
from visualrhp.streams import TrainingStream
from visualrhp.types import Metrics


class ImitationLearner:
    """Trains a network to reproduce demonstrations; yields one row of metrics per epoch.

    The result is a function of the arguments and the seed (and of torch's number of threads). A training that is saved,
    loaded into a new object with the same arguments, and continued is bit-exact: it gives the result of an
    uninterrupted one.

    Args:
        network: trained in place.
        data: the pairs to imitate.
        config: for the action space of the network.
        seed: of the held-out demonstrations, the order of the pairs and the mirroring.
        evaluate: greedy evaluation; returns ``success_rate`` and other metrics.
        evaluate_every: epochs between evaluations; the last is always evaluated.

    Raises:
        ConfigError: the configuration is for the other action space.
    """

    def __init__(
        self,
        network: QNetwork | ActorCritic,
        data: ImitationData,
        config: QImitationConfig | ActorCriticImitationConfig,
        seed: int,
        evaluate: Callable[[nn.Module], Mapping[str, float]] | None = None,
        evaluate_every: int = 1,
    ) -> None:
        expected = QImitationConfig if network.action_space == "discrete" else ActorCriticImitationConfig
        if not isinstance(config, expected):
            raise ConfigError(
                f"a {type(config).__name__} cannot train a network of the {network.action_space} action space"
            )
        self.network = network
        self.config = config
        self.epoch = 0
        self.history: list[Metrics] = []
        self._device = next(network.parameters()).device
        self._generator = torch.Generator().manual_seed(TrainingStream.IMITATION.seed(seed))
        self._data = data if self._device.type == "cpu" else data.resident(self._device)
        self._training, self._validation = data.split(config.validation_fraction, self._generator)
        # The gradient of l2 ||w||^2 is 2 l2 w.
        decay = 2.0 * config.l2_regularization
        self._optimizer = torch.optim.Adam(network.parameters(), lr=config.lr, weight_decay=decay)
        self._evaluate = evaluate
        self._evaluate_every = evaluate_every

    def run(self) -> Iterator[Metrics]:
        """Train until all epochs are done, including those before a restart.

        Raises:
            LearningError: the training diverged.
        """
        while self.epoch < self.config.epochs:
            start = time.perf_counter()
            terms = self._train_epoch()
            self.epoch += 1
            metrics = {
                "epoch": float(self.epoch),
                **{f"train/{name}": value for name, value in terms.items()},
                "lr": self._optimizer.param_groups[0]["lr"],
                "samples_per_s": len(self._training) / (time.perf_counter() - start),
            }
            if len(self._validation):
                metrics |= {f"validation/{name}": value for name, value in self._validate().items()}
            if self._evaluate is not None and (
                self.epoch % self._evaluate_every == 0 or self.epoch == self.config.epochs
            ):
                metrics |= {f"greedy/{name}": float(value) for name, value in self._evaluate(self.network).items()}
            if not all(math.isfinite(value) for value in metrics.values()):
                raise LearningError(f"the training diverged in epoch {self.epoch}; use a smaller learning rate")
            self.history.append(metrics)
            yield metrics

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the state of the training to one file, atomically."""
        save_training_state(path, {**self._parts(), "epoch": self.epoch, "history": self.history})

    def load(self, path: str | os.PathLike[str]) -> None:
        """Resume from a file of :meth:`save`.

        Raises:
            CheckpointError: the file is missing or damaged, or was written by another training; the message says
                what to delete.
        """
        values = load_training_state(path, self._parts(), ImitationProgress)
        self.epoch, self.history = values["epoch"], values["history"]

    def _parts(self) -> dict[str, Any]:
        return {"network": self.network, "optimizer": self._optimizer, "generator": self._generator}

    def _train_epoch(self) -> Metrics:
        self.network.train()
        order = torch.randperm(len(self._training), generator=self._generator)
        batches = order.split(self.config.batch_size)
        sums = _WeightedMeans()
        for number, rows in enumerate(batches):
            mirror = torch.rand(len(rows), generator=self._generator) < 0.5 if self.config.mirror else None
            batch = self._data.batch(self._training[rows], mirror)
            self._set_learning_rate(self.epoch * len(batches) + number, self.config.epochs * len(batches))
            loss, terms = self._loss(batch)
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()
            sums.add({"loss": loss.detach(), **terms}, len(rows))
        return sums.means()

    def _set_learning_rate(self, step: int, num_steps: int) -> None:
        decay = 0.5 * (1.0 + math.cos(math.pi * step / num_steps)) if self.config.lr_schedule == "cosine" else 1.0
        for group in self._optimizer.param_groups:
            group["lr"] = self.config.lr * decay

    def _loss(self, batch: ImitationBatch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        action, returns = batch.action.to(self._device), batch.returns.to(self._device)
        is_target, is_valued = (
            None if mask is None else mask.to(self._device) for mask in (batch.is_target, batch.is_valued)
        )
        outputs = self._outputs(batch)
        config = self.config
        if isinstance(config, QImitationConfig):
            margin = value_margin(batch.steps_to_go, config.margin_actions, config.margin_cost, config.discount)
            return q_imitation_loss(outputs, action, returns, margin.to(self._device), is_target, is_valued)
        return actor_critic_imitation_loss(
            outputs,
            action,
            returns,
            config.likelihood_coefficient,
            config.value_coefficient,
            config.entropy_coefficient,
            config.return_unit,
            is_target,
            is_valued,
        )

    def _outputs(self, batch: ImitationBatch) -> Any:
        return self.network(batch.observation.to(self._device), batch.gripper_closed.to(self._device))

    def _validate(self) -> Metrics:
        """Loss terms, and prediction errors of value and action, of the held-out pairs."""
        self.network.eval()
        sums = _WeightedMeans()
        with torch.inference_mode():
            for rows in self._validation.split(self.config.batch_size):
                batch = self._data[rows]
                loss, terms = self._loss(batch)
                outputs = self._outputs(batch)
                if isinstance(self.config, QImitationConfig):
                    action = batch.action.to(self._device)
                    predicted = outputs.gather(1, action[:, None]).squeeze(1)
                    agreement = (outputs.argmax(dim=1) == action).float().mean()
                    terms = {**terms, "agreement": agreement}
                else:
                    predicted = outputs[2]
                value_mse = (predicted - batch.returns.to(self._device)).square().mean()
                sums.add({"loss": loss, **terms, "value_mse": value_mse}, len(rows))
        metrics = sums.means()
        metrics["value_rmse"] = math.sqrt(metrics.pop("value_mse"))
        return metrics


class _WeightedMeans:
    """Means of loss terms over minibatches, weighted by their size; does not wait for the device before the end."""

    def __init__(self) -> None:
        self._terms: dict[str, list[torch.Tensor]] = {}
        self._sizes: list[int] = []

    def add(self, terms: Mapping[str, torch.Tensor], size: int) -> None:
        """Add the terms of a minibatch."""
        self._sizes.append(size)
        for name, term in terms.items():
            self._terms.setdefault(name, []).append(term)

    def means(self) -> Metrics:
        """The means so far."""
        total = sum(self._sizes)
        return {
            name: sum(value * size for value, size in zip(torch.stack(terms).tolist(), self._sizes, strict=True))
            / total
            for name, terms in self._terms.items()
        }
