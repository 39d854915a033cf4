"""Conversion of networks in PyTorch to heuristics and files, and back."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy.typing as npt
import torch
from torch import nn

from visualrhp.errors import ConfigError
from visualrhp.heuristics.checkpoint import (
    StoredNetwork,
    check_outputs,
    other_architecture,
    read_network,
    require_finite,
    write_network,
)
from visualrhp.heuristics.learned import DEFAULT_TEMPERATURE, LearnedHeuristic
from visualrhp.heuristics.networks import ActorCritic, QNetwork, make_network
from visualrhp.observation import Observation
from visualrhp.types import ActionSpaceName


def weights_of(network: nn.Module) -> dict[str, npt.NDArray[Any]]:
    """Copies of the current weights by their names in the state dict."""
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in network.state_dict().items()}


def heuristic_of(network: QNetwork | ActorCritic, temperature: float = DEFAULT_TEMPERATURE) -> LearnedHeuristic:
    """Make a heuristic with a copy of the current weights of ``network``.

    Raises:
        LearningError: a weight is not finite: the training diverged.
    """
    weights = weights_of(network)
    require_finite(weights)
    return LearnedHeuristic(weights, network.action_space, network.observation, temperature)


def save_heuristic(
    path: str | os.PathLike[str], network: QNetwork | ActorCritic, card: Mapping[str, Any] | None = None
) -> None:
    """Write ``network`` to ``path`` (``*.safetensors``) and its card to ``*.json``, each atomically.

    Args:
        card: origin of the network (config, seed, commit, data hash, metrics); JSON values only.

    Raises:
        LearningError: a weight is not finite.
    """
    write_network(path, StoredNetwork(weights_of(network), network.action_space, network.observation, card or {}))


def load_network(
    path: str | os.PathLike[str],
    expect_action_space: ActionSpaceName | None = None,
    expect_observation: Observation | None = None,
) -> tuple[QNetwork | ActorCritic, Mapping[str, Any]]:
    """Load the network in a file, and its card.

    Raises:
        CheckpointError: as :func:`visualrhp.heuristics.checkpoint.read_network`.
    """
    stored = read_network(path, expect_action_space, expect_observation)
    check_outputs(path, LearnedHeuristic(stored.weights, stored.action_space, stored.observation))
    network = make_network(stored.action_space, stored.observation)
    try:
        network.load_state_dict({name: torch.from_numpy(values) for name, values in stored.weights.items()})
    except RuntimeError as error:
        raise other_architecture(path, error) from error
    return network, stored.card


def average_networks(networks: Sequence[QNetwork | ActorCritic], shares: Sequence[float]) -> QNetwork | ActorCritic:
    """Average the weights of networks with a common origin.

    A network that was trained further, averaged with the one before, often keeps most of what it gained and loses
    little of what it had (Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022).

    Args:
        networks: of the same action space and observation.
        shares: of each network; they add up to 1.

    Raises:
        ConfigError: there are no networks, they differ in action space or observation, or the shares do not fit.
    """
    if not networks or len(shares) != len(networks) or not math.isclose(sum(shares), 1.0):
        raise ConfigError(
            f"{len(networks)} networks cannot be averaged with the shares {list(shares)}: one per network, sum 1"
        )
    first = networks[0]
    for network in networks:
        if (network.action_space, network.observation) != (first.action_space, first.observation):
            raise ConfigError(
                f"networks of {first.action_space}, {first.observation}, and of {network.action_space}, "
                f"{network.observation}, cannot be averaged"
            )
    averaged = make_network(first.action_space, first.observation)
    states = [network.state_dict() for network in networks]
    averaged.load_state_dict(
        {name: sum(share * state[name] for share, state in zip(shares, states, strict=True)) for name in states[0]}
    )
    return averaged
