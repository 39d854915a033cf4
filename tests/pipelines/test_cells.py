"""Cells of evaluations: measured once."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipelines import evaluate as pipeline
from pipelines.cells import Cells
from pipelines.config import EvaluateConfig
from pipelines.networks import NetworkFile
from pipelines.points import Point, compose_points, prepare
from pipelines.workflow import artefacts
from pipelines.workflow.app import compose
from pipelines.workflow.tracking import open_run
from tests.evaluation.samples import sample_result
from visualrhp.evaluation.episodes import episode_row, read_episodes

SETTINGS = ("scale=smoke", "tracking=none", "executor.num_workers=1", "scene.num_objects=1", "num_episodes=2")


def point(*overrides: str, networks: dict[int, NetworkFile] | None = None) -> Point:
    config = compose("evaluate", EvaluateConfig, [*SETTINGS, "planner=crafted_heuristic_rhp", *overrides])
    return Point("single", config, episodes=(0, 1), networks=networks or {})


def rows(*indices: int) -> dict[int, dict[str, Any]]:
    return {index: episode_row(sample_result("dropped", num_actions=3 + index)) for index in indices}


def test_what_was_kept_is_finished_and_nothing_is_lost(tmp_path: Path) -> None:
    cells = Cells(tmp_path / "cells")
    assert cells.finished(point()) == {}
    cells.keep(point(), rows(0, 1))
    cells.keep(point(), rows(1, 2))
    found = Cells(tmp_path / "cells").finished(point())
    assert list(found) == [0, 1, 2]
    assert [found[index]["num_actions"] for index in found] == [3, 4, 5]
    assert {name: type(value) for name, value in found[0].items()} == {
        name: type(value) for name, value in rows(0)[0].items()
    }


def test_a_cell_is_known_by_what_its_results_depend_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not by the number of episodes, the place of networks or the workers, but by their content and by the code."""
    own = point().cell
    assert point("num_episodes=7", "executor.num_workers=2", "heuristics=pretrained", "reuse=false").cell == own
    others = [
        point(override).cell for override in ("seed=1", "planner.horizon=2", "noise_level=low", "physics.iterations=9")
    ]
    network, same, trained = (
        NetworkFile(name, sha256, b"") for name, sha256 in (("a", "12"), ("b", "12"), ("a", "34"))
    )
    assert point(networks={1: network}).cell == point(networks={1: same}).cell
    others += [point(networks={1: network}).cell, point(networks={1: trained}).cell, point(networks={2: network}).cell]
    monkeypatch.setattr(artefacts, "code_hash", lambda: "other code")
    others.append(point().cell)
    assert len({own, *others}) == 1 + len(others)


def test_a_damaged_cell_is_run_again(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    cells = Cells(tmp_path)
    cells.keep(point(), rows(0, 1))
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:200])
    with caplog.at_level(logging.WARNING):
        assert cells.finished(point()) == {}
    assert path.name in caplog.text and "are run again" in caplog.text
    cells.keep(point(), rows(0, 1))
    assert list(cells.finished(point())) == [0, 1]


def test_an_evaluation_with_another_planner_runs_that_planner_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: list[tuple[int, int]] = []

    def run_unit(unit: pipeline.Unit) -> tuple[str, dict[str, Any]]:
        horizon = unit.config.planner.horizon or 0
        runs.append((horizon, unit.episode))
        return unit.key, episode_row(sample_result(num_objects=1, num_actions=1 + horizon + unit.episode))

    def evaluate(horizons: list[int], work: str, num_episodes: int = 2, reuse: bool = True) -> list[int]:
        block = {"planner": ["crafted_heuristic_rhp"], "planner.horizon": horizons}
        config = replace(point().config, num_episodes=num_episodes, suite={"block": block})
        (tmp_path / work).mkdir()
        with open_run(config, "evaluate", "test") as run:
            cells = Cells(tmp_path / "cells", reuse)
            folder = pipeline.evaluate(config, prepare(compose_points(config)), tmp_path / work, cells, run)
        return read_episodes(folder / "episodes.parquet")["num_actions"].tolist()

    monkeypatch.setattr(pipeline, "run_unit", run_unit)
    assert evaluate([1], "first") == [2, 3]
    assert evaluate([1, 2], "second") == [2, 3, 3, 4]
    assert runs == [(1, 0), (1, 1), (2, 0), (2, 1)]
    assert evaluate([1, 2], "more", num_episodes=3) == [2, 3, 4, 3, 4, 5]
    assert runs[4:] == [(1, 2), (2, 2)]
    assert evaluate([1], "again", reuse=False) == [2, 3]
    assert runs[6:] == [(1, 0), (1, 1)]
