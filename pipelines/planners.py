"""From a planner's configuration to the planner, with the trained networks that it needs."""

from __future__ import annotations

from dataclasses import asdict
from functools import lru_cache
from pathlib import Path

from pipelines.config import (
    ClosedLoopKRRTConfig,
    CraftedHeuristicConfig,
    DHRRTConfig,
    GreedyConfig,
    KinodynamicRRTConfig,
    LearnedHeuristicConfig,
    PlannerConfig,
    RecedingHorizonConfig,
)
from visualrhp.heuristics.crafted import CostToGo, CraftedHeuristic
from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.planning import DHRRT, ClosedLoopKRRT, Greedy, KinodynamicRRT, Planner, RecedingHorizon
from visualrhp.types import ActionSpaceName


def build_planner(config: PlannerConfig, action_space: ActionSpaceName, heuristics: str, num_objects: int) -> Planner:
    """The planner for scenes of ``num_objects`` objects; networks come from the folder ``heuristics``.

    Raises:
        CheckpointError: a network is missing, damaged or made for something else.
        ConfigError: a parameter is out of range.
    """
    match config:
        case RecedingHorizonConfig():
            heuristic = _build_heuristic(config.heuristic, action_space, heuristics, num_objects)
            return RecedingHorizon(
                heuristic, config.num_rollouts, config.horizon, config.discount, config.name, config.deadline_s
            )
        case GreedyConfig():
            return Greedy(_build_heuristic(config.heuristic, action_space, heuristics, num_objects))
        case KinodynamicRRTConfig():
            return _build_rrt(config)
        case ClosedLoopKRRTConfig():
            return ClosedLoopKRRT(_build_rrt(config.rrt), config.keep_plan)
        case DHRRTConfig():
            return DHRRT(_build_rrt(config.rrt), config.progress)


def needed_network(
    config: PlannerConfig, action_space: ActionSpaceName, heuristics: str, num_objects: int
) -> Path | None:
    """File of the network that a planner needs for scenes of ``num_objects`` objects; None if it needs none.

    An image network serves every density, a Cartesian one its own (Sec. 7.5).
    """
    if isinstance(config, KinodynamicRRTConfig | ClosedLoopKRRTConfig | DHRRTConfig):
        return None
    if isinstance(config.heuristic, CraftedHeuristicConfig):
        return None
    representation = config.heuristic.representation
    stem = "heuristic" if representation == "image" else f"heuristic_m{num_objects}"
    return Path(heuristics) / action_space / representation / f"{stem}.safetensors"


def _build_rrt(config: KinodynamicRRTConfig) -> KinodynamicRRT:
    parameters = asdict(config)
    del parameters["algorithm"], parameters["name"]
    return KinodynamicRRT(**parameters)


def _build_heuristic(
    config: LearnedHeuristicConfig | CraftedHeuristicConfig,
    action_space: ActionSpaceName,
    heuristics: str,
    num_objects: int,
) -> Heuristic:
    if isinstance(config, CraftedHeuristicConfig):
        weights = asdict(config)
        del weights["kind"]
        return CraftedHeuristic(action_space, CostToGo(**weights))
    stem = "heuristic" if config.representation == "image" else f"heuristic_m{num_objects}"
    path = Path(heuristics) / action_space / config.representation / f"{stem}.safetensors"
    return _load(path, _version(path), action_space, config.temperature)


@lru_cache(maxsize=32)
def _load(path: Path, version: tuple[int, int], action_space: ActionSpaceName, temperature: float) -> Heuristic:
    """Load a network once in a process; ``version`` changes when the file does."""
    from visualrhp.heuristics.checkpoint import load_heuristic  # imported late: the other planners do without torch

    return load_heuristic(path, expect_action_space=action_space, temperature=temperature)


def _version(path: Path) -> tuple[int, int]:
    return (path.stat().st_mtime_ns, path.stat().st_size) if path.is_file() else (0, 0)
