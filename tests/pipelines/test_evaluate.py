"""Evaluating: the same outcomes whatever happens on the way, and every episode once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from pipelines import evaluate as pipeline
from pipelines.app import compose
from pipelines.config import EvaluateConfig, ExecutorConfig
from pipelines.tracking import open_run
from visualrhp.environments.task import ObservationFunction
from visualrhp.errors import CheckpointError, ConfigError, DataError
from visualrhp.evaluation.metrics import EPISODE_COLUMNS
from visualrhp.heuristics.checkpoint import save_heuristic
from visualrhp.heuristics.networks import make_network

SETTINGS = (
    "scale=smoke",
    "tracking=none",
    "executor.num_workers=1",
    "planner=crafted_heuristic_rhp",
    "planner.num_rollouts=2",
    "planner.horizon=1",
    "num_episodes=3",
    "scene.num_objects=[1,3]",
)
TIMES = ["decision_time_s", "mean_decision_time_s", "simulation_time_s", "execution_time_s"]


def configure(*overrides: str, suite: dict[str, dict[str, Any]] | None = None) -> EvaluateConfig:
    return replace(compose("evaluate", EvaluateConfig, [*SETTINGS, *overrides]), suite=suite)


def evaluate(work: Path, config: EvaluateConfig) -> Path:
    work.mkdir(parents=True, exist_ok=True)
    with open_run(config, "evaluate", "test") as run:
        return pipeline.evaluate(config, pipeline.prepare(pipeline.compose_points(config)), work, run)


def episodes_in(artefact: Path) -> pd.DataFrame:
    return pd.read_parquet(artefact / "episodes.parquet")


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    return episodes_in(evaluate(tmp_path_factory.mktemp("reference"), configure()))


@pytest.fixture(scope="module")
def heuristics(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Untrained networks: images, and Cartesian poses for one and two objects."""
    folder = tmp_path_factory.mktemp("heuristics")
    with torch.random.fork_rng():
        torch.manual_seed(0)
        (folder / "continuous" / "image").mkdir(parents=True)
        (folder / "continuous" / "cartesian").mkdir()
        image = make_network("continuous", ObservationFunction("image"))
        save_heuristic(folder / "continuous" / "image" / "heuristic.safetensors", image)
        for m in (1, 2):
            cartesian = make_network("continuous", ObservationFunction("cartesian", m))
            save_heuristic(folder / "continuous" / "cartesian" / f"heuristic_m{m}.safetensors", cartesian)
    return folder


def test_the_table_has_a_row_an_episode_and_the_columns_of_the_specification(reference: pd.DataFrame) -> None:
    assert set(EPISODE_COLUMNS) <= set(reference.columns)
    assert reference["episode"].tolist() == [0, 1, 2]
    assert set(reference["planner"]) == {"CraftedHeuristicRHP"}
    assert set(reference["num_rollouts"]) == {2} and set(reference["horizon"]) == {1}
    assert set(reference["scene_num_objects"]) == {"1-3"}
    completed = reference.loc[reference["success"]]
    np.testing.assert_allclose(completed["action_efficiency"], completed["num_objects"] / completed["num_actions"])
    np.testing.assert_allclose(
        reference["execution_time_s"], reference["decision_time_s"] + reference["simulation_time_s"]
    )


def test_outcomes_do_not_depend_on_the_workers(tmp_path: Path, reference: pd.DataFrame) -> None:
    config = configure()
    parallel = replace(config, executor=ExecutorConfig("loky", 2, None))
    episodes = episodes_in(evaluate(tmp_path, parallel))
    pd.testing.assert_frame_equal(episodes.drop(columns=TIMES), reference.drop(columns=TIMES))


