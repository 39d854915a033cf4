"""Network, losses and loops of training as one writes them in PyTorch first: the reference of the section training.

The networks have the weights of ours and the same outputs; coordinates are appended as channels, label images are
coloured pixel by pixel, and losses are those of the paper, term by term.
"""

from __future__ import annotations

import copy

import torch
from torch import nn
from torch.distributions import Independent, Normal, kl_divergence
from torch.nn import functional
from torch.utils.data import DataLoader, TensorDataset

from tests.heuristics.plain_convolution import PlainLabelConvolution
from visualrhp.heuristics.label_convolution import LabelConvolution
from visualrhp.heuristics.networks import ActorCritic, CoordConv
from visualrhp.learning.configs import ActorCriticImitationConfig, C3POConfig


class PlainCoordConv(nn.Module):
    """CoordConv with coordinates as channels of the maps, and max pooling 2 x 2.

    Args:
        layer: whose weights it has.
    """

    def __init__(self, layer: CoordConv) -> None:
        super().__init__()
        self.convolution = layer.convolution

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """[B, in, s, s] to [B, out, s / 2, s / 2]."""
        axis = torch.linspace(-1.0, 1.0, maps.shape[-1])
        coordinates = torch.stack(torch.meshgrid(axis, axis, indexing="ij")).expand(len(maps), -1, -1, -1)
        return functional.max_pool2d(self.convolution(torch.cat([maps, coordinates], dim=1)), 2)


def plain(network: ActorCritic) -> ActorCritic:
    """A copy of ``network`` with plain layers."""
    found = copy.deepcopy(network)
    layers = found.encoder.layers
    assert isinstance(layers, nn.Sequential)
    for number, layer in enumerate(layers):
        if isinstance(layer, LabelConvolution):
            layers[number] = PlainLabelConvolution(layer)
        elif isinstance(layer, CoordConv):
            layers[number] = PlainCoordConv(layer)
    return found


def _policy(mean: torch.Tensor, std: torch.Tensor) -> Independent:
    return Independent(Normal(mean, std), 1)


class PlainImitation:
    """Eq. 6 with a DataLoader; half of the pairs are mirrored."""

    def __init__(
        self, network: ActorCritic, pairs: tuple[torch.Tensor, ...], config: ActorCriticImitationConfig
    ) -> None:
        self._network, self._config = network, config
        self._optimizer = torch.optim.Adam(network.parameters(), lr=config.lr)
        self._loader = DataLoader(TensorDataset(*pairs), config.batch_size, shuffle=True)

    def epoch(self) -> None:
        config = self._config
        signs = torch.tensor([1.0, -1.0, -1.0, 1.0])
        for images, closed, actions, returns in self._loader:
            mirrored = torch.rand(len(images)) < 0.5
            labels = torch.where(mirrored[:, None, None], images.flip(2), images)
            actions = torch.where(mirrored[:, None], actions * signs, actions)
            mean, std, value = self._network(labels, closed)
            policy = _policy(mean, std)
            loss = -config.likelihood_coefficient * policy.log_prob(actions).mean()
            loss = loss + config.value_coefficient * ((returns - value) / config.return_unit).square().mean()
            loss = loss + config.entropy_coefficient * policy.entropy().mean()
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()


class PlainC3PO:
    """The update of C3PO (Eq. 8 to 10) on transitions (images, closed, actions, rewards, terminated, next ...)."""

    def __init__(self, network: ActorCritic, config: C3POConfig) -> None:
        self._network, self._config = network, config
        self._baseline_optimizer = torch.optim.Adam(network.parameters(), lr=config.lr)
        self._policy_optimizer = torch.optim.Adam(network.parameters(), lr=config.lr)

    def update(self, transitions: tuple[torch.Tensor, ...]) -> None:
        images, closed, actions = transitions[:3]
        config = self._config
        old = self._old(transitions)
        for rows in self._minibatches(len(images), config.baseline_epochs):
            mean, std, value = self._network(images[rows], closed[rows])
            divergence = kl_divergence(_policy(old[0][rows], old[1][rows]), _policy(mean, std)).mean()
            error = (old[3][rows] - value).square().mean()
            self._step(self._baseline_optimizer, config.baseline_value_coefficient * error + divergence)
        old = self._old(transitions)
        log_prob = _policy(old[0], old[1]).log_prob(actions)
        advantage = old[3] - old[2]
        for rows in self._minibatches(len(images), config.policy_epochs):
            mean, std, value = self._network(images[rows], closed[rows])
            policy = _policy(mean, std)
            ratio = (policy.log_prob(actions[rows]) - log_prob[rows]).exp()
            clipped = ratio.clamp(1.0 - config.clip_epsilon, 1.0 + config.clip_epsilon)
            objective = torch.minimum(ratio * advantage[rows], clipped * advantage[rows]).mean()
            error = (old[3][rows] - value).square().mean()
            entropy = policy.entropy().mean()
            loss = -objective + config.value_coefficient * error - config.entropy_coefficient * entropy
            self._step(self._policy_optimizer, loss)

    @torch.no_grad()
    def _old(self, transitions: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
        images, closed, _, rewards, terminated, next_images, next_closed = transitions
        batches = torch.arange(len(images)).split(self._config.batch_size)
        now = [self._network(images[rows], closed[rows]) for rows in batches]
        mean, std, value = (torch.cat(parts) for parts in zip(*now, strict=True))
        following = torch.cat([self._network(next_images[rows], next_closed[rows])[2] for rows in batches])
        return mean, std, value, rewards + self._config.discount * following * ~terminated

    def _minibatches(self, count: int, epochs: int) -> list[torch.Tensor]:
        return [rows for _ in range(epochs) for rows in torch.randperm(count).split(self._config.batch_size)]

    @staticmethod
    def _step(optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
