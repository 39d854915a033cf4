"""How well a planner does: episodes on unseen tasks, metrics with intervals, and the paper's figures."""

from visualrhp.evaluation.episodes import EpisodeResult, evaluate_policy, run_episode, run_task
from visualrhp.evaluation.metrics import Estimate, evaluation_metrics, mean_interval, summarize, wilson_interval

__all__ = [
    "EpisodeResult",
    "Estimate",
    "evaluate_policy",
    "evaluation_metrics",
    "mean_interval",
    "run_episode",
    "run_task",
    "summarize",
    "wilson_interval",
]
