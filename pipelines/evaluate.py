"""Evaluate planners on task instances that nobody was trained on (Sec. 7.3 and 8): ``python -m pipelines.evaluate``.

One setting, or a suite of them. The artefact is a folder with

- ``episodes.parquet``: one row per episode (columns: :func:`episodes_table`);
- ``metrics.json``: the three metrics with their 90% intervals, by action space and method, for ``dvc metrics``;
- ``summary.csv``, ``by_density.csv``, ``by_size.csv``, ``by_noise.csv``: the same by setting, for ``dvc plots``;
- ``evaluation.json``: the card: what was evaluated, what was skipped, with which networks.
"""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.app import app, command_line_overrides, compose, override_keys
from pipelines.config import EvaluateConfig, suite_overrides

if TYPE_CHECKING:
    import pandas as pd

    from pipelines.tracking import Run

_log = logging.getLogger(__name__)

_PARTS = "episodes.jsonl"
_SINGLE = "single"


@dataclass(frozen=True)
class Point:
    """One setting: a planner on the first ``config.num_episodes`` task instances of a distribution.

    Attributes:
        experiment: block of the suite that it belongs to.
        config: complete, without a suite.
        episodes: indices of the task instances that can be run.
        skipped: indices of those that cannot: there is no network for their number of objects (CartesianRHP, Sec. 7.5).
    """

    experiment: str
    config: EvaluateConfig
    episodes: tuple[int, ...] = ()
    skipped: tuple[int, ...] = ()

    @cached_property
    def identity(self) -> str:
        """Text that is equal for settings with equal results: everything but how many episodes, and where files go."""
        from pipelines.work import content_hash, result_config

        return content_hash(result_config(self.config) | {"num_episodes": None, "suite": None})[:16]

    @property
    def description(self) -> dict[str, Any]:
        """Columns of the episodes table that say what was evaluated."""
        config = self.config
        low, high = config.scene.num_objects if isinstance(config.scene.num_objects, tuple) else (0, 0)
        # With a deadline, n is how many roll-outs begin together, and what fits depends on the machine: a method apart.
        deadline_s = getattr(config.planner, "deadline_s", None)
        return {
            "experiment": self.experiment,
            "planner": config.planner.name + (f" in {1e3 * deadline_s:g} ms" if deadline_s is not None else ""),
            "action_space": config.action_space.name,
            "num_rollouts": getattr(config.planner, "num_rollouts", None) if deadline_s is None else None,
            "horizon": getattr(config.planner, "horizon", None),
            "scene_num_objects": str(low) if low == high else f"{low}-{high}",
            "object_size": config.scene.object_size,
            "noise_level": config.noise_level,
            "seed": config.seed,
        }


@dataclass(frozen=True)
class Unit:
    """One episode to run: all that a worker has to know."""

    identity: str
    config: EvaluateConfig = field(repr=False)
    episode: int


@app("evaluate", EvaluateConfig)
def main(config: EvaluateConfig) -> None:
    """Evaluate what is not evaluated yet, and publish the artefact."""
    from pipelines.tracking import open_run
    from pipelines.work import discard, git_commit, publish, work_folder

    points = prepare(compose_points(config))
    work = work_folder(config, "evaluate", network_hashes(points) | {"commit": git_commit() or ""})
    name = "suite" if config.suite is not None else f"{config.planner.name} {config.action_space.name}"
    with open_run(config, "evaluate", f"evaluate {name}", work) as run:
        publish(evaluate(config, points, work, run), config.paths.artefact)
    discard(work)


