"""The networks of Sec. 7.2, for label images and for Cartesian features.

Both networks have the same convolutional part. Three optimizations make it fast on a CPU, with hardly any change to the
result:

- The first layer, on the full image, exploits the structure of label images
  (:mod:`visualrhp.heuristics.label_convolution`).
- CoordConv's coordinates are the same in all images, and so is their convolution: it is computed once per batch and
  added.
- Max pooling directly follows the convolution, so that normalization and activation process the pooled map, which is 4
  to 16 times smaller (normalization after pooling is a departure; the activation is monotone, so its order does not
  matter).

Normalization is per sample (over channels and pixels): with batch statistics, the collecting policy would differ from
the updated one.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import torch
from torch import nn
from torch.nn import functional

from visualrhp.errors import ConfigError
from visualrhp.heuristics.architecture import (
    MAX_STD,
    MIN_STD,
    NEGATIVE_SLOPE,
    NORMALIZATION_EPS,
    RETURN_SCALE,
    axis_coordinates,
)
from visualrhp.heuristics.label_convolution import LabelConvolution
from visualrhp.observation import Observation
from visualrhp.observation.label_image import IMAGE_SIZE
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace


def _coordinates(size: int) -> torch.Tensor:
    """[2, size, size] row and column of every pixel, from -1 to 1."""
    axis = torch.from_numpy(axis_coordinates(size))
    return torch.stack(torch.meshgrid(axis, axis, indexing="ij"))


class CoordConv(nn.Module):
    """Convolution (3 x 3) over maps and two coordinate channels, and max pooling 2 x 2.

    Args:
        in_channels: without the coordinates.
        size: side of the maps.
    """

    _coordinates: torch.Tensor

    def __init__(self, in_channels: int, out_channels: int, size: int) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(in_channels + 2, out_channels, 3, padding=1)
        self.in_channels = in_channels
        self.register_buffer("_coordinates", _coordinates(size)[None], persistent=False)

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """[B, in, s, s] to [B, out, s / 2, s / 2]."""
        kernel, plane = self.parts()
        return functional.max_pool2d(functional.conv2d(maps, kernel, padding=1) + plane, 2)

    def parts(self) -> tuple[torch.Tensor, torch.Tensor]:
        """The kernel of the maps [out, in, 3, 3], and the contribution of coordinates and bias [1, out, s, s]."""
        kernel, coordinate_kernel = self.convolution.weight.split((self.in_channels, 2), dim=1)
        return kernel, functional.conv2d(self._coordinates, coordinate_kernel, self.convolution.bias, padding=1)


class ImageEncoder(nn.Module):
    """Label image to a vector of 256 features, a map of 4 x 4 x 16."""

    FEATURES: Final = 256

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            LabelConvolution(8),
            nn.GroupNorm(1, 8, NORMALIZATION_EPS),
            nn.LeakyReLU(NEGATIVE_SLOPE),
            CoordConv(8, 8, IMAGE_SIZE // 4),
            nn.GroupNorm(1, 8, NORMALIZATION_EPS),
            nn.LeakyReLU(NEGATIVE_SLOPE),
            CoordConv(8, 16, IMAGE_SIZE // 8),
            nn.GroupNorm(1, 16, NORMALIZATION_EPS),
            nn.LeakyReLU(NEGATIVE_SLOPE),
            nn.Flatten(),
        )

    def forward(self, labels: torch.Tensor) -> torch.Tensor:
        """[B, 64, 64] uint8 to [B, 256]."""
        return self.layers(labels)


class FeatureEncoder(nn.Module):
    """Identity: "the same architectures" (Sec. 7.5), but without convolutions."""

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """[B, F] unchanged."""
        return features


def _encoder(observation: Observation) -> tuple[nn.Module, int]:
    """The encoder of an observation, and the number of its features with the binary gripper state."""
    if observation.encoder == "label_image":
        return ImageEncoder(), ImageEncoder.FEATURES + 1
    if len(observation.shape) != 1:
        raise ConfigError(
            f"{observation} have the shape {list(observation.shape)}; the encoder {observation.encoder!r} reads vectors"
        )
    return FeatureEncoder(), observation.shape[0] + 1


def _dense(*sizes: int) -> nn.Sequential:
    """Fully connected layers, each followed by a leaky ReLU."""
    layers: list[nn.Module] = []
    for size_in, size_out in pairwise(sizes):
        layers += [nn.Linear(size_in, size_out), nn.LeakyReLU(NEGATIVE_SLOPE)]
    return nn.Sequential(*layers)


class QNetwork(nn.Module):
    """Action values of the discrete action space.

    Args:
        observation: that the network reads.
    """

    action_space: Final = "discrete"

    def __init__(self, observation: Observation) -> None:
        super().__init__()
        self.observation = observation
        self.encoder, features = _encoder(observation)
        self.body = _dense(features, 128, 128)
        self.q_head = nn.Linear(128, DiscreteActionSpace.NUM_ACTIONS)

    def forward(self, observation: torch.Tensor, gripper_closed: torch.Tensor) -> torch.Tensor:
        """Action values.

        Args:
            observation: [B, 64, 64] uint8 labels or [B, F] features.
            gripper_closed: [B] or [B, 1].

        Returns:
            [B, 8].
        """
        return RETURN_SCALE * self.q_head(self.body(_features(self.encoder, observation, gripper_closed)))


class ActorCritic(nn.Module):
    """Gaussian policy and value of the continuous action space, with shared layers.

    Args:
        observation: that the network reads.
    """

    action_space: Final = "continuous"

    def __init__(self, observation: Observation) -> None:
        super().__init__()
        self.observation = observation
        self.encoder, features = _encoder(observation)
        self.body = _dense(features, 256, 128)
        self.policy_head = nn.Sequential(_dense(128, 128), nn.Linear(128, 2 * ContinuousActionSpace.DIMENSION))
        self.value_head = nn.Sequential(_dense(128, 64), nn.Linear(64, 1))

    def forward(
        self, observation: torch.Tensor, gripper_closed: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Policy and value.

        Args:
            observation: [B, 64, 64] uint8 labels or [B, F] features.
            gripper_closed: [B] or [B, 1].

        Returns:
            Means [B, 4] in [-1, 1], standard deviations [B, 4] in [0.05, 1], values [B].
        """
        shared = self.body(_features(self.encoder, observation, gripper_closed))
        mean, spread = self.policy_head(shared).chunk(2, dim=-1)
        std = MIN_STD + (MAX_STD - MIN_STD) * torch.sigmoid(spread)
        return torch.tanh(mean), std, RETURN_SCALE * self.value_head(shared).squeeze(-1)


def _features(encoder: nn.Module, observation: torch.Tensor, gripper_closed: torch.Tensor) -> torch.Tensor:
    """Concatenate the encoded observation and the binary gripper state."""
    return torch.cat([encoder(observation), gripper_closed.reshape(-1, 1).float()], dim=-1)


def make_network(action_space: str, observation: Observation) -> QNetwork | ActorCritic:
    """Make the network of an action space, initialised with torch's generator."""
    return {"discrete": QNetwork, "continuous": ActorCritic}[action_space](observation)
