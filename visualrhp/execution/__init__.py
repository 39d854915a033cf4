"""Execution: worlds that can be observed and acted on, and episodes in them."""

from visualrhp.execution.episode import (
    EpisodeListener,
    EpisodeResult,
    RunningEpisode,
    TimedDecision,
    run_episode,
    run_task,
)
from visualrhp.execution.world import SimulatedWorld, World, simulated_task

__all__ = [
    "EpisodeListener",
    "EpisodeResult",
    "RunningEpisode",
    "SimulatedWorld",
    "TimedDecision",
    "World",
    "run_episode",
    "run_task",
    "simulated_task",
]
