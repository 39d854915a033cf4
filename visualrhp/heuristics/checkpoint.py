"""Files of trained heuristics: the weights of the network in safetensors, with a JSON card.

The card is stored in the file, from which it is read, and in a separate JSON file for people and other programs
(``heuristic.json``). This module does not import torch; :mod:`visualrhp.heuristics.conversion` writes and reads
networks in PyTorch.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy.typing as npt

from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.files import write_json
from visualrhp.heuristics.learned import DEFAULT_TEMPERATURE, LearnedHeuristic
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file
from visualrhp.observation import Observation, make_observation
from visualrhp.types import ActionSpaceName

_FORMAT = "visualrhp-heuristic-2"


@dataclass(frozen=True)
class StoredNetwork:
    """The content of a file.

    Attributes:
        weights: by their names in PyTorch's state dict.
        action_space: of the network.
        observation: that the network reads.
        card: origin of the network (config, seed, commit, data hash, metrics); JSON values only.
    """

    weights: Mapping[str, npt.NDArray[Any]]
    action_space: ActionSpaceName
    observation: Observation
    card: Mapping[str, Any]


def write_network(path: str | os.PathLike[str], network: StoredNetwork) -> None:
    """Write ``network`` to ``path`` (``*.safetensors``) and its card to ``*.json``, each atomically."""
    path = Path(path)
    document = {
        "format": _FORMAT,
        "action_space": network.action_space,
        "observation": network.observation.name,
        "num_objects": network.observation.num_objects,
        "card": dict(network.card),
    }
    write_tensor_file(path, network.weights, document)
    write_json(path.with_suffix(".json"), document)


def read_network(path: str | os.PathLike[str], expect_action_space: ActionSpaceName | None = None) -> StoredNetwork:
    """Read a file of :func:`write_network`.

    Raises:
        CheckpointError: the file is missing or damaged, is not a trained heuristic, or has another action space than
            expected.
    """
    weights, document = read_tensor_file(path)
    if document.get("format") != _FORMAT:
        raise CheckpointError(
            f"{path} is not a trained heuristic of this version (its format is {document.get('format')!r}, not "
            f"{_FORMAT!r})"
        )
    action_space = document["action_space"]
    if expect_action_space is not None and action_space != expect_action_space:
        raise CheckpointError(
            f"{path} was trained in the {action_space} action space, but the {expect_action_space} one is needed; "
            f"set action_space={action_space}, or use a heuristic for the {expect_action_space} action space"
        )
    try:
        observation = make_observation(document["observation"], document["num_objects"])
    except ConfigError as error:
        raise other_architecture(path, error) from error
    return StoredNetwork(weights, action_space, observation, document["card"])


def load_heuristic(
    path: str | os.PathLike[str],
    expect_action_space: ActionSpaceName | None = None,
    temperature: float = DEFAULT_TEMPERATURE,
) -> LearnedHeuristic:
    """Load the heuristic in a file.

    Raises:
        CheckpointError: as :func:`read_network`, or the network has another architecture than in this version.
        ConfigError: the temperature is not positive.
    """
    stored = read_network(path, expect_action_space)
    try:
        heuristic = LearnedHeuristic(stored.weights, stored.action_space, stored.observation, temperature)
        heuristic.network.check(stored.observation)
    except (KeyError, ValueError, IndexError) as error:
        raise other_architecture(path, error) from error
    return heuristic


def other_architecture(path: str | os.PathLike[str], error: Exception) -> CheckpointError:
    """The error for a file whose network has another architecture than in this version."""
    return CheckpointError(f"{path} has another architecture than the networks of this version: {error}")
