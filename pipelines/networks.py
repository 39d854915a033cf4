"""Paths of trained networks within a folder of heuristics, and initial networks of trainings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from visualrhp.observation import Observation, observation_class
from visualrhp.types import ActionSpaceName

if TYPE_CHECKING:
    from visualrhp.heuristics.networks import ActorCritic, QNetwork


def network_path(heuristics: str, action_space: str, observation: str, num_objects: int) -> Path:
    """Path of the network for scenes with ``num_objects`` objects in the folder ``heuristics``."""
    suffix = network_suffix(num_objects if observation_class(observation).fixes_num_objects else None)
    return Path(heuristics) / action_space / observation / f"heuristic{suffix}.safetensors"


def network_suffix(num_objects: int | None) -> str:
    """Suffix of the names of a network's files: empty, or ``_m4`` for a network for one number of objects."""
    return "" if num_objects is None else f"_m{num_objects}"


def load_start(path: Path, action_space: ActionSpaceName, expected: Observation) -> QNetwork | ActorCritic:
    """Load the initial network of a training.

    Raises:
        CheckpointError: it is missing or damaged, or has another action space or observation.
    """
    from visualrhp.errors import CheckpointError
    from visualrhp.heuristics.conversion import load_network

    network, _ = load_network(path, action_space)
    if network.observation != expected:
        raise CheckpointError(
            f"{path} reads {network.observation}, but observation={expected.name} needs {expected}; set "
            "heuristic=<folder> to a folder with networks for them"
        )
    return network