def evaluate(config: EvaluateConfig, points: Sequence[Point], work: Path, run: Run) -> Path:
    """Run the episodes that are missing in ``work``, summarize all; the folder of the artefact."""
    from tqdm import tqdm

    from pipelines.execution import run_tasks, worker_count
    from pipelines.work import card
    from visualrhp.files import atomic_path, write_json

    parts = PartFile(work / _PARTS)
    units = [
        Unit(point.identity, point.config, episode)
        for point in points
        for episode in point.episodes
        if (point.identity, episode) not in parts.rows
    ]
    if parts.rows:
        _log.info("%d episodes are done already; %d to go.", len(parts.rows), len(units))
    # What can take long comes first, so that no worker is left alone with it at the end.
    units.sort(key=lambda unit: unit.config.planner.algorithm != "kinodynamic_rrt")
    started = time.perf_counter()
    results = run_tasks(run_unit, units, config.executor)
    for identity, episode, row in tqdm(results, total=len(units), desc="episodes", unit="episode", smoothing=0.05):
        parts.append(identity, episode, row)
    wall_time = time.perf_counter() - started

    episodes = episodes_table(points, parts.rows)
    artefact = work / "artefact"
    artefact.mkdir(exist_ok=True)
    with atomic_path(artefact / "episodes.parquet") as path:
        episodes.to_parquet(path, index=False)
    write_json(artefact / "metrics.json", metrics_by_method(episodes))
    for stem, table in summary_tables(episodes).items():
        with atomic_path(artefact / f"{stem}.csv") as path:
            table.to_csv(path, index=False, float_format="%.6g")
    content = {
        "points": [_point_card(point) for point in points],
        "networks": network_hashes(points),
        "num_episodes": len(episodes),
        "wall_time_s": round(wall_time, 1),
        "num_workers": worker_count(config.executor),
    }
    write_json(artefact / "evaluation.json", card(config, "evaluate", **content))
    log_to_tracker(run, episodes)
    run.log_artifact(artefact)
    _log.info("%s", report_lines(episodes, points))
    return artefact


# -------------------------------------------------------------------------------------------------------------- points
def compose_points(config: EvaluateConfig) -> list[Point]:
    """The settings to evaluate: that of ``config``, or those of its suite.

    A suite's settings are composed from the command line's overrides and their own, which win. Settings that are equal
    but for the number of episodes are one, with the larger number, so that no episode counts twice.

    Raises:
        ConfigError: a setting of the suite is wrong.
    """
    if config.suite is None:
        return [Point(_SINGLE, config)]
    given = [override for override in command_line_overrides() if override_keys([override]) - {"suite"}]
    points: dict[str, Point] = {}
    for experiment, block in config.suite.items():
        for overrides in suite_overrides({experiment: block}):
            keys = override_keys(overrides)
            kept = [override for override in given if not override_keys([override]) & keys]
            composed = compose("evaluate", EvaluateConfig, [*kept, *overrides])
            touched = {key.partition(".")[0] for key in keys} | {"suite"}
            untouched = {item.name: getattr(config, item.name) for item in fields(config) if item.name not in touched}
            point = Point(experiment, replace(composed, **untouched, suite=None))
            known = points.get(point.identity)
            if known is None:
                points[point.identity] = point
            elif point.config.num_episodes > known.config.num_episodes:
                points[point.identity] = replace(known, config=point.config)
    return list(points.values())


def prepare(points: Sequence[Point]) -> list[Point]:
    """The points with the episodes that they can run, after their planners and scenes have been built once as a check.

    Raises:
        CheckpointError: a network is missing, damaged or of another kind. CartesianRHP at a density without a network
            is no error where other settings of a suite remain; such episodes are listed as skipped.
        ConfigError: a parameter is out of range.
        DataError: nothing can be run.
    """
    from pipelines.planners import build_planner, needed_network
    from visualrhp.errors import DataError
    from visualrhp.scene import Split, sample_task_instance

    prepared = []
    for point in points:
        config = point.config
        space, heuristics = config.action_space.name, config.heuristics
        distribution = scene_distribution(config)
        low, high = distribution.num_objects
        missing = [
            m
            for m in range(low, high + 1)
            if (path := needed_network(config.planner, space, heuristics, m)) is not None and not path.is_file()
        ]
        if missing == list(range(low, high + 1)) and (len(points) == 1 or not _is_cartesian(config)):
            build_planner(config.planner, space, heuristics, low)  # says what is missing
        for m in range(low, high + 1):
            if m not in missing:
                build_planner(config.planner, space, heuristics, m)
        episodes, skipped = list(range(config.num_episodes)), []
        if missing:
            densities = [
                low
                if low == high
                else sample_task_instance(distribution, config.seed, Split.EVALUATION, i).scene.num_objects
                for i in episodes
            ]
            skipped = [i for i in episodes if densities[i] in missing]
            episodes = [i for i in episodes if densities[i] not in missing]
            _log.warning(
                "%s (%s) has no network for %s objects: %d of %d episodes are skipped.",
                config.planner.name,
                space,
                ", ".join(str(m) for m in missing),
                len(skipped),
                config.num_episodes,
            )
        prepared.append(replace(point, episodes=tuple(episodes), skipped=tuple(skipped)))
    if not any(point.episodes for point in prepared):
        raise DataError(
            "nothing can be evaluated: no setting has an episode with a network for its number of objects; train some "
            "with python -m pipelines.train_il representation=cartesian, or change the suite"
        )
    return prepared


