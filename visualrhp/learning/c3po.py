r"""Critic Correction Conditioned Policy Optimization on top of PPO (Sec. 6.3.2, Algorithm 2), continuous action space.

One iteration, with the parameters that each quantity is computed with:

============================ =================================================================================
step                         quantities and their parameters
============================ =================================================================================
collect                      a ~ pi_theta (unclipped; the environment clips for execution)
theta_old <- theta           pi_old, v_old(s), v_old(s'): one-step targets of Eq. 10
Optimize L_baseline          theta changes; pi_old and the targets are fixed
theta_old <- theta           pi_old(a|s), v_old(s), v_old(s') again: advantages (Eq. 9) and targets of Eq. 8
Optimize L_actor-critic      theta changes; all of the above are fixed
============================ =================================================================================

Without the baseline step (``baseline_step=False``) this is PPO, the comparison of Fig. 6.
"""

from __future__ import annotations

import time
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictModule, ProbabilisticTensorDictSequential, TensorDictModule
from torch import nn
from torch.distributions import Independent, Normal, kl_divergence
from torchrl.data import ReplayBuffer, TensorStorage
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.modules import IndependentNormal
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value.functional import generalized_advantage_estimate

from visualrhp.learning.configs import C3POConfig
from visualrhp.learning.reinforcement import (
    NETWORK_INPUTS,
    CollectionEnvironment,
    GreedyEvaluation,
    ReinforcementLearner,
    mean_metrics,
    require_multiple,
)
from visualrhp.streams import TrainingStream
from visualrhp.types import Metrics

_NETWORK_OUTPUTS = ("loc", "scale", "state_value")


def policy_distribution(mean: torch.Tensor, std: torch.Tensor) -> Independent:
    """pi(.|s) = N(mean, diag(std^2)) over actions [B, 4] (Sec. 4)."""
    return Independent(Normal(mean, std, validate_args=False), 1, validate_args=False)


def baseline_loss(outputs: TensorDictBase, batch: TensorDictBase, baseline_value_coefficient: float) -> TensorDict:
    r"""The two terms of Eq. 10, means over a minibatch [M].

    .. math:: L_\mathrm{baseline} = \frac{1}{M} \sum_i c_5 (r_i + \gamma v_{\theta_{old}}(s'_i) - v_\theta(s_i))^2
              + D_{KL}(\pi_{\theta_{old}}(\cdot|s_i) \,||\, \pi_\theta(\cdot|s_i))

    Args:
        outputs: ``loc`` [M, 4], ``scale`` [M, 4] and ``state_value`` [M, 1] with theta.
        batch: ``old_loc``, ``old_scale`` and ``value_target`` with theta_old.
        baseline_value_coefficient: c5.

    Returns:
        ``loss_value`` (including c5) and ``loss_kl``.
    """
    value_error = batch["value_target"] - outputs["state_value"]
    divergence = kl_divergence(
        policy_distribution(batch["old_loc"], batch["old_scale"]),
        policy_distribution(outputs["loc"], outputs["scale"]),
    )
    return TensorDict(
        {"loss_value": baseline_value_coefficient * value_error.square().mean(), "loss_kl": divergence.mean()}
    )


