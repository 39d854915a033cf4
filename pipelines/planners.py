"""Construction of planners from their configuration, with the trained networks that they need."""

from __future__ import annotations

from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from pipelines.config import CraftedHeuristicConfig, GreedyConfig, LearnedHeuristicConfig, PlannerConfig
from pipelines.networks import network_path
from visualrhp.errors import CheckpointError
from visualrhp.heuristics.crafted import CostToGo, CraftedHeuristic
from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.observation import observation_class
from visualrhp.planning import Greedy, Planner, RecedingHorizon
from visualrhp.planning.decision_task import RecedingHorizonParameters
from visualrhp.types import ActionSpaceName


def build_planner(config: PlannerConfig, action_space: ActionSpaceName, heuristics: str, num_objects: int) -> Planner:
    """Build the planner for scenes with ``num_objects`` objects; networks are loaded from the folder ``heuristics``.

    Raises:
        CheckpointError: a network is missing (the message says how to train it) or damaged, or has another action space
            or observation.
    """
    if isinstance(config, Planner):  # the RRT family
        return config
    heuristic = _build_heuristic(config.heuristic, action_space, heuristics, num_objects)
    if isinstance(config, GreedyConfig):
        return Greedy(heuristic, config.name)
    return RecedingHorizon(heuristic, **parameters_of(config, RecedingHorizonParameters))


def needed_network(
    config: PlannerConfig, action_space: ActionSpaceName, heuristics: str, num_objects: int
) -> Path | None:
    """Path of the network that a planner needs for scenes with ``num_objects`` objects; None if it needs none.

    An image network is for any number of objects, a Cartesian one for a fixed number (Sec. 7.5).
    """
    if isinstance(config, Planner) or not isinstance(config.heuristic, LearnedHeuristicConfig):
        return None
    return network_path(heuristics, action_space, config.heuristic.observation, num_objects)


def fixes_num_objects(config: PlannerConfig) -> bool:
    """Whether a planner needs a network for each number of objects (CartesianRHP, Sec. 7.5)."""
    if isinstance(config, Planner) or not isinstance(config.heuristic, LearnedHeuristicConfig):
        return False
    return observation_class(config.heuristic.observation).fixes_num_objects


def _build_heuristic(
    config: LearnedHeuristicConfig | CraftedHeuristicConfig,
    action_space: ActionSpaceName,
    heuristics: str,
    num_objects: int,
) -> Heuristic:
    if isinstance(config, CraftedHeuristicConfig):
        return CraftedHeuristic(action_space, CostToGo(**parameters_of(config, CostToGo)))
    path = network_path(heuristics, action_space, config.observation, num_objects)
    if not path.is_file():
        arguments = f"action_space={action_space} observation={config.observation}"
        raise CheckpointError(
            f"the network {path} does not exist. Train it with python -m pipelines.generate_demos action_space="
            f"{action_space}, python -m pipelines.train_il {arguments} and python -m pipelines.train_rl {arguments}, "
            "in this order (or all networks with dvc repro); or use a folder that has it, as in "
            "heuristics=outputs/train_il; or choose planner=crafted_heuristic_rhp or planner=kinodynamic_rrt, which "
            "need no network"
        )
    return cached_heuristic(path, action_space, config.temperature)


def parameters_of(config: object, schema: type) -> dict[str, Any]:
    """The fields of ``schema`` in its extension ``config``."""
    return {entry.name: getattr(config, entry.name) for entry in fields(schema)}  # pyright: ignore[reportArgumentType]


def cached_heuristic(path: Path, action_space: ActionSpaceName, temperature: float) -> Heuristic:
    """Load the network in a file, once per process and version of the file."""
    version = (path.stat().st_mtime_ns, path.stat().st_size) if path.is_file() else (0, 0)
    return _load(path, version, action_space, temperature)


@lru_cache(maxsize=32)
def _load(path: Path, version: tuple[int, int], action_space: ActionSpaceName, temperature: float) -> Heuristic:
    """``version`` changes with the file."""
    from visualrhp.heuristics.checkpoint import load_heuristic

    return load_heuristic(path, expect_action_space=action_space, temperature=temperature)