def network_hashes(points: Sequence[Point]) -> dict[str, str]:
    """SHA-256 of every network that the points use, by its path within the folder of heuristics."""
    import hashlib

    from pipelines.planners import needed_network

    hashes = {}
    for point in points:
        config = point.config
        low, high = scene_distribution(config).num_objects
        for m in range(low, high + 1):
            path = needed_network(config.planner, config.action_space.name, config.heuristics, m)
            if path is not None and path.is_file():
                name = path.relative_to(config.heuristics).as_posix()
                hashes[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return dict(sorted(hashes.items()))


def scene_distribution(config: EvaluateConfig) -> Any:
    """The distribution of task instances that ``config`` describes."""
    from visualrhp.scene import SceneDistribution

    return SceneDistribution(**asdict(config.scene))


# ------------------------------------------------------------------------------------------------------------ episodes
def run_unit(unit: Unit) -> tuple[str, int, dict[str, Any]]:
    """Run one episode; (identity of the point, episode, columns that the episode gives)."""
    from pipelines.planners import build_planner
    from visualrhp.evaluation.episodes import run_task
    from visualrhp.evaluation.metrics import episode_row
    from visualrhp.scene import NOISE_LEVELS, Split, sample_task_instance
    from visualrhp.simulation import Physics, make_action_space

    config = unit.config
    distribution = scene_distribution(config)
    low, high = distribution.num_objects
    num_objects = low
    if low != high:
        num_objects = sample_task_instance(distribution, config.seed, Split.EVALUATION, unit.episode).scene.num_objects
    space = config.action_space.name
    result = run_task(
        build_planner(config.planner, space, config.heuristics, num_objects),
        distribution,
        config.seed,
        Split.EVALUATION,
        unit.episode,
        action_space=make_action_space(space),
        physics=Physics(**asdict(config.physics)),
        noise=NOISE_LEVELS[config.noise_level],
    )
    return unit.identity, unit.episode, episode_row(result)


class PartFile:
    """Finished episodes, one JSON line each, appended as they come; a line that a kill cut short is dropped.

    Attributes:
        rows: (identity of the point, episode) -> columns that the episode gave.
    """

    def __init__(self, path: Path) -> None:
        from visualrhp.files import write_text

        self.path = path
        self.rows: dict[tuple[str, int], dict[str, Any]] = {}
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        whole = []
        for line in lines:
            try:
                identity, episode, row = json.loads(line)
            except ValueError:
                continue
            whole.append(line)
            self.rows[identity, episode] = row
        if len(whole) < len(lines):
            write_text(path, "".join(f"{line}\n" for line in whole))

    def append(self, identity: str, episode: int, row: dict[str, Any]) -> None:
        """Record an episode; it is in the file when this returns."""
        self.rows[identity, episode] = row
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps([identity, episode, row]) + "\n")


def episodes_table(points: Sequence[Point], rows: dict[tuple[str, int], dict[str, Any]]) -> pd.DataFrame:
    """The episodes table: settings in their order, episodes in theirs.

    Columns: experiment (block of the suite, or "single"), planner, action_space, num_rollouts and horizon (missing for
    planners without roll-outs), num_objects (m of the scene), scene_num_objects (m that was asked for: "4", or "1-7"
    for a random one), object_size, noise_level, seed, episode (index of the task instance), success, dropped, outcome,
    num_actions, action_efficiency (missing unless completed), decision_time_s (of the whole episode),
    mean_decision_time_s (per action), simulation_time_s, execution_time_s, return, num_invalid_rollouts.
    """
    import pandas as pd

    records = [
        point.description | {"episode": episode} | rows[point.identity, episode]
        for point in points
        for episode in point.episodes
    ]
    table = pd.DataFrame(records)
    return table.astype({"num_rollouts": "Int64", "horizon": "Int64", "action_efficiency": "float64"})


# ----------------------------------------------------------------------------------------------------------- summaries
def metrics_by_method(episodes: pd.DataFrame) -> dict[str, Any]:
    """action space -> method -> metric -> value, for the tasks that the headline is about (see ``main_rows``)."""
    from pipelines.report_page import main_rows
    from visualrhp.evaluation.figures import with_labels
    from visualrhp.evaluation.metrics import summarize

    metrics: dict[str, Any] = {}
    for row in summarize(with_labels(main_rows(episodes)), ["action_space", "method"]).to_dict("records"):
        numbers = {
            str(key): round(float(value), 6)
            for key, value in row.items()
            if key not in ("action_space", "method") and not math.isnan(value)
        }
        metrics.setdefault(row["action_space"], {})[row["method"]] = numbers
    return metrics


