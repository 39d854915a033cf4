"""The networks of Sec. 7.2, for label images and for Cartesian features.

Both networks share the convolutional part. Three things make it fast on a CPU without changing what it computes, or
hardly:

- The colours of an image and CoordConv's coordinates come out of one table, indexed by pixel and label.
- Max pooling comes right after the convolution, so that normalization and activation see the pooled map, 4 to 16 times
  smaller (the order of the last two does not matter: both are monotone; normalizing after pooling is a departure).
- Convolution and pooling run in bfloat16 with the channels last in memory.

Normalization is per sample (over channels and pixels): batch statistics would make the policy that collects differ from
the one that is updated.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import nn
from torch.nn import functional

from visualrhp.environments.task import ObservationFunction
from visualrhp.rendering.label_image import IMAGE_SIZE, PALETTE
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace

RETURN_SCALE: Final = 20.0
"""The value heads predict returns in units of this: returns are of the order of -20, the outputs of a layer of 1."""

MIN_STD: Final = 0.05
MAX_STD: Final = 1.0
"""Range of the policy's standard deviations, in units of the action's range; the sigmoid goes from one to the other."""


def _coordinates(size: int) -> torch.Tensor:
    """[2, size, size] row and column of every pixel, from -1 to 1."""
    axis = torch.linspace(-1.0, 1.0, size)
    return torch.stack(torch.meshgrid(axis, axis, indexing="ij"))


class CoordConv(nn.Module):
    """Convolution (3 x 3) over maps and their two coordinate channels, max pooling, normalization, leaky ReLU.

    Args:
        in_channels: without the coordinates.
        pooling: factors of the successive max poolings.
    """

    def __init__(self, in_channels: int, out_channels: int, pooling: tuple[int, ...]) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(in_channels + 2, out_channels, 3, padding=1)
        self.normalization = nn.GroupNorm(1, out_channels)
        self.pooling = pooling

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """[B, in + 2, s, s] to [B, out, s', s'], s' being s over the product of the poolings."""
        maps = self.convolution(maps)
        for factor in self.pooling:
            maps = functional.max_pool2d(maps, factor)
        return functional.leaky_relu(self.normalization(maps.float()))


class ImageEncoder(nn.Module):
    """Label image to a vector of 256 features, a map of 4 x 4 x 16."""

    FEATURES: Final = 256

    def __init__(self) -> None:
        super().__init__()
        palette = torch.from_numpy(PALETTE) / 127.5 - 1.0
        pixels = IMAGE_SIZE * IMAGE_SIZE
        coordinates = _coordinates(IMAGE_SIZE).flatten(1).T
        colours_and_coordinates = torch.cat(
            [palette.repeat(pixels, 1), coordinates.repeat_interleave(len(palette), 0)], dim=1
        )
        self.register_buffer("table", colours_and_coordinates.bfloat16(), persistent=False)
        self.register_buffer(
            "rows", (len(palette) * torch.arange(pixels, dtype=torch.int32)).view(IMAGE_SIZE, IMAGE_SIZE), persistent=False
        )
        for size in (16, 8):
            self.register_buffer(f"coordinates_{size}", _coordinates(size)[None], persistent=False)
        self.first = CoordConv(3, 8, (2, 2))
        self.second = CoordConv(8, 8, (2,))
        self.third = CoordConv(8, 16, (2,))
        self.to(memory_format=torch.channels_last)

    def forward(self, labels: torch.Tensor) -> torch.Tensor:
        """[B, 64, 64] uint8 to [B, 256]."""
        # One gather lays out colours and coordinates with the channels last.
        maps = functional.embedding(self.rows + labels, self.table).permute(0, 3, 1, 2)
        with torch.autocast(labels.device.type, torch.bfloat16):
            maps = self.first(maps)
            maps = self.second(_append(maps, self.coordinates_16))
            maps = self.third(_append(maps, self.coordinates_8))
        return maps.flatten(1)


def _append(maps: torch.Tensor, coordinates: torch.Tensor) -> torch.Tensor:
    """Maps [B, c, s, s] with the coordinate channels [1, 2, s, s] behind, channels last in memory."""
    stacked = torch.cat([maps, coordinates.expand(len(maps), -1, -1, -1)], dim=1)
    return stacked.contiguous(memory_format=torch.channels_last)


class CartesianEncoder(nn.Module):
    """Cartesian features as they are: "the same architectures" (Sec. 7.5), where there is nothing to convolve."""

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """[B, 4 m + 6] unchanged."""
        return features


def _encoder(observation: ObservationFunction) -> tuple[nn.Module, int]:
    """The encoder of an observation and the number of its features, the binary gripper state included."""
    if observation.name == "image":
        return ImageEncoder(), ImageEncoder.FEATURES + 1
    return CartesianEncoder(), observation.shape[0] + 1


def _dense(*sizes: int) -> nn.Sequential:
    """Fully connected layers, each followed by a leaky ReLU."""
    layers: list[nn.Module] = []
    for size_in, size_out in zip(sizes[:-1], sizes[1:], strict=True):
        layers += [nn.Linear(size_in, size_out), nn.LeakyReLU()]
    return nn.Sequential(*layers)


class QNetwork(nn.Module):
    """Action values of the discrete action space.

    Args:
        observation: what it reads.
    """

    action_space: Final = "discrete"

    def __init__(self, observation: ObservationFunction) -> None:
        super().__init__()
        self.observation = observation
        self.encoder, features = _encoder(observation)
        self.body = _dense(features, 128, 128)
        self.q_head = nn.Linear(128, DiscreteActionSpace.NUM_ACTIONS)

    def forward(self, observation: torch.Tensor, gripper_closed: torch.Tensor) -> torch.Tensor:
        """Action values.

        Args:
            observation: [B, 64, 64] uint8 labels or [B, 4 m + 6] features.
            gripper_closed: [B] or [B, 1].

        Returns:
            [B, 8].
        """
        return RETURN_SCALE * self.q_head(self.body(_features(self.encoder, observation, gripper_closed)))


class ActorCritic(nn.Module):
    """Gaussian policy and value of the continuous action space, with shared layers.

    Args:
        observation: what it reads.
    """

    action_space: Final = "continuous"

    def __init__(self, observation: ObservationFunction) -> None:
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
            observation: [B, 64, 64] uint8 labels or [B, 4 m + 6] features.
            gripper_closed: [B] or [B, 1].

        Returns:
            Means [B, 4] in [-1, 1], standard deviations [B, 4] in [0.05, 1], values [B].
        """
        shared = self.body(_features(self.encoder, observation, gripper_closed))
        mean, spread = self.policy_head(shared).chunk(2, dim=-1)
        std = MIN_STD + (MAX_STD - MIN_STD) * torch.sigmoid(spread)
        return torch.tanh(mean), std, RETURN_SCALE * self.value_head(shared).squeeze(-1)


def _features(encoder: nn.Module, observation: torch.Tensor, gripper_closed: torch.Tensor) -> torch.Tensor:
    """Encoded observation and binary gripper state side by side."""
    return torch.cat([encoder(observation), gripper_closed.reshape(-1, 1).float()], dim=-1)


def make_network(action_space: str, observation: ObservationFunction) -> QNetwork | ActorCritic:
    """The network of an action space, freshly initialised from torch's generator."""
    return {"discrete": QNetwork, "continuous": ActorCritic}[action_space](observation)
