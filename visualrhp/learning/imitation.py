r"""Imitation of the kinodynamic RRT's demonstrations (Sec. 6.2).

Time indices: a demonstration has the states :math:`s_0 \dots s_L` and the actions :math:`a_0 \dots a_{L-1}`; the pair
:math:`(s_l, a_l)` is followed by the rewards :math:`r_{l+1} \dots r_L`, and ``steps_to_go`` is :math:`L - l`.
"""

from __future__ import annotations

import math
import os
import time
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import nn
from torch.distributions import Independent, Normal

from visualrhp.environments.task import ObservationFunction
from visualrhp.errors import ConfigError, DataError, LearningError
from visualrhp.heuristics.networks import ActorCritic, QNetwork
from visualrhp.learning.checkpoints import load_training_state, save_training_state
from visualrhp.learning.demonstrations import monte_carlo_returns
from visualrhp.learning.label_runs import LabelRuns
from visualrhp.rendering.cartesian import mirror_cartesian
from visualrhp.scene.scene import TaskInstance
from visualrhp.simulation.action_spaces import DiscreteActionSpace
from visualrhp.simulation.task import DISCOUNT
from visualrhp.types import Episode

Metrics = dict[str, float]

_MIRRORED_CONTINUOUS = torch.tensor([1.0, -1.0, -1.0, 1.0])
_MIRRORED_DISCRETE = torch.tensor(DiscreteActionSpace.MIRRORED)


@dataclass(frozen=True)
class ImitationBatch:
    """B state-action pairs of demonstrations, as tensors.

    Attributes:
        observation: [B, 64, 64] uint8 labels or [B, 4 m + 6] float32 features.
        gripper_closed: [B] bool.
        action: [B] int64 or [B, 4] float32.
        returns: [B] float32, Monte Carlo targets (Eq. 4).
        steps_to_go: [B] int64, L - l.
    """

    observation: torch.Tensor
    gripper_closed: torch.Tensor
    action: torch.Tensor
    returns: torch.Tensor
    steps_to_go: torch.Tensor

    def mirrored(self, rows: torch.Tensor) -> ImitationBatch:
        """The same pairs, with those in the mask ``rows`` [B] as seen and done in the mirrored scene."""
        parts = dict(vars(self))
        if self.observation.dtype == torch.uint8:
            mirror = self.observation.flip(-1)
        else:
            signs = mirror_cartesian(np.ones(self.observation.shape[1], np.float32))
            mirror = self.observation * torch.from_numpy(signs)
        mask = rows.view(-1, *[1] * (mirror.dim() - 1))
        parts["observation"] = torch.where(mask, mirror, self.observation)
        if self.action.dim() == 1:
            parts["action"] = torch.where(rows, _MIRRORED_DISCRETE[self.action], self.action)
        else:
            parts["action"] = torch.where(rows[:, None], self.action * _MIRRORED_CONTINUOUS, self.action)
        return ImitationBatch(**parts)