class C3PO(ReinforcementLearner):
    """C3PO (or PPO) in N environments in parallel. The module documents the algorithm.

    Args:
        network: ``forward(observation, gripper_closed) -> (mean [B, 4], std [B, 4], value [B])``; trained in place.
        env: environment with the continuous action space.
        config: parameters.
        seed: of the actions and the minibatches.
        evaluate: greedy evaluation, or None.
        evaluate_every: iterations between evaluations.

    Raises:
        ConfigError: frames_per_batch is not a multiple of the number of environments.
    """

    def __init__(
        self,
        network: nn.Module,
        env: CollectionEnvironment,
        config: C3POConfig,
        *,
        seed: int,
        evaluate: GreedyEvaluation | None = None,
        evaluate_every: int = 1,
    ) -> None:
        super().__init__(network, env, evaluate, evaluate_every)
        require_multiple("frames_per_batch", config.frames_per_batch, env.batch_size[0])
        self.config = config
        # One pass through the shared layers computes mean, std and value; the loss finds the value already computed.
        self._actor_critic = TensorDictModule(_Columns(network), list(NETWORK_INPUTS), list(_NETWORK_OUTPUTS))
        sampling = ProbabilisticTensorDictModule(
            in_keys=["loc", "scale"], out_keys=["action"], distribution_class=IndependentNormal, return_log_prob=True
        )
        self.policy_loss = ClipPPOLoss(
            ProbabilisticTensorDictSequential([self._actor_critic, sampling]),
            TensorDictModule(nn.Identity(), ["state_value"], ["state_value"]),
            clip_epsilon=config.clip_epsilon,
            critic_coeff=config.value_coefficient,
            entropy_coeff=config.entropy_coefficient,
            loss_critic_type="l2",
            normalize_advantage=config.normalize_advantage,
            functional=False,
        )
        # Two optimizers, since the running moments of one loss do not describe the gradients of the other.
        self._baseline_optimizer = torch.optim.Adam(network.parameters(), lr=config.lr)
        self._policy_optimizer = torch.optim.Adam(network.parameters(), lr=config.lr)
        self._sampling = torch.Generator().manual_seed(TrainingStream.C3PO_ACTIONS.seed(seed))
        self._shuffling = torch.Generator().manual_seed(TrainingStream.C3PO_MINIBATCHES.seed(seed))

    def _parts(self) -> dict[str, Any]:
        return {
            "baseline_optimizer": self._baseline_optimizer,
            "policy_optimizer": self._policy_optimizer,
            "sampling": self._sampling,
            "shuffling": self._shuffling,
        }

    def _iterate(self) -> Metrics:
        """One iteration of Algorithm 2."""
        transitions, metrics = self.collector.collect(self.act, self.config.frames_per_batch)
        start = time.perf_counter()
        num_epochs = self.config.policy_epochs
        if self.config.baseline_step:
            data = self.with_old_parameters(transitions)
            metrics["value/td_rmse_before"] = _td_rmse(data)
            metrics.update(self.optimize_baseline(data))
            num_epochs += self.config.baseline_epochs
        data = self.with_old_parameters(transitions)
        metrics["value/td_rmse"] = _td_rmse(data)
        metrics["value/mean"] = data["old_value"].mean().item()
        metrics["policy/advantage_std"] = data["advantage"].std().item()
        metrics.update(self.optimize_policy(data))
        metrics["optimization/samples_per_s"] = num_epochs * data.numel() / (time.perf_counter() - start)
        return metrics

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """a ~ N(mean, std), with the log-probability of the sample, before the environment clips it."""
        outputs = self._actor_critic(tensordict.select(*NETWORK_INPUTS).to(self._device)).cpu()
        noise = torch.randn(outputs["loc"].shape, generator=self._sampling)
        return tensordict.set("action", outputs["loc"] + outputs["scale"] * noise)

    @torch.no_grad()
    def with_old_parameters(self, transitions: TensorDictBase) -> TensorDictBase:
        """theta_old <- theta: compute all quantities of Eq. 8, Eq. 9 and Eq. 10 at theta_old.

        Args:
            transitions: [N, T] in chronological order.

        Returns:
            the transitions, flattened to [N T], with ``old_loc``, ``old_scale`` [N T, 4], ``old_value`` [N T, 1],
            ``action_log_prob`` [N T], ``value_target`` (r + gamma v_old(s')) and ``advantage`` (Eq. 9) [N T, 1].
        """
        shape = transitions.batch_size
        following: Any = transitions["next"].to(self._device)
        inputs = transitions.select(*NETWORK_INPUTS, "action").to(self._device)
        outputs: Any = self._evaluate_network(inputs.flatten(0, 1)).unflatten(0, shape)
        value = outputs["state_value"]
        # s' is the s of the next row, except where an episode or the collection ends, so it is not evaluated again.
        next_value = value.roll(-1, dims=1)
        is_last = following["done"].squeeze(-1).clone()
        is_last[:, -1] = True
        ends = following.select(*NETWORK_INPUTS)[is_last]
        next_value[is_last] = self._evaluate_network(ends)["state_value"]
        advantage, value_target = generalized_advantage_estimate(
            self.config.discount,
            self.config.gae_lambda,
            value,
            next_value,
            following["reward"],
            following["done"],
            following["terminated"],
        )
        log_prob = policy_distribution(outputs["loc"], outputs["scale"]).log_prob(inputs["action"])
        return inputs.update(
            {
                "old_loc": outputs["loc"],
                "old_scale": outputs["scale"],
                "old_value": value,
                "action_log_prob": log_prob,
                "advantage": advantage,
                "value_target": value_target,
            }
        ).flatten(0, 1)

    def _evaluate_network(self, inputs: Any) -> Any:
        """Means, stds and values of many states, one minibatch at a time."""
        parts = inputs.select(*NETWORK_INPUTS).split(self.config.batch_size)
        return TensorDict.cat([self._actor_critic(part).select(*_NETWORK_OUTPUTS) for part in parts])

    def _minibatches(self, data: TensorDictBase) -> ReplayBuffer:
        """D^replay: an epoch is one pass through it in random order."""
        return ReplayBuffer(
            storage=TensorStorage(data),
            sampler=SamplerWithoutReplacement(drop_last=False),
            batch_size=self.config.batch_size,
            generator=self._shuffling,
        )

    def optimize_baseline(self, data: TensorDictBase) -> Metrics:
        """Optimize L_baseline with respect to theta (Eq. 10)."""
        minibatches = self._minibatches(data.exclude("action", "action_log_prob", "advantage"))
        terms: list[TensorDict] = []
        for _ in range(self.config.baseline_epochs):
            terms = []
            for batch in minibatches:
                outputs = self._actor_critic(batch.select(*NETWORK_INPUTS))
                losses = baseline_loss(outputs, batch, self.config.baseline_value_coefficient)
                self.step(self._baseline_optimizer, losses["loss_value"] + losses["loss_kl"])
                terms.append(losses)
        means = mean_metrics(terms)
        return {"baseline/loss_value": means["loss_value"], "baseline/kl": means["loss_kl"]}

    def optimize_policy(self, data: TensorDictBase) -> Metrics:
        """Optimize L_actor-critic with respect to theta (Eq. 8, the ratio clipped as in PPO)."""
        minibatches = self._minibatches(data)
        terms: list[TensorDict] = []
        for _ in range(self.config.policy_epochs):
            terms = []
            for batch in minibatches:
                losses = self.policy_loss(batch)
                loss = losses["loss_objective"] + losses["loss_critic"]
                if "loss_entropy" in losses:
                    loss = loss + losses["loss_entropy"]
                self.step(self._policy_optimizer, loss)
                terms.append(losses.select("loss_objective", "loss_critic", "entropy", "kl_approx", "clip_fraction"))
        means = mean_metrics(terms)
        return {
            "policy/loss_objective": means["loss_objective"],
            "policy/loss_value": means["loss_critic"],
            "policy/entropy": means["entropy"],
            "policy/kl": means["kl_approx"],
            "policy/clip_fraction": means["clip_fraction"],
        }

    def step(self, optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        if self.config.max_grad_norm is not None:
            nn.utils.clip_grad_norm_(self.network.parameters(), self.config.max_grad_norm)
        optimizer.step()


class _Columns(nn.Module):
    """The network with its value as a column [B, 1], as torchrl's losses expect it."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(
        self, observation: torch.Tensor, gripper_closed: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        mean, std, value = self.network(observation, gripper_closed)
        return mean, std, value.unsqueeze(-1)


def _td_rmse(data: TensorDictBase) -> float:
    """Root mean square of target minus value, in units of return."""
    return (data["value_target"] - data["old_value"]).square().mean().sqrt().item()
