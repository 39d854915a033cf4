"""Evaluate planners (Sec. 7.3 and 8): ``python -m pipelines.evaluate``.

One setting or a suite of settings, on task instances that are not used in training. The artefact is a folder with

- ``episodes.parquet``: one row per episode (columns: :data:`visualrhp.evaluation.episodes.EPISODE_COLUMNS`);
- ``metrics.json``: the three metrics with their 90% intervals, by action space and method, for ``dvc metrics``;
- ``summary.csv``, ``by_num_objects.csv``, ``by_size.csv``, ``by_noise.csv``: the same by setting, for ``dvc plots``;
- ``paired.csv``: methods compared with those that search, on the same task instances;
- ``evaluation.json``: the card: evaluated and skipped settings, and the networks.
"""

from __future__ import annotations

import datetime
import logging
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.workflow.app import app

if TYPE_CHECKING:
    import pandas as pd

    from pipelines.cells import Cells, Rows
    from pipelines.config import EvaluateConfig
    from pipelines.points import Point
    from pipelines.workflow.tracking import Run

_log = logging.getLogger(__name__)

STAGE = "evaluate"

_JOURNAL = "episodes.jsonl"
_BAR = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
_SLOW = ("kinodynamic_rrt", "closed_loop_krrt", "dhrrt")


@dataclass(frozen=True)
class Unit:
    """One episode to run: the task of a worker.

    Attributes:
        identity: of the setting.
        config: the setting.
        episode: index of the task instance.
        networks: number of objects -> file of its network in the work folder.
    """

    identity: str
    config: EvaluateConfig = field(repr=False)
    episode: int
    networks: Mapping[int, Path] = field(default_factory=dict, repr=False)

    @property
    def key(self) -> str:
        """Key of the result in the journal."""
        return f"{self.identity}/{self.episode}"


@app(STAGE)
def main(config: EvaluateConfig) -> None:
    """Run the missing episodes, and publish the artefact."""
    from pipelines.cells import Cells
    from pipelines.points import compose_points, network_hashes, prepare
    from pipelines.workflow.artefacts import anchored_outputs
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work

    points = prepare(compose_points(config))
    inputs = network_hashes(points)
    name = "suite" if config.suite is not None else f"{config.planner.name} {config.action_space.name}"
    with open_work(config, STAGE, inputs) as work, open_run(config, STAGE, f"evaluate {name}", work) as run:
        cells = Cells(anchored_outputs(config) / "cells", config.reuse)
        publish(evaluate(config, points, work, cells, run), config.paths.artefact, STAGE)


