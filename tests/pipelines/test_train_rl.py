"""Reinforcement learning of one small network: what is published, resuming after a kill, and inputs that do not fit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from pipelines.config import TrainRLConfig
from pipelines.train_rl import make_learner, read_inputs, train_part
from pipelines.training import parts_of
from pipelines.workflow.app import compose
from pipelines.workflow.executor import single_threaded
from visualrhp.errors import CheckpointError
from visualrhp.heuristics.conversion import load_network, save_heuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.observation import make_observation


@pytest.fixture(autouse=True)
def one_thread():
    with single_threaded():
        yield


@pytest.fixture
def outputs(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    for action_space in ("continuous", "discrete"):
        for observation, num_objects, suffix in (("cartesian", 1, "_m1"), ("image", None, "")):
            network = make_network(action_space, make_observation(observation, num_objects))
            folder = tmp_path / "train_il" / action_space / observation
            save_heuristic(folder / f"heuristic{suffix}.safetensors", network)
    return tmp_path


def configure(outputs: Path, *overrides: str) -> TrainRLConfig:
    shared = ["scale=smoke", "tracking=none", "executor.num_workers=1", f"paths.outputs={outputs}"]
    return compose("train_rl", TrainRLConfig, [*shared, "observation=cartesian", *overrides])


def weights(path: Path) -> dict[str, torch.Tensor]:
    return load_network(path)[0].state_dict()


def test_a_killed_training_resumes_to_the_same_networks(outputs, monkeypatch):
    monkeypatch.setattr("pipelines.train_rl.SAVE_INTERVAL_S", 0.0)
    config = configure(outputs, "learner.iterations=3", "learner.lr=1e-3")
    (part,) = parts_of(config)
    folders = outputs / "whole", outputs / "killed"
    rows = list(train_part(config, part, folders[0]))
    assert [row["iteration"] for row in rows] == [0.0, 1.0, 2.0, 3.0]
    killed = train_part(config, part, folders[1])
    next(killed), next(killed)
    killed.close()
    assert [row["iteration"] for row in train_part(config, part, folders[1])] == [2.0, 3.0]
    for name in ("last", "heuristic"):
        whole, resumed = (weights(folder / f"{name}.safetensors") for folder in folders)
        assert all(torch.equal(whole[key], resumed[key]) for key in whole)
    metrics = json.loads((folders[0] / "metrics.json").read_text())
    assert metrics["iterations"] == 3 and metrics["transitions"] == 120
    assert {"initial", "best", "last"} <= metrics.keys()
    assert json.loads((folders[0] / "last.json").read_text())["card"]["iteration"] == 3


def test_without_validation_the_last_network_is_published(outputs):
    config = configure(outputs, "validation.num_instances=0", "learner.lr=1e-3")
    (part,) = parts_of(config)
    (row,) = train_part(config, part, outputs / "work")
    assert not any(name.startswith("greedy/") for name in row)
    published, last = (weights(outputs / "work" / f"{stem}.safetensors") for stem in ("heuristic", "last"))
    start = weights(outputs / "train_il/continuous/cartesian/heuristic_m1.safetensors")
    assert all(torch.equal(published[key], last[key]) for key in last)
    assert not all(torch.equal(published[key], start[key]) for key in start)


def test_networks_that_do_not_fit_are_refused_before_any_work(outputs):
    with pytest.raises(CheckpointError, match=r"_m1\.safetensors"):
        read_inputs(configure(outputs, f"heuristic={outputs}/nowhere"))
    other_space = outputs / "train_il/discrete/cartesian"
    with pytest.raises(CheckpointError, match="action_space=discrete"):
        read_inputs(configure(outputs, f"heuristic={other_space}"))
    image = outputs / "train_il/continuous/image"
    (image / "heuristic.safetensors").rename(image / "heuristic_m1.safetensors")
    with pytest.raises(CheckpointError, match="one for cartesian observations of 1 objects is needed"):
        read_inputs(configure(outputs, f"heuristic={image}"))


@pytest.mark.parametrize("algorithm", ["c3po", "ppo"])
def test_the_learner_gets_the_configured_parameters(outputs, algorithm):
    config = configure(outputs, f"learner={algorithm}", "learner.clip_epsilon=0.03", "learner.num_envs=4")
    learner = make_learner(config, parts_of(config)[0])
    assert learner.config.clip_epsilon == 0.03  # pyright: ignore[reportAttributeAccessIssue]
    assert learner.config.baseline_step is (algorithm == "c3po")  # pyright: ignore[reportAttributeAccessIssue]
