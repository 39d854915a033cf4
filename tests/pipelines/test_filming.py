"""The videos of the report: every planner on the same scenes, and what is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.config import ReportConfig
from pipelines.filming import film, film_task, scene_sizes, video_tasks
from pipelines.workflow.app import compose
from visualrhp.errors import CheckpointError


def configure(outputs: Path, *overrides: str) -> ReportConfig:
    settings = ["scale=smoke", "tracking=none", "executor.num_workers=1", f"paths.outputs={outputs}"]
    return compose("report", ReportConfig, [*settings, *overrides])


def test_every_planner_is_filmed_on_every_scene(tmp_path: Path) -> None:
    config = configure(
        tmp_path, "videos.planners=[kinodynamic_rrt,crafted_heuristic_rhp]", "videos.num_scenes=3", "seed=5"
    )
    assert scene_sizes(config) == {0: 4, 1: 7, 2: 4}
    tasks = video_tasks(config, tmp_path)
    found = {
        (task.scene_index, task.config.scene.num_objects[0], task.config.action_space.name, task.config.planner.name)
        for task in tasks
    }
    assert len(found) == len(tasks) == 3 * 2 * 2
    assert {(index, m) for index, m, _, _ in found} == {(0, 4), (1, 7), (2, 4)}
    assert {task.config.seed for task in tasks} == {5}


def test_videos_need_the_networks_of_their_planners(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"heuristic\.safetensors"):
        video_tasks(configure(tmp_path, "videos.planners=[greedy]"), tmp_path)
    (first, *_) = video_tasks(configure(tmp_path, "videos.planners=[cartesian_rhp]"), tmp_path)
    attempt = film_task(first)
    assert (attempt.film, attempt.description) == (None, "CartesianRHP 3x3: no network for 4 objects")


def test_without_scenes_nothing_is_written(tmp_path: Path) -> None:
    config = configure(tmp_path, "videos.num_scenes=0")
    assert film(config, video_tasks(config, tmp_path), tmp_path / "videos") == []
    assert not (tmp_path / "videos").exists()
