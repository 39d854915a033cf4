"""Trained heuristics as files: the network's weights in safetensors, with a JSON card inside and beside.

The card inside is what is read; the one beside the file (``heuristic.json``) is for people and other programs.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from visualrhp.environments.task import ObservationFunction
from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.files import atomic_path
from visualrhp.heuristics.learned import DEFAULT_TEMPERATURE, LearnedHeuristic
from visualrhp.heuristics.networks import ActorCritic, QNetwork, make_network
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file
from visualrhp.types import ActionSpaceName

_FORMAT = "visualrhp-heuristic-1"


def save_heuristic(
    path: str | os.PathLike[str], network: QNetwork | ActorCritic, card: Mapping[str, Any] | None = None
) -> None:
    """Write ``network`` to ``path`` (``*.safetensors``) and its card beside it (``*.json``), each atomically.

    Args:
        card: where the network comes from (config, seed, commit, data hash, metrics); JSON values only.
    """
    path = Path(path)
    document = {
        "format": _FORMAT,
        "action_space": network.action_space,
        "representation": network.observation.name,
        "num_objects": network.observation.num_objects,
        "card": dict(card or {}),
    }
    write_tensor_file(path, network.state_dict(), document)
    with atomic_path(path.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(document, indent=2, sort_keys=True) + "\n")


def load_network(
    path: str | os.PathLike[str], expect_action_space: ActionSpaceName | None = None
) -> tuple[QNetwork | ActorCritic, dict[str, Any]]:
    """The network in a file and its card.

    Raises:
        CheckpointError: the file is missing, damaged, no heuristic, of another action space than expected, or of
            another architecture than this version's.
    """
    tensors, document = read_tensor_file(path)
    if document.get("format") != _FORMAT:
        raise CheckpointError(
            f"{path} is no trained heuristic (its format is {document.get('format')!r}, not {_FORMAT!r})"
        )
    action_space = document["action_space"]
    if expect_action_space is not None and action_space != expect_action_space:
        raise CheckpointError(
            f"{path} was trained in the {action_space} action space, but the {expect_action_space} one is asked for; "
            f"set action_space={action_space}, or give a heuristic of the {expect_action_space} action space"
        )
    try:
        network = make_network(action_space, ObservationFunction(document["representation"], document["num_objects"]))
        network.load_state_dict(tensors)
    except (RuntimeError, KeyError, ConfigError) as error:
        raise CheckpointError(f"{path} holds another architecture than this version's: {error}") from error
    return network, document["card"]


def load_heuristic(
    path: str | os.PathLike[str],
    expect_action_space: ActionSpaceName | None = None,
    temperature: float = DEFAULT_TEMPERATURE,
) -> LearnedHeuristic:
    """The heuristic in a file, ready to guide a planner; errors as :func:`load_network`."""
    network, _ = load_network(path, expect_action_space)
    return LearnedHeuristic(network.eval(), temperature)
