"""Executing: an episode of a robot through the pipeline, its files, a dry run, and a table of many."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from pipelines import evaluate_execution
from pipelines import execute as pipeline
from pipelines.config import EvaluateExecutionConfig, ExecuteConfig
from pipelines.robot_episode import run_robot
from pipelines.robots import build_segmenter, open_robot
from pipelines.workflow.app import compose
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.perception import Perception
from visualrhp.errors import CellFault, CheckpointError, ConfigError, DataError, PerceptionError
from visualrhp.evaluation.episodes import read_episodes
from visualrhp.rendering.video import read_video

SETTINGS = (
    "scale=smoke",
    "segmenter=true_state",
    "planner=crafted_heuristic_rhp",
    "planner.num_rollouts=2",
    "planner.horizon=2",
    "cell.num_objects=2",
    "cell.varied_look=false",
)
VIDEO = ("video.size_px=64", "video.fps=2", "video.decision_s=0.5", "video.hold_s=0.5")


def configure(*overrides: str) -> ExecuteConfig:
    return compose("execute", ExecuteConfig, [*SETTINGS, *VIDEO, *overrides])


@pytest.fixture(scope="module")
def done() -> Any:
    return run_robot(configure("index=1"), 1)


def test_an_episode_is_run_through_joints_with_its_latencies(done: Any) -> None:
    result, summary = done.result, done.latency_summary
    assert result.outcome.value in ("success", "dropped", "out of actions", "unreachable")
    assert len(done.actions) == result.num_actions + 1
    assert done.true_end["success"] == (result.success and done.true_end["distance_to_target"] <= 0.07)
    assert summary["mean_path_s"] > 0.0 and summary["mean_decision_s"] > 0.0
    assert done.cell_time_s > 0.5 * result.num_actions and done.motions == ()
    text = pipeline.description(configure("index=1"), done)
    assert str(result.outcome) in text and "path" in text


def test_the_same_configuration_gives_the_same_episode(done: Any) -> None:
    again = run_robot(configure("index=1"), 1).result
    assert again.episode.states == done.result.episode.states and again.outcome == done.result.outcome


def test_a_dry_run_plans_and_moves_nothing() -> None:
    config = configure("index=1", "dry_run=true")
    dry = run_robot(config, 1, dry_run=True)
    assert len(dry.motions) == dry.result.num_actions > 0
    assert dry.true_end is None and dry.cell_time_s < 1.0


def test_the_pipeline_writes_a_video_and_a_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, done: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    config = configure("index=1", "tracking=none")
    pipeline.main.__wrapped__(config)  # type: ignore[attr-defined]
    stem = pipeline.file_stem(config)
    folder = tmp_path / "outputs" / "execute"
    assert sorted(path.name for path in folder.iterdir()) == [f"{stem}.json", f"{stem}.webm"]
    card = json.loads((folder / f"{stem}.json").read_text())
    assert card["stage"] == "execute" and card["outcome"] == done.result.outcome.value
    assert card["truth"] == done.true_end and len(card["latencies"]["actions"]) == card["num_actions"] + 1
    assert next(iter(read_video(folder / f"{stem}.webm"))).shape[1] == 3 * 64
    dry = configure("index=1", "tracking=none", "dry_run=true")
    pipeline.main.__wrapped__(dry)  # type: ignore[attr-defined]
    assert "joints at the end" in capsys.readouterr().out
    assert pipeline.file_stem(dry) != stem


def test_a_scenario_is_played_and_filmed() -> None:
    config = configure("scenario=low_clutter")
    episode = run_robot(config, 0, video=config.video)
    assert episode.result.num_objects == 3
    frames = list(episode.frames)
    shapes = {frame.shape for frame in frames}
    assert len(shapes) == 1 and next(iter(shapes))[1] == 3 * 64
    assert len(frames) > 3 * episode.result.num_actions
    assert "low_clutter" in pipeline.file_stem(config)


@pytest.mark.parametrize("which", [0, 1])
def test_the_desired_object_is_the_users(which: int) -> None:
    config = configure("cell.num_objects=6", "cell.kinds=[apple]", "cell.desired=[orange]", "desired=apple")
    config = replace(config, desired_which=which)
    robot = open_robot(config, 0)
    try:
        assert robot.simulated is not None
        truth = robot.simulated.truth()
        assert truth.kinds[robot.desired] is Kind.APPLE and robot.desired > 0
        mounting = robot.simulated.task.mounting
        distances = [
            ((x - mounting.x) ** 2 + (y - mounting.y) ** 2, number)
            for number, (x, y) in enumerate(truth.state.object_positions)
            if truth.kinds[number] is Kind.APPLE
        ]
        assert sorted(distances)[which][1] == robot.desired
    finally:
        robot.cell.close()


def test_the_desired_object_is_the_one_at_a_place() -> None:
    config = configure("cell.num_objects=6", "cell.kinds=[apple]", "cell.desired=[orange]", "desired=apple")
    for number in (2, 4):
        first = open_robot(config, 0)
        assert first.simulated is not None
        x, y = first.simulated.truth().state.object_positions[number].tolist()
        first.cell.close()
        robot = open_robot(replace(config, desired_place=(x + 0.01, y)), 0)
        assert robot.desired == number
        robot.cell.close()


def test_the_desired_object_of_a_task_is_named_by_its_place() -> None:
    robot = open_robot(configure("segmenter=true_masks", "cell.num_objects=6"), 0)
    assert robot.simulated is not None and isinstance(robot.perception, Perception)
    truth = robot.simulated.truth()
    desired = robot.perception.desired
    assert (desired.kind, desired.which) == (truth.kinds[0], 0)
    assert desired.place == pytest.approx(truth.state.desired_position, abs=0.0051)
    robot.cell.close()


def test_an_object_that_is_not_there_is_named() -> None:
    config = configure("cell.kinds=[apple]", "cell.desired=[apple]", "desired=cup")
    with pytest.raises(ConfigError, match="desired=cup desired_which=0: the cell has apple, apple"):
        open_robot(config, 0)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["segmenter=yolo"], "segmenter.file is missing"),
        (["desired=orang"], "desired"),
        (["desired_which=1"], "desired_which and desired_place are for a desired kind"),
        (["cell=ur_rtde"], "desired is missing"),
        (["cell=ur_rtde", "desired=cup"], "segmenter=true_state is of simulated cells only"),
        (["scenario=fig11"], "scenario='fig11': choose one of low_clutter"),
        (["safety.watchdog.max_view_age_s=0"], "safety.watchdog.max_view_age_s"),
    ],
)
def test_mistakes_in_the_configuration_are_named(overrides: list[str], words: str) -> None:
    settings = [s for s in SETTINGS if not (s.startswith("cell.") and overrides[0].startswith("cell="))]
    with pytest.raises(ConfigError, match=words):
        compose("execute", ExecuteConfig, [*settings, *VIDEO, *overrides])


def test_a_real_cell_needs_its_calibration() -> None:
    overrides = ["cell=ur_rtde", "desired=orange", "segmenter=released", "cell.calibration=/nowhere/camera.json"]
    config = compose("execute", ExecuteConfig, overrides)
    with pytest.raises(DataError, match=r"camera\.json"):
        open_robot(config, 0)


def test_a_missing_segmenter_is_named() -> None:
    config = compose("execute", ExecuteConfig, ["segmenter=released", "segmenter.file=/nowhere/net.onnx"])
    with pytest.raises(CheckpointError, match=r"net\.onnx"):
        build_segmenter(config.segmenter)


# ------------------------------------------------------------------------------------------------ many episodes
def configure_many(*overrides: str) -> EvaluateExecutionConfig:
    settings = [*SETTINGS, "num_episodes=2", "tracking=none", "executor.num_workers=1"]
    return compose("evaluate_execution", EvaluateExecutionConfig, [*settings, *overrides])


def test_many_episodes_are_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, done: Any) -> None:
    monkeypatch.chdir(tmp_path)
    config = configure_many()
    evaluate_execution.main.__wrapped__(config)  # type: ignore[attr-defined]
    folder = tmp_path / "outputs" / "evaluate_execution"
    episodes = read_episodes(folder / "episodes.parquet")
    assert episodes["episode"].tolist() == [0, 1] and set(episodes["experiment"]) == {"true_state"}
    assert episodes["outcome"][1] == done.result.outcome and episodes["num_actions"][1] == done.result.num_actions
    executions = pd.read_csv(folder / "executions.csv")
    assert executions["true_success"][1] == done.true_end["success"]
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["success_rate"] == pytest.approx(episodes["success"].mean())
    assert sum(rate for name, rate in metrics.items() if name.startswith("outcome/")) == pytest.approx(1.0)


@pytest.mark.parametrize("world", ["simulator", "arm", "friction"])
def test_the_tasks_run_in_the_planners_simulator_too(world: str) -> None:
    unit = evaluate_execution.Unit(configure_many(f"world={world}"), 1)
    key, row = evaluate_execution.run_unit(unit)
    assert key == "1" and row["episode"]["num_actions"] == row["execution"]["num_actions"] > 0
    assert row["execution"]["true_success"] == (row["episode"]["outcome"] == "success")
    assert evaluate_execution.setting_of(unit.config).experiment == world


@pytest.mark.parametrize("error", [CellFault("the arm does not answer"), PerceptionError("no orange")])
def test_a_robot_that_stops_at_its_first_look_is_a_row(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def failing(config: Any, index: int) -> Any:
        raise error

    monkeypatch.setattr("pipelines.robot_episode.run_robot", failing)
    unit = evaluate_execution.Unit(configure_many(), 1)
    key, row = evaluate_execution.run_unit(unit)
    assert (key, row["episode"]["outcome"], row["episode"]["num_objects"]) == ("1", "stopped", 2)
    assert row["execution"]["fault"] == str(error) and not row["execution"]["true_success"]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["desired=orange"], "desired must be null"),
        (["num_episodes=0"], "num_episodes"),
        (["world=arm", "segmenter=true_masks"], "world=arm needs segmenter=true_state"),
    ],
)
def test_mistakes_in_an_evaluation_are_named(overrides: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        configure_many(*overrides)
