"""An episode as JSON: every decision with its roll-outs, returns and time."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from visualrhp.execution.episode import EpisodeResult, TimedDecision
from visualrhp.types import Action


def episode_record(result: EpisodeResult) -> dict[str, Any]:
    """The episode as JSON values; returns of roll-outs that diverged, and their value estimates, are null."""
    return {
        "outcome": result.outcome.value,
        "num_objects": result.num_objects,
        "num_actions": len(result.episode),
        "discounted_return": result.discounted_return,
        "num_invalid_rollouts": result.num_invalid_rollouts,
        "decision_time_s": result.decision_time_s,
        "decisions": [_decision_record(timed) for timed in result.decisions],
        "final_state": result.episode.states[-1].vector.tolist(),
        **({} if result.fault is None else {"fault": result.fault}),
    }


def _decision_record(timed: TimedDecision) -> dict[str, Any]:
    decision = timed.decision
    return {
        "state": timed.state.vector.tolist(),
        "action": _plain(decision.action),
        "time_s": timed.time_s,
        "timing": None if decision.timing is None else asdict(decision.timing),
        "num_invalid": decision.num_invalid,
        "chosen_rollout": decision.chosen,
        "rollouts": [
            {
                "actions": [_plain(action) for action in rollout.actions],
                "rewards": list(rollout.rewards),
                "value_estimate": _finite(rollout.value_estimate),
                "total_return": _finite(rollout.total_return),
                "origin": rollout.origin,
                "prior": _finite(rollout.prior),
                "robust_return": None if rollout.robust_return is None else _finite(rollout.robust_return),
            }
            for rollout in decision.rollouts
        ],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain(action: Action | None) -> int | list[float] | None:
    """An action as JSON."""
    return action if action is None or isinstance(action, int) else action.tolist()