@dataclass(frozen=True)
class ImitationData:
    """T state-action pairs of demonstrations in little memory: a batch of them is unpacked as it is used.

    Attributes:
        observations: T packed label images, or [T, 4 m + 6] float32 features.
        gripper_closed: [T] bool.
        action: [T] int64 or [T, 4] float32.
        returns: [T] float32, Monte Carlo targets (Eq. 4).
        steps_to_go: [T] int32, L - l.
        demonstration: [T] int32, the demonstration that a pair is from.
    """

    observations: LabelRuns | npt.NDArray[np.float32]
    gripper_closed: torch.Tensor
    action: torch.Tensor
    returns: torch.Tensor
    steps_to_go: torch.Tensor
    demonstration: torch.Tensor

    @classmethod
    def from_demonstrations(
        cls,
        demonstrations: Iterable[tuple[TaskInstance, Episode]],
        observe: ObservationFunction,
        discount: float = DISCOUNT,
    ) -> ImitationData:
        """Look at every state of the demonstrations but the last; one demonstration is held at a time.

        Raises:
            DataError: there are no demonstrations.
        """
        closed, returns = array("b"), array("f")
        steps_to_go, numbers = array("i"), array("i")
        actions: list[np.ndarray] = []

        def look() -> Iterator[np.ndarray]:
            for number, (task, episode) in enumerate(demonstrations):
                length = len(episode)
                closed.extend(state.gripper_closed for state in episode.states[:-1])
                returns.extend(monte_carlo_returns(episode.rewards, discount))
                steps_to_go.extend(range(length, 0, -1))
                numbers.extend([number] * length)
                action = np.array(episode.actions)
                actions.append(action if action.ndim == 1 else action.astype(np.float32))
                for state in episode.states[:-1]:
                    yield observe(task.scene, state)

        observations: Any
        if observe.name == "image":
            observations = LabelRuns.pack(look())
        else:
            size = math.prod(observe.shape)
            observations = np.fromiter(look(), np.dtype((np.float32, (size,))))
        if not actions:
            raise DataError("there are no demonstrations to imitate")
        return cls(
            observations=observations,
            gripper_closed=torch.tensor(np.array(closed, dtype=np.bool_)),
            action=torch.from_numpy(np.concatenate(actions)),
            returns=torch.tensor(np.array(returns)),
            steps_to_go=torch.tensor(np.array(steps_to_go)),
            demonstration=torch.tensor(np.array(numbers)),
        )

    def __len__(self) -> int:
        return len(self.returns)

    def __getitem__(self, rows: torch.Tensor) -> ImitationBatch:
        """The pairs with the indices ``rows`` [B]."""
        return ImitationBatch(
            observation=torch.from_numpy(self.observations[rows.numpy()]),
            gripper_closed=self.gripper_closed[rows],
            action=self.action[rows],
            returns=self.returns[rows],
            steps_to_go=self.steps_to_go[rows].to(torch.int64),
        )

    def split(self, fraction: float, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Indices of training and held-out pairs; whole demonstrations are held out, ``fraction`` of them."""
        numbers = torch.unique(self.demonstration)
        order = torch.randperm(len(numbers), generator=generator)
        held_out = torch.isin(self.demonstration, numbers[order[: round(fraction * len(numbers))]])
        return torch.nonzero(~held_out)[:, 0], torch.nonzero(held_out)[:, 0]


# --------------------------------------------------------------------------------------------------------------- losses
def value_margin(
    steps_to_go: torch.Tensor, margin_actions: int, margin_cost: float, discount: float = DISCOUNT
) -> torch.Tensor:
    r"""The value margin, by which actions that were not selected are worth less (Sec. 6.2.1).

    .. math:: \lambda = \sum_{k=1}^{\eta} \gamma^{L-l-1+k} r_{cost}

    Args:
        steps_to_go: [B] L - l.
        margin_actions: eta, actions that mend a mistake.
        margin_cost: r_cost of each of them.
        discount: gamma.

    Returns:
        [B].
    """
    exponents = steps_to_go[:, None] - 1 + torch.arange(1, margin_actions + 1)
    return margin_cost * (discount ** exponents.to(torch.float32)).sum(dim=1)


def q_targets(q: torch.Tensor, action: torch.Tensor, returns: torch.Tensor, margin: torch.Tensor) -> torch.Tensor:
    r"""Targets of all action values at visited states (Eq. 4 and 5).

    The selected action's target is the Monte Carlo return; another action's is at most that minus the margin, and its
    present value where it is below.

    Args:
        q: [B, 8] present action values; no gradient flows into the targets.
        action: [B] selected actions.
        returns: [B] q^tar(s_l, a_l).
        margin: [B] lambda.

    Returns:
        [B, 8].
    """
    targets = torch.minimum(q.detach(), (returns - margin)[:, None])
    return targets.scatter(1, action[:, None], returns[:, None])


def q_imitation_loss(
    q: torch.Tensor, action: torch.Tensor, returns: torch.Tensor, margin: torch.Tensor
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Squared error of the eight action values, summed over the actions and averaged over the batch (Eq. 4 and 5).

    Returns:
        the loss, and the parts of it that the selected and the other actions make.
    """
    errors = (q - q_targets(q, action, returns, margin)).square()
    selected = errors.gather(1, action[:, None]).mean()
    loss = errors.sum(dim=1).mean()
    return loss, {"selected": selected.detach(), "unselected": (loss - selected).detach()}


def actor_critic_imitation_loss(
    outputs: tuple[torch.Tensor, torch.Tensor, torch.Tensor],
    action: torch.Tensor,
    returns: torch.Tensor,
    likelihood_coefficient: float,
    value_coefficient: float,
    entropy_coefficient: float,
    return_unit: float = 1.0,
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    r"""Loss of policy and value (Eq. 6), averaged over the batch.

    .. math:: L_{il} = E[-\Upsilon \log \pi(a_l | s_l) + c_1 (v^{tar}(s_l) - v(s_l))^2 + c_2 H(\pi(\cdot | s_l))]

    Args:
        outputs: means [B, 4], standard deviations [B, 4] and values [B] of the network.
        action: [B, 4].
        returns: [B] v^tar.
        likelihood_coefficient: Upsilon.
        value_coefficient: c1.
        entropy_coefficient: c2, of the penalty on high entropy.
        return_unit: unit of the returns in the squared error.

    Returns:
        the loss, and its terms without their coefficients.
    """
    mean, std, value = outputs
    policy = Independent(Normal(mean, std, validate_args=False), 1, validate_args=False)
    log_likelihood = policy.log_prob(action).mean()
    value_error = ((returns - value) / return_unit).square().mean()
    entropy = policy.entropy().mean()
    loss = -likelihood_coefficient * log_likelihood + value_coefficient * value_error + entropy_coefficient * entropy
    terms = {"log_likelihood": log_likelihood, "value_error": value_error, "entropy": entropy}
    return loss, {name: term.detach() for name, term in terms.items()}


# ------------------------------------------------------------------------------------------------------------ training
@dataclass(frozen=True)
class ImitationConfig:
    """What both action spaces share. Defaults: Sec. 7.4.

    Attributes:
        discount: gamma.
        l2_regularization: weight of the squared norm of the parameters.
        batch_size: M.
        epochs: passes over the pairs.
        lr: learning rate of Adam.
        lr_schedule: ``constant``, or ``cosine`` down to zero at the last step.
        mirror: show every pair with probability one half as in the mirrored scene.
        validation_fraction: share of the demonstrations held out.

    Raises:
        ConfigError: a parameter is out of range.
    """

    discount: float = DISCOUNT
    l2_regularization: float = 0.0
    batch_size: int = 2000
    epochs: int = 100
    lr: float = 1e-4
    lr_schedule: str = "constant"
    mirror: bool = True
    validation_fraction: float = 0.05

    def __post_init__(self) -> None:
        for name in ("batch_size", "epochs", "lr"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"learner.{name}={getattr(self, name)}: must be positive")
        if self.lr_schedule not in ("constant", "cosine"):
            raise ConfigError(f"learner.lr_schedule={self.lr_schedule!r}: choose constant or cosine")
        if not 0.0 <= self.validation_fraction < 1.0:
            raise ConfigError(f"learner.validation_fraction={self.validation_fraction}: must be in [0, 1)")


@dataclass(frozen=True)
class QImitationConfig(ImitationConfig):
    """Discrete action space (Sec. 6.2.1).

    Attributes:
        margin_actions: eta.
        margin_cost: r_cost.
    """

    margin_actions: int = 3
    margin_cost: float = 1.0


@dataclass(frozen=True)
class ActorCriticImitationConfig(ImitationConfig):
    """Continuous action space (Sec. 6.2.2).

    Attributes:
        likelihood_coefficient: Upsilon.
        value_coefficient: c1.
        entropy_coefficient: c2.
        return_unit: unit of the returns in the squared error of the value; 1 is the paper's.
    """

    likelihood_coefficient: float = 0.5
    value_coefficient: float = 0.7
    entropy_coefficient: float = 0.01
    return_unit: float = 1.0


class ImitationLearner:
    """Trains a network to reproduce demonstrations; yields one row of metrics an epoch.

    The result is a function of the arguments and the seed (and of torch's number of threads); a training that is saved,
    loaded into a new object made with the same arguments, and continued gives the same bits as one that was not
    interrupted.

    Args:
        network: trained in place.
        data: what to imitate.
        config: of the kind that fits the network's action space.
        seed: of the held-out demonstrations, the order of the pairs and the mirroring.
        evaluate: greedy evaluation; answers ``success_rate`` and more.
        evaluate_every: epochs between evaluations; the last is always evaluated.

    Raises:
        ConfigError: the configuration is of the other action space.
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
        self._generator = torch.Generator().manual_seed(seed)
        self._data = data
        self._training, self._validation = data.split(config.validation_fraction, self._generator)
        # The gradient of l2 ||w||^2 is 2 l2 w.
        decay = 2.0 * config.l2_regularization
        self._optimizer = torch.optim.Adam(network.parameters(), lr=config.lr, weight_decay=decay)
        self._evaluate = evaluate
        self._evaluate_every = evaluate_every

    def run(self) -> Iterator[Metrics]:
        """Train until all epochs are done, those before a restart included.

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
                raise LearningError(f"the training diverged in epoch {self.epoch}; a smaller learning rate would help")
            self.history.append(metrics)
            yield metrics

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the state of the training to one file, atomically."""
        save_training_state(path, {**self._parts(), "epoch": self.epoch, "history": self.history})

    def load(self, path: str | os.PathLike[str]) -> None:
        """Go on from a file of :meth:`save`.

        Raises:
            CheckpointError: the file is missing or damaged, or was written by another training.
        """
        values = load_training_state(path, self._parts())
        self.epoch, self.history = values["epoch"], values["history"]

    def _parts(self) -> dict[str, Any]:
        return {"network": self.network, "optimizer": self._optimizer, "generator": self._generator}

    def _train_epoch(self) -> Metrics:
        self.network.train()
        order = torch.randperm(len(self._training), generator=self._generator)
        batches = order.split(self.config.batch_size)
        sums: dict[str, float] = {}
        for number, rows in enumerate(batches):
            batch = self._data[self._training[rows]]
            if self.config.mirror:
                batch = batch.mirrored(torch.rand(len(rows), generator=self._generator) < 0.5)
            self._set_learning_rate(self.epoch * len(batches) + number, self.config.epochs * len(batches))
            loss, terms = self._loss(batch)
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()
            for name, term in {"loss": loss.detach(), **terms}.items():
                sums[name] = sums.get(name, 0.0) + float(term) * len(rows)
        return {name: value / len(self._training) for name, value in sums.items()}

    def _set_learning_rate(self, step: int, num_steps: int) -> None:
        decay = 0.5 * (1.0 + math.cos(math.pi * step / num_steps)) if self.config.lr_schedule == "cosine" else 1.0
        for group in self._optimizer.param_groups:
            group["lr"] = self.config.lr * decay

    def _loss(self, batch: ImitationBatch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        action, returns = batch.action.to(self._device), batch.returns.to(self._device)
        outputs = self._outputs(batch)
        config = self.config
        if isinstance(config, QImitationConfig):
            margin = value_margin(batch.steps_to_go, config.margin_actions, config.margin_cost, config.discount)
            return q_imitation_loss(outputs, action, returns, margin.to(self._device))
        return actor_critic_imitation_loss(
            outputs,
            action,
            returns,
            config.likelihood_coefficient,
            config.value_coefficient,
            config.entropy_coefficient,
            config.return_unit,
        )

    def _outputs(self, batch: ImitationBatch) -> Any:
        return self.network(batch.observation.to(self._device), batch.gripper_closed.to(self._device))

    def _validate(self) -> Metrics:
        """Loss terms, and how well value and action of the held-out pairs are predicted."""
        self.network.eval()
        sums: dict[str, float] = {}
        with torch.inference_mode():
            for rows in self._validation.split(self.config.batch_size):
                batch = self._data[rows]
                loss, terms = self._loss(batch)
                outputs = self._outputs(batch)
                if isinstance(self.config, QImitationConfig):
                    predicted = outputs.gather(1, batch.action[:, None].to(self._device)).squeeze(1)
                    agreement = (outputs.argmax(dim=1).cpu() == batch.action).float().mean()
                    terms = {**terms, "agreement": agreement}
                else:
                    predicted = outputs[2]
                terms = {"loss": loss, **terms, "value_mse": (predicted.cpu() - batch.returns).square().mean()}
                for name, term in terms.items():
                    sums[name] = sums.get(name, 0.0) + float(term) * len(rows)
        metrics = {name: value / len(self._validation) for name, value in sums.items()}
        metrics["value_rmse"] = math.sqrt(metrics.pop("value_mse"))
        return metrics
