"""Keeping the best network, and the statistics of collected episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from tests.learning.corridor import Corridor, TinyQNetwork
from visualrhp.errors import CheckpointError, ConfigError, LearningError
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file
from visualrhp.learning.reinforcement import Collector, ReinforcementLearner
from visualrhp.types import Metrics


class Counting(ReinforcementLearner):
    """Writes the number of the iteration into the network."""

    def _iterate(self) -> Metrics:
        torch.nn.init.constant_(self.network.layers[0].bias, self.iteration + 1.0)
        return {}

    def _parts(self) -> dict[str, Any]:
        return {}


def scores(*successes: float):
    remaining = list(successes)
    return lambda _: {"success_rate": remaining.pop(0)}


def bias(network: torch.nn.Module) -> float:
    return network.layers[0].bias[0].item()


def test_the_best_network_may_be_the_first_and_the_earlier_of_equals_stays():
    learner = Counting(TinyQNetwork(), Corridor("discrete"), scores(0.6, 0.2, 0.7, 0.7, 0.1))
    rows = list(learner.run(1))
    assert [row["iteration"] for row in rows] == [0.0, 1.0]
    assert learner.best_iteration == 0 and bias(learner.best_network) != 1.0
    list(learner.run(4))
    assert learner.best_iteration == 2
    assert bias(learner.best_network) == 2.0 and bias(learner.network) == 4.0


def test_evaluations_come_at_the_interval_and_at_the_end():
    learner = Counting(TinyQNetwork(), Corridor("discrete"), scores(0.0, 0.1, 0.2, 0.3), evaluate_every=2)
    evaluated = [row["iteration"] for row in learner.run(5) if "greedy/success_rate" in row]
    assert evaluated == [0.0, 2.0, 4.0, 5.0]
    with pytest.raises(ConfigError, match="evaluate_every"):
        Counting(TinyQNetwork(), Corridor("discrete"), evaluate_every=0)


def test_the_best_network_survives_a_restart(tmp_path):
    learner = Counting(TinyQNetwork(), Corridor("discrete"), scores(0.1, 0.9, 0.2))
    list(learner.run(2))
    learner.save(tmp_path / "state.safetensors")
    resumed = Counting(TinyQNetwork(), Corridor("discrete"), scores(0.5))
    resumed.load(tmp_path / "state.safetensors")
    list(resumed.run(3))
    assert resumed.iteration == 3 and resumed.best_iteration == 1 and bias(resumed.best_network) == 1.0


def test_the_history_survives_a_restart_and_divergence_is_an_error(tmp_path):
    learner = Counting(TinyQNetwork(), Corridor("discrete"), scores(0.1, 0.9, 0.2, float("nan")))
    rows = list(learner.run(2))
    learner.save(tmp_path / "state.safetensors")
    resumed = Counting(TinyQNetwork(), Corridor("discrete"))
    resumed.load(tmp_path / "state.safetensors")
    assert resumed.history == rows
    with pytest.raises(LearningError, match="iteration 3: greedy/success_rate"):
        list(learner.run(3))


def test_episode_statistics_span_collections():
    collector = Collector(Corridor("discrete", num_envs=3))  # starts at 0, 0.25, 0.5: goals after 4, 3, 2 actions

    def right(step):
        return step.set("action", torch.zeros(3, dtype=torch.int64))

    _, first = collector.collect(right, 9)
    _, second = collector.collect(right, 3)
    assert first["collection/episodes"] == 2.0 and first["collection/return"] == -2.5
    assert second["collection/episodes"] == 2.0  # the slot that began at 0.5 starts there again
    assert second["collection/return"] == -3.0
    assert second["collection/success_rate"] == 1.0 and second["collection/dropped_rate"] == 0.0
    assert second["collection/transitions"] == 12.0

    def left(step):
        return step.set("action", torch.ones(3, dtype=torch.int64))

    _, dropped = Collector(Corridor("discrete", num_envs=3)).collect(left, 3)
    assert dropped["collection/episodes"] == 1.0 and dropped["collection/return"] == -50.0
    assert dropped["collection/dropped_rate"] == 1.0


def test_a_state_that_does_not_fit_says_what_to_delete(tmp_path):
    path = tmp_path / "state.safetensors"
    learner = Counting(TinyQNetwork(), Corridor("discrete"))
    list(learner.run(2))
    learner.save(path)
    arrays, document = read_tensor_file(path)
    ends = r"state\.safetensors .*delete this file and rerun the command"
    for change in (
        {"collector.returns": None},
        {"collector.returns": np.zeros(3, np.float32)},
        {"collector.returns": np.zeros(4, np.int64)},
        {"collector.num_transitions": np.zeros(2)},
        {"collector.num_transitions": np.array(-1)},
    ):
        names = {f"{name}/value": values for name, values in change.items()}
        changed = {name: values for name, values in (arrays | names).items() if values is not None}
        write_tensor_file(path, changed, document)
        with pytest.raises(CheckpointError, match=ends):
            Counting(TinyQNetwork(), Corridor("discrete")).load(path)
    for change in (
        {"iteration": {"kind": "value", "content": "2"}},
        {"iteration": {"kind": "value", "content": 1}},
        {"best_score": {"kind": "value", "content": ["a", 1]}},
        {"history": {"kind": "value", "content": {}}},
        {"history": {"kind": "array", "content": None}},
    ):
        write_tensor_file(path, arrays, document | change)
        with pytest.raises(CheckpointError, match=ends):
            Counting(TinyQNetwork(), Corridor("discrete")).load(path)
    write_tensor_file(path, arrays, document)
    with pytest.raises(CheckpointError, match=ends):
        Counting(TinyQNetwork(), Corridor("discrete", num_envs=3)).load(path)
    resumed = Counting(TinyQNetwork(), Corridor("discrete"))
    resumed.load(path)
    assert resumed.iteration == 2
