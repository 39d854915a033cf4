"""Construction of planners from their configuration, with the trained networks that they need."""

from __future__ import annotations

import logging
import os
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from pipelines.config import CraftedHeuristicConfig, GreedyConfig, LearnedHeuristicConfig, PlannerConfig
from pipelines.networks import network_path
from visualrhp.errors import CheckpointError
from visualrhp.heuristics.crafted import CostToGo, CraftedHeuristic
from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.observation import Observation, make_observation, observation_class
from visualrhp.planning import Greedy, Planner, RecedingHorizon
from visualrhp.planning.decision_task import RecedingHorizonParameters
from visualrhp.pretrained import pretrained_folder
from visualrhp.types import ActionSpaceName

_log = logging.getLogger(__name__)

RELEASED: Final = {"pretrained": pretrained_folder("best"), "pretrained_paper": pretrained_folder("paper")}
"""Names of the folders with the released networks."""


def build_planner(
    config: PlannerConfig, action_space: ActionSpaceName, num_objects: int, network: Path | None = None
) -> Planner:
    """Build the planner for scenes with ``num_objects`` objects.

    Args:
        config: the planner.
        action_space: of the planner.
        num_objects: m.
        network: file of its network (:func:`find_network`); None if it needs none.

    Raises:
        CheckpointError: the network is damaged, or has another action space or observation.
    """
    if isinstance(config, Planner):  # the RRT family
        return config
    heuristic = _build_heuristic(config.heuristic, action_space, num_objects, network)
    if isinstance(config, GreedyConfig):
        return Greedy(heuristic, config.name)
    return RecedingHorizon(heuristic, **parameters_of(config, RecedingHorizonParameters))


def find_network(
    config: PlannerConfig, action_space: ActionSpaceName, heuristics: str | None, num_objects: int
) -> Path | None:
    """The file of :func:`needed_network`, which exists.

    Raises:
        CheckpointError: it is missing (the message says how to train it) or is not a readable file.
    """
    from visualrhp.heuristics.checkpoint import NETWORK

    path = needed_network(config, action_space, heuristics, num_objects)
    if path is None:
        return None
    if os.path.lexists(path):
        NETWORK.require(path)
        return path
    assert not isinstance(config, Planner)
    assert isinstance(config.heuristic, LearnedHeuristicConfig)
    arguments = f"action_space={action_space} observation={config.heuristic.observation}"
    raise CheckpointError(
        f"the network {path} does not exist. Use the released networks, heuristics=pretrained; or train it with "
        f"python -m pipelines.generate_demos action_space={action_space}, "
        f"python -m pipelines.train_il {arguments}, "
        f"python -m pipelines.train_rl {arguments} and, for VisualRHP+, python -m pipelines.expert_iteration "
        f"{arguments}, in this order (or all networks with dvc repro); or use a folder that has it, as in "
        "heuristics=outputs/train_il; or choose planner=crafted_heuristic_rhp or planner=kinodynamic_rrt, which "
        "need no network"
    )


def needed_network(
    config: PlannerConfig, action_space: ActionSpaceName, heuristics: str | None, num_objects: int
) -> Path | None:
    """Path of the network that a planner needs for scenes with ``num_objects`` objects; None if it needs none.

    An image network is for any number of objects, a Cartesian one for a fixed number (Sec. 7.5).
    """
    if isinstance(config, Planner) or not isinstance(config.heuristic, LearnedHeuristicConfig):
        return None
    return _path(config.heuristic, action_space, heuristics, num_objects)


def released_where_untrained(
    config: PlannerConfig, action_space: ActionSpaceName, heuristics: str | None, num_objects: int
) -> str | None:
    """The folder of the networks: ``heuristics``; if it is None and nothing was trained, that of the released ones."""
    if heuristics is not None:
        return heuristics
    trained = needed_network(config, action_space, None, num_objects)
    if trained is not None and not os.path.lexists(trained):
        for folder in RELEASED:
            path = needed_network(config, action_space, folder, num_objects)
            if path is not None and path.is_file():
                _tell_released(trained, folder)
                return folder
    return None


@lru_cache(maxsize=1)
def _tell_released(trained: Path, folder: str) -> None:
    """Say once that a released network is used."""
    _log.info("There is no trained network %s; using the released one (heuristics=%s).", trained, folder)


def network_name(path: Path, outputs: str, heuristics: str | None) -> str:
    """Name of a network on cards: its path in the outputs, or else in ``heuristics``, or that of a released network."""
    folders = {**RELEASED, "": Path(outputs)}
    if heuristics is not None and not path.is_relative_to(outputs):
        folders.setdefault(".", Path(heuristics))
    for name, folder in folders.items():
        if path.is_relative_to(folder):
            return (Path(name) / path.relative_to(folder)).as_posix()
    return path.as_posix()


def fixes_num_objects(config: PlannerConfig) -> bool:
    """Whether a planner needs a network for each number of objects (CartesianRHP, Sec. 7.5)."""
    if isinstance(config, Planner) or not isinstance(config.heuristic, LearnedHeuristicConfig):
        return False
    return observation_class(config.heuristic.observation).fixes_num_objects


def _build_heuristic(
    config: LearnedHeuristicConfig | CraftedHeuristicConfig,
    action_space: ActionSpaceName,
    num_objects: int,
    network: Path | None,
) -> Heuristic:
    if isinstance(config, CraftedHeuristicConfig):
        return CraftedHeuristic(action_space, CostToGo(**parameters_of(config, CostToGo)))
    assert network is not None
    fixes = observation_class(config.observation).fixes_num_objects
    expected = make_observation(config.observation, num_objects if fixes else None)
    return cached_heuristic(network, action_space, expected, config.temperature)


def _path(
    config: LearnedHeuristicConfig, action_space: ActionSpaceName, heuristics: str | None, num_objects: int
) -> Path:
    folder = config.folder if heuristics is None else heuristics
    return network_path(RELEASED.get(folder, Path(folder)), action_space, config.observation, num_objects)


def parameters_of(config: object, schema: type) -> dict[str, Any]:
    """The fields of ``schema`` in its extension ``config``."""
    return {entry.name: getattr(config, entry.name) for entry in fields(schema)}  # pyright: ignore[reportArgumentType]


def cached_heuristic(path: Path, action_space: ActionSpaceName, expected: Observation, temperature: float) -> Heuristic:
    """Load the network in a file, once per process and version of the file.

    Raises:
        CheckpointError: the file is missing or damaged, or has another action space or observation.
    """
    version = (path.stat().st_mtime_ns, path.stat().st_size) if path.is_file() else (0, 0)
    return _load(path, version, action_space, expected, temperature)


@lru_cache(maxsize=32)
def _load(
    path: Path,
    version: tuple[int, int],
    action_space: ActionSpaceName,
    expected: Observation,
    temperature: float,
) -> Heuristic:
    """``version`` changes with the file."""
    from visualrhp.heuristics.checkpoint import load_heuristic

    return load_heuristic(path, action_space, temperature, expect_observation=expected)
