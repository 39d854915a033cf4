"""Conversion of networks in PyTorch to heuristics and files, and back."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy.typing as npt
import torch
from torch import nn

from visualrhp.heuristics.checkpoint import StoredNetwork, other_architecture, read_network, write_network
from visualrhp.heuristics.learned import DEFAULT_TEMPERATURE, LearnedHeuristic
from visualrhp.heuristics.networks import ActorCritic, QNetwork, make_network
from visualrhp.types import ActionSpaceName


def weights_of(network: nn.Module) -> dict[str, npt.NDArray[Any]]:
    """Copies of the current weights by their names in the state dict."""
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in network.state_dict().items()}


def heuristic_of(network: QNetwork | ActorCritic, temperature: float = DEFAULT_TEMPERATURE) -> LearnedHeuristic:
    """Make a heuristic with a copy of the current weights of ``network``."""
    return LearnedHeuristic(weights_of(network), network.action_space, network.observation, temperature)


def save_heuristic(
    path: str | os.PathLike[str], network: QNetwork | ActorCritic, card: Mapping[str, Any] | None = None
) -> None:
    """Write ``network`` to ``path`` (``*.safetensors``) and its card to ``*.json``, each atomically.

    Args:
        card: origin of the network (config, seed, commit, data hash, metrics); JSON values only.
    """
    write_network(path, StoredNetwork(weights_of(network), network.action_space, network.observation, card or {}))


def load_network(
    path: str | os.PathLike[str], expect_action_space: ActionSpaceName | None = None
) -> tuple[QNetwork | ActorCritic, Mapping[str, Any]]:
    """Load the network in a file, and its card.

    Raises:
        CheckpointError: the file is missing or damaged, is not a trained heuristic, or has another action space than
            expected or another architecture than in this version.
    """
    stored = read_network(path, expect_action_space)
    network = make_network(stored.action_space, stored.observation)
    try:
        network.load_state_dict({name: torch.from_numpy(values) for name, values in stored.weights.items()})
    except RuntimeError as error:
        raise other_architecture(path, error) from error
    return network, stored.card
