"""Construction of planners from their configuration, with the trained networks that they need."""

from __future__ import annotations

from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from pipelines.config import CraftedHeuristicConfig, GreedyConfig, LearnedHeuristicConfig, RecedingHorizonConfig
from pipelines.networks import network_path
from visualrhp.heuristics.crafted import CostToGo, CraftedHeuristic
from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.planning import Greedy, Planner, RecedingHorizon
from visualrhp.planning.receding_horizon import RecedingHorizonParameters
from visualrhp.types import ActionSpaceName

AnyPlannerConfig = RecedingHorizonConfig | GreedyConfig | Planner
"""A member of :data:`pipelines.config.PlannerConfig`; those of the RRT family are planners themselves."""


def build_planner(
    config: AnyPlannerConfig, action_space: ActionSpaceName, heuristics: str, num_objects: int
) -> Planner:
    """Build the planner for scenes with ``num_objects`` objects; networks are loaded from the folder ``heuristics``.

    Raises:
        CheckpointError: a network is missing or damaged, or has another action space or observation.
    """
    if isinstance(config, Planner):
        return config
    heuristic = _build_heuristic(config.heuristic, action_space, heuristics, num_objects)
    if isinstance(config, GreedyConfig):
        return Greedy(heuristic, config.name)
    return RecedingHorizon(heuristic, **_parameters(config, RecedingHorizonParameters))


def needed_network(
    config: AnyPlannerConfig, action_space: ActionSpaceName, heuristics: str, num_objects: int
) -> Path | None:
    """Path of the network that a planner needs for scenes with ``num_objects`` objects; None if it needs none.

    An image network is for any number of objects, a Cartesian one for a fixed number (Sec. 7.5).
    """
    if isinstance(config, Planner) or not isinstance(config.heuristic, LearnedHeuristicConfig):
        return None
    return network_path(heuristics, action_space, config.heuristic.observation, num_objects)


def _build_heuristic(
    config: LearnedHeuristicConfig | CraftedHeuristicConfig,
    action_space: ActionSpaceName,
    heuristics: str,
    num_objects: int,
) -> Heuristic:
    if isinstance(config, CraftedHeuristicConfig):
        return CraftedHeuristic(action_space, CostToGo(**_parameters(config, CostToGo)))
    path = network_path(heuristics, action_space, config.observation, num_objects)
    return load_once(path, _version(path), action_space, config.temperature)


def _parameters(config: object, schema: type) -> dict[str, Any]:
    """The fields of ``schema`` in its extension ``config``."""
    return {entry.name: getattr(config, entry.name) for entry in fields(schema)}  # pyright: ignore[reportArgumentType]


@lru_cache(maxsize=32)
def load_once(path: Path, version: tuple[int, int], action_space: ActionSpaceName, temperature: float) -> Heuristic:
    """Load a network once per process; ``version`` changes with the file."""
    from visualrhp.heuristics.checkpoint import load_heuristic

    return load_heuristic(path, expect_action_space=action_space, temperature=temperature)


def _version(path: Path) -> tuple[int, int]:
    return (path.stat().st_mtime_ns, path.stat().st_size) if path.is_file() else (0, 0)