def test_a_killed_evaluation_goes_on(tmp_path: Path, reference: pd.DataFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    run_unit = pipeline.run_unit

    def killed(unit: pipeline.Unit) -> Any:
        if unit.episode == 2:
            raise KeyboardInterrupt
        return run_unit(unit)

    monkeypatch.setattr(pipeline, "run_unit", killed)
    with pytest.raises(KeyboardInterrupt):
        evaluate(tmp_path, configure())
    assert not (tmp_path / "artefact").exists()
    parts = tmp_path / "episodes.jsonl"
    parts.write_text(parts.read_text() + '["half a li')

    def counted(unit: pipeline.Unit) -> Any:
        seen.append(unit.episode)
        return run_unit(unit)

    seen: list[int] = []
    monkeypatch.setattr(pipeline, "run_unit", counted)
    episodes = episodes_in(evaluate(tmp_path, configure()))
    assert seen == [2]
    pd.testing.assert_frame_equal(episodes.drop(columns=TIMES), reference.drop(columns=TIMES))
    assert all(json.loads(line) for line in parts.read_text().splitlines())


def test_a_suite_is_the_product_of_its_values_and_counts_no_episode_twice() -> None:
    suite = {
        "noise": {"noise_level": ["none", "high"], "scene.num_objects": [1, [1, 2]]},
        "again": {"scene.num_objects": [[1, 2]], "num_episodes": [5]},
    }
    points = pipeline.compose_points(configure(suite=suite))
    found = [(p.experiment, p.config.noise_level, p.config.scene.num_objects, p.config.num_episodes) for p in points]
    assert found == [
        ("noise", "none", (1, 1), 3),
        ("noise", "none", (1, 2), 5),  # the other block has the same tasks, and more of them
        ("noise", "high", (1, 1), 3),
        ("noise", "high", (1, 2), 3),
    ]
    assert {p.config.planner.name for p in points} == {"CraftedHeuristicRHP"}
    assert len({p.identity for p in points}) == 4


def test_a_wrong_key_in_a_suite_is_an_error_before_any_work() -> None:
    with pytest.raises(ConfigError, match="noise"):
        pipeline.compose_points(configure(suite={"block": {"noise": ["high"]}}))


def test_every_planner_meets_the_same_tasks(tmp_path: Path, heuristics: Path) -> None:
    suite = {"block": {"planner": ["greedy", "crafted_heuristic_rhp"], "scene.num_objects": [[1, 2]]}}
    config = replace(configure(suite=suite), heuristics=str(heuristics), num_episodes=4)
    artefact = evaluate(tmp_path, config)
    episodes = episodes_in(artefact)
    by_planner = {name: rows["num_objects"].tolist() for name, rows in episodes.groupby("planner")}
    assert by_planner["Greedy"] == by_planner["CraftedHeuristicRHP"]
    greedy = episodes.loc[episodes["planner"] == "Greedy"]
    assert np.all(pd.isna(greedy["horizon"]))
    metrics = json.loads((artefact / "metrics.json").read_text())
    assert set(metrics["continuous"]) == {"Greedy", "CraftedHeuristicRHP 8x4"}
    assert metrics["continuous"]["Greedy"]["success_rate"] == pytest.approx(greedy["success"].mean())
    card = json.loads((artefact / "evaluation.json").read_text())
    assert set(card["networks"]) == {"continuous/image/heuristic.safetensors"}
    assert len(set(pd.read_csv(artefact / "by_density.csv")["label"])) == 2


def cartesian(heuristics: Path, *overrides: str) -> EvaluateConfig:
    config = compose(
        "evaluate", EvaluateConfig, [*SETTINGS[:3], "planner=cartesian_rhp", "num_episodes=12", *overrides]
    )
    return replace(config, heuristics=str(heuristics))


def test_densities_without_a_network_are_skipped_and_counted(
    heuristics: Path, caplog: pytest.LogCaptureFixture
) -> None:
    points = pipeline.prepare(pipeline.compose_points(cartesian(heuristics, "scene.num_objects=[1,3]")))
    (point,) = points
    assert sorted(point.episodes + point.skipped) == list(range(12))
    assert point.episodes and point.skipped
    assert f"no network for 3 objects: {len(point.skipped)} of 12" in caplog.text


def test_networks_that_are_missing_or_of_another_kind_are_an_error_before_any_work(heuristics: Path) -> None:
    with pytest.raises(CheckpointError, match=r"heuristic_m5\.safetensors"):
        pipeline.prepare(pipeline.compose_points(cartesian(heuristics, "scene.num_objects=5")))
    with pytest.raises(CheckpointError, match="discrete"):
        pipeline.prepare(pipeline.compose_points(cartesian(heuristics, "planner=greedy", "action_space=discrete")))
    suite = {"block": {"planner": ["cartesian_rhp"], "scene.num_objects": [5, 6]}}
    points = pipeline.compose_points(replace(configure(suite=suite), heuristics=str(heuristics)))
    with pytest.raises(DataError, match="nothing can be evaluated"):
        pipeline.prepare(points)


@pytest.fixture(autouse=True)
def forget_networks() -> Iterator[None]:
    """Networks of a test's own folder do not stay loaded."""
    yield
    from pipelines import planners

    planners._load.cache_clear()
