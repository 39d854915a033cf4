"""The stage of expert iteration: networks of both kinds, resuming, and inputs that do not fit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from pipelines import expert_iteration as stage
from pipelines.config import ExpertIterationConfig
from pipelines.training import parts_of
from pipelines.workflow.app import compose
from pipelines.workflow.executor import single_threaded
from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.heuristics.checkpoint import read_network
from visualrhp.heuristics.conversion import save_heuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.observation import make_observation


@pytest.fixture(autouse=True)
def one_thread() -> Any:
    with single_threaded():
        yield


@pytest.fixture
def outputs(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    for action_space in ("continuous", "discrete"):
        for observation, num_objects, suffix in (("cartesian", 1, "_m1"), ("image", None, "")):
            network = make_network(action_space, make_observation(observation, num_objects))  # pyright: ignore[reportArgumentType]
            save_heuristic(
                tmp_path / "train_rl" / action_space / observation / f"heuristic{suffix}.safetensors", network
            )
    return tmp_path


def configure(outputs: Path, *overrides: str) -> ExpertIterationConfig:
    shared = ["scale=smoke", "tracking=none", "executor.num_workers=1", f"paths.outputs={outputs}"]
    return compose("expert_iteration", ExpertIterationConfig, [*shared, *overrides])


@pytest.mark.parametrize("observation", ["image", "cartesian"])
@pytest.mark.parametrize("space", ["continuous", "discrete"])
def test_a_network_is_published_with_its_origin(outputs: Path, space: str, observation: str) -> None:
    config = configure(outputs, f"action_space={space}", f"observation={observation}")
    (part,) = parts_of(config)
    folder = outputs / "work"
    rows = list(stage.train_part(config, part, folder))
    assert [row["round"] for row in rows] == [0.0, 1.0]
    stored = read_network(folder / "heuristic.safetensors")
    assert stored.card["stage"] == "expert_iteration" and stored.card["round"] in (0, 1)
    assert read_network(folder / "last.safetensors").card["round"] == 1
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert set(metrics) == {"rounds", "best_round", "initial", "best", "last"}
    assert "success_rate" in metrics["best"]["greedy"] and "score" in metrics["best"]["validation"]


def test_results_do_not_depend_on_the_number_of_workers(outputs: Path) -> None:
    one, two = (configure(outputs, f"executor.num_workers={count}") for count in (1, 2))
    (part,) = parts_of(one)
    first = list(stage.train_part(one, part, outputs / "one"))
    assert list(stage.train_part(two, part, outputs / "two")) == first


def test_the_clutter_grows_for_images_and_is_fixed_for_features(outputs: Path) -> None:
    image, cartesian = configure(outputs), configure(outputs, "observation=cartesian")
    assert stage.setting_of(image, parts_of(image)[0], 9).distribution.num_objects == (1, 9)
    assert stage.setting_of(cartesian, parts_of(cartesian)[0], 9).distribution.num_objects == (1, 1)


def test_what_does_not_fit_is_refused_before_any_work(outputs: Path) -> None:
    with pytest.raises(CheckpointError, match="nowhere"):
        stage.read_start_networks(configure(outputs, "heuristic=nowhere"))
    with pytest.raises(ConfigError, match="deadline_s"):
        configure(outputs, "planner.deadline_s=0.1")
    with pytest.raises(ConfigError, match="planner"):
        configure(outputs, "planner=greedy")
    with pytest.raises(ConfigError, match="learner"):
        configure(outputs, "learner/imitation=imitation_discrete")