def evaluate(config: EvaluateConfig, points: Sequence[Point], work: Path, cells: Cells, run: Run) -> Path:
    """Run the episodes that are missing in ``work`` and ``cells``, and summarize all; return the artefact's folder."""
    from tqdm import tqdm

    from pipelines.points import network_hashes
    from pipelines.workflow.artefacts import card
    from pipelines.workflow.executor import run_tasks, worker_count
    from pipelines.workflow.forecast import Forecast
    from pipelines.workflow.surroundings import machine
    from pipelines.workflow.workspace import empty_folder
    from visualrhp.evaluation.episodes import EpisodeRow, episodes_table, write_episodes
    from visualrhp.evaluation.journal import Journal
    from visualrhp.evaluation.summaries import duration, metrics_by_method, summary_lines, summary_tables
    from visualrhp.files import atomic_path, write_json

    journal = Journal(work / _JOURNAL, EpisodeRow)
    rows: dict[str, Rows] = {}  # of every point, by its identity
    missing: list[Unit] = []
    by_identity = {point.identity: point for point in points}
    for point in points:
        networks = {m: file.store(work / "networks") for m, file in point.networks.items()}
        rows[point.identity] = cells.finished(point)
        for unit in (Unit(point.identity, point.config, index, networks) for index in point.episodes):
            if unit.key in journal:
                rows[point.identity][unit.episode] = journal[unit.key]
            elif unit.episode not in rows[point.identity]:
                missing.append(unit)
    remaining = Counter(unit.identity for unit in missing)
    for point in points:
        if not remaining[point.identity]:
            cells.keep(point, rows[point.identity])
    num_episodes = sum(len(point.episodes) for point in points)
    if len(missing) < num_episodes:
        _log.info("%d episodes are finished, %d remain.", num_episodes - len(missing), len(missing))
    # One of each cell first, which tells how long all will take. Then slow ones, so that none runs alone at the end.
    first = {unit.identity: unit.key for unit in reversed(missing)}
    missing.sort(key=lambda unit: (unit.key != first[unit.identity], unit.config.planner.algorithm not in _SLOW))
    forecast = Forecast(remaining)
    started = time.perf_counter()
    results = run_tasks(run_unit, missing, config.executor)
    with tqdm(total=len(missing), desc="episodes", unit="episode", bar_format=_BAR) as progress:
        for key, row in results:
            journal.append(key, row)
            identity, _, index = key.partition("/")
            rows[identity][int(index)] = row
            remaining[identity] -= 1
            if not remaining[identity]:
                cells.keep(by_identity[identity], rows[identity])
            forecast.finished(identity, row["execution_time_s"])
            progress.set_postfix_str(f"{duration(forecast.remaining_s(time.perf_counter() - started))} remain", False)
            progress.update()
    wall_time = time.perf_counter() - started

    episodes = episodes_table(
        (point.setting, index, rows[point.identity][index]) for point in points for index in point.episodes
    )
    artefact = empty_folder(work / "artefact")
    write_episodes(artefact / "episodes.parquet", episodes)
    write_json(artefact / "metrics.json", metrics_by_method(episodes))
    for stem, table in summary_tables(episodes).items():
        with atomic_path(artefact / f"{stem}.csv") as path:
            table.to_csv(path, index=False, float_format="%.6g")
    content = {
        "points": [point.card for point in points],
        "networks": network_hashes(points),
        "num_episodes": len(episodes),
        "num_reused": num_episodes - len(missing),
        "wall_time_s": round(wall_time, 1),
        "num_workers": worker_count(config.executor),
        "machine": machine(),
        "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
    }
    write_json(artefact / "evaluation.json", card(config, STAGE, **content))
    log_to_tracker(run, episodes)
    run.log_artifact(artefact)
    _log.info("%s", summary_lines(episodes, len(points)))
    return artefact


def run_unit(unit: Unit) -> tuple[str, dict[str, Any]]:
    """Run one episode; return its key and its columns of the table."""
    from pipelines.planners import build_planner
    from visualrhp.evaluation.episodes import episode_row
    from visualrhp.execution.episode import run_task
    from visualrhp.scene import NOISE_LEVELS, sample_task_instance
    from visualrhp.simulation import make_action_space
    from visualrhp.streams import Split

    config, space = unit.config, unit.config.action_space.name
    instance = sample_task_instance(config.scene, config.seed, Split.EVALUATION, unit.episode)
    num_objects = instance.scene.num_objects
    result = run_task(
        build_planner(config.planner, space, num_objects, unit.networks.get(num_objects)),
        instance,
        config.seed,
        Split.EVALUATION,
        unit.episode,
        action_space=make_action_space(space),
        physics=config.physics,
        noise=NOISE_LEVELS[config.noise_level],
    )
    return unit.key, episode_row(result)


def log_to_tracker(run: Run, episodes: pd.DataFrame) -> None:
    """Log one child run per method and setting, and the success rates of the headline rows."""
    from visualrhp.evaluation.summaries import cell_summaries, metrics_by_method

    for cell in cell_summaries(episodes):
        with run.child(cell.name, cell.setting) as child:
            child.log_metrics(cell.metrics)
    for space, methods in metrics_by_method(episodes).items():
        run.log_metrics({f"success_rate/{name} {space}": metrics["success_rate"] for name, metrics in methods.items()})


if __name__ == "__main__":
    main()