def summary_tables(episodes: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Tables of metrics with a column ``label`` ("VisualRHP 3x3, continuous") that tells the lines of a plot apart."""
    from pipelines.report_page import main_rows
    from visualrhp.evaluation.figures import with_labels
    from visualrhp.evaluation.metrics import summarize

    def by(rows: pd.DataFrame, *keys: str) -> pd.DataFrame:
        labelled = with_labels(rows)
        labelled = labelled.assign(label=labelled["method"] + ", " + labelled["action_space"])
        return summarize(labelled, ["label", *keys])

    mixed = episodes.loc[episodes["object_size"] == "mixed"]
    quiet = episodes.loc[episodes["noise_level"] == "none"]
    return {
        "summary": by(main_rows(episodes)),
        "by_density": by(quiet.loc[quiet["object_size"] == "mixed"], "num_objects"),
        "by_size": by(quiet, "object_size", "scene_num_objects"),
        "by_noise": by(mixed, "noise_level", "num_objects"),
    }


def log_to_tracker(run: Run, episodes: pd.DataFrame) -> None:
    """One child run per method and action space: its metrics, and those by density with the density as the step."""
    from pipelines.report_page import main_rows
    from visualrhp.evaluation.figures import ACTION_SPACES, order_methods, with_labels
    from visualrhp.evaluation.metrics import evaluation_metrics

    labelled = with_labels(episodes)
    main = with_labels(main_rows(episodes))
    for space in ACTION_SPACES:
        for method in order_methods(labelled.loc[labelled["action_space"] == space, "method"].tolist()):
            own = labelled.loc[(labelled["method"] == method) & (labelled["action_space"] == space)]
            headline = main.loc[(main["method"] == method) & (main["action_space"] == space)]
            with run.child(
                f"{method}, {space}", {"method": method, "action_space": space, "episodes": len(own)}
            ) as child:
                child.log_metrics(_numbers(evaluation_metrics(headline if len(headline) else own)))
                quiet = own.loc[(own["object_size"] == "mixed") & (own["noise_level"] == "none")]
                for density, rows in quiet.groupby("num_objects"):
                    numbers = _numbers(evaluation_metrics(rows))
                    child.log_metrics(
                        {f"by_density/{name}": value for name, value in numbers.items()}, step=int(density)
                    )  # type: ignore[arg-type]
            success = evaluation_metrics(headline)["success_rate"].value
            run.log_metrics(
                {f"success_rate/{method}, {space}".replace(",", ""): None if math.isnan(success) else success}
            )


def _numbers(metrics: dict[str, Any]) -> dict[str, float]:
    numbers = {}
    for name, estimate in metrics.items():
        named = {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
        numbers |= {key: value for key, value in named.items() if not math.isnan(value)}
    return numbers


def report_lines(episodes: pd.DataFrame, points: Sequence[Point]) -> str:
    """The metrics of every method as a few lines of text."""
    from pipelines.report_page import duration, main_rows, percent
    from visualrhp.evaluation.figures import with_labels
    from visualrhp.evaluation.metrics import summarize

    lines = [
        f"{len(episodes)} episodes in {len(points)} settings. Success rate [90% interval], action efficiency, time:"
    ]
    for row in summarize(with_labels(main_rows(episodes)), ["action_space", "method"]).to_dict("records"):
        lines.append(
            f"  {row['action_space']:<11} {row['method']:<24} {percent(row['success_rate']):>5} "
            f"[{percent(row['success_rate_low'])}, {percent(row['success_rate_high'])}]  "
            f"{row['action_efficiency']:.2f}  {duration(row['execution_time_s'])}  ({row['episodes']} episodes)"
        )
    return "\n".join(lines)


def _point_card(point: Point) -> dict[str, Any]:
    return point.description | {
        "num_episodes": len(point.episodes),
        "num_skipped": len(point.skipped),
        "planner_config": asdict(point.config.planner),
        "scene": asdict(point.config.scene),
        "physics": asdict(point.config.physics),
    }


def _is_cartesian(config: EvaluateConfig) -> bool:
    heuristic = getattr(config.planner, "heuristic", None)
    return getattr(heuristic, "representation", None) == "cartesian"


if __name__ == "__main__":
    main()
