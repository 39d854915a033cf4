"""Evaluating: the same results with any interruption, and every episode once."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pipelines import evaluate as pipeline
from pipelines.cells import Cells
from pipelines.config import EvaluateConfig, ExecutorConfig
from pipelines.points import compose_points, prepare
from pipelines.workflow.app import compose
from pipelines.workflow.tracking import open_run
from visualrhp.evaluation.episodes import EPISODE_COLUMNS

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
TIMES = ["decision_time_s", "mean_decision_time_s", "max_decision_time_s", "simulation_time_s", "execution_time_s"]


def configure(*overrides: str, suite: dict[str, dict[str, Any]] | None = None) -> EvaluateConfig:
    return replace(compose("evaluate", EvaluateConfig, [*SETTINGS, *overrides]), suite=suite)


def evaluate(work: Path, config: EvaluateConfig) -> Path:
    work.mkdir(parents=True, exist_ok=True)
    with open_run(config, "evaluate", "test") as run:
        return pipeline.evaluate(config, prepare(compose_points(config)), work, Cells(work / "cells"), run)


def episodes_in(artefact: Path) -> pd.DataFrame:
    return pd.read_parquet(artefact / "episodes.parquet")


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    return episodes_in(evaluate(tmp_path_factory.mktemp("reference"), configure()))


def test_the_table_has_a_row_per_episode_and_the_columns_of_the_schema(reference: pd.DataFrame) -> None:
    assert list(reference.columns) == list(EPISODE_COLUMNS)
    assert reference["episode"].tolist() == [0, 1, 2]
    assert set(reference["planner"]) == {"CraftedHeuristicRHP"}
    assert set(reference["num_rollouts"]) == {2} and set(reference["horizon"]) == {1}
    assert set(reference["scene_num_objects"]) == {"1-3"}
    completed = reference.loc[reference["success"]]
    np.testing.assert_allclose(completed["action_efficiency"], completed["num_objects"] / completed["num_actions"])
    np.testing.assert_allclose(
        reference["execution_time_s"], reference["decision_time_s"] + reference["simulation_time_s"]
    )


def test_results_do_not_depend_on_the_workers(tmp_path: Path, reference: pd.DataFrame) -> None:
    config = configure()
    parallel = replace(config, executor=ExecutorConfig("loky", 2, None))
    episodes = episodes_in(evaluate(tmp_path, parallel))
    pd.testing.assert_frame_equal(episodes.drop(columns=TIMES), reference.drop(columns=TIMES))


def test_a_killed_evaluation_is_resumed(
    tmp_path: Path, reference: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_every_planner_is_run_on_the_same_tasks(tmp_path: Path, untrained_heuristics: Path) -> None:
    suite = {"block": {"planner": ["greedy", "crafted_heuristic_rhp"], "scene.num_objects": [[1, 2]]}}
    config = replace(configure(suite=suite), heuristics=str(untrained_heuristics), num_episodes=4)
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
    assert len(set(pd.read_csv(artefact / "by_num_objects.csv")["label"])) == 2


def test_a_network_that_is_replaced_meanwhile_has_no_effect(
    tmp_path: Path, untrained_heuristics: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heuristics = tmp_path / "heuristics"
    shutil.copytree(untrained_heuristics, heuristics)
    config = replace(configure(suite={"block": {"planner": ["greedy"]}}), heuristics=str(heuristics), num_episodes=4)
    expected = evaluate(tmp_path / "expected", config)
    run_unit = pipeline.run_unit

    def replaced(unit: pipeline.Unit) -> Any:
        for path in heuristics.rglob("*.safetensors"):
            path.write_bytes(b"another network")
        return run_unit(unit)

    monkeypatch.setattr(pipeline, "run_unit", replaced)
    found = evaluate(tmp_path / "work", config)
    columns = [name for name in EPISODE_COLUMNS if name not in TIMES]
    pd.testing.assert_frame_equal(episodes_in(found)[columns], episodes_in(expected)[columns])
    cards = [json.loads((folder / "evaluation.json").read_text()) for folder in (found, expected)]
    assert cards[0]["networks"] == cards[1]["networks"]
