"""Paths of trained networks within a folder of heuristics."""

from __future__ import annotations

from pathlib import Path

from visualrhp.observation import observation_class


def network_path(folder: Path, action_space: str, observation: str, num_objects: int) -> Path:
    """Path of the network for scenes with ``num_objects`` objects in a folder of heuristics."""
    suffix = network_suffix(num_objects if observation_class(observation).fixes_num_objects else None)
    return folder / action_space / observation / f"heuristic{suffix}.safetensors"


def network_suffix(num_objects: int | None) -> str:
    """Suffix of the names of a network's files: empty, or ``_m4`` for a network for one number of objects."""
    return "" if num_objects is None else f"_m{num_objects}"
