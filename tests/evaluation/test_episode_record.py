"""An episode as JSON."""

from __future__ import annotations

import json
import math

import numpy as np

from visualrhp.evaluation.episode_record import episode_record
from visualrhp.evaluation.films import imagined_paths
from visualrhp.execution import EpisodeResult, TimedDecision
from visualrhp.planning import Decision, Rollout
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.streams import Split
from visualrhp.types import Episode, Outcome

TASK = sample_task_instance(SceneDistribution(num_objects=2), 0, Split.TUNING, 0)
STATE, ACTION = TASK.state, np.zeros(4)
BAD = Rollout((ACTION,), (STATE,), (), math.nan, -math.inf)
GOOD = Rollout((ACTION,), (STATE, STATE), (-1.0,), -4.0, -4.98)


def result(*rollouts: Rollout, chosen: int | None = None) -> EpisodeResult:
    decision = TimedDecision(STATE, Decision(ACTION, rollouts, 1, chosen=chosen), 0.5)
    return EpisodeResult(TASK.scene, Episode((STATE,), (), (), Outcome.DIVERGED), (decision,), 0.1)


def test_roll_outs_that_diverge_are_null() -> None:
    episode = result(BAD, GOOD, GOOD, chosen=1)
    assert [path.is_chosen for path in imagined_paths(episode.decisions[0].decision)] == [False, True, False]
    record = episode_record(episode)
    (decision,) = record["decisions"]
    assert decision["chosen_rollout"] == 1
    assert [rollout["origin"] for rollout in decision["rollouts"]] == ["policy"] * 3
    assert [rollout["total_return"] for rollout in decision["rollouts"]] == [None, -4.98, -4.98]
    assert [rollout["value_estimate"] for rollout in decision["rollouts"]] == [None, -4.0, -4.0]
    assert (record["outcome"], record["num_actions"], record["decision_time_s"]) == ("diverged", 0, 0.5)
    json.dumps(record, allow_nan=False)


def test_a_decision_may_choose_no_roll_out() -> None:
    episode = result(BAD, BAD)
    assert not any(path.is_chosen for path in imagined_paths(episode.decisions[0].decision))
    assert episode_record(episode)["decisions"][0]["chosen_rollout"] is None
