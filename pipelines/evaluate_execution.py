"""Episodes of a robot in random simulated cells (paper, Sec. 9): ``python -m pipelines.evaluate_execution``.

One planner with one segmenter; several are a sweep, such as ``-m planner=visual_rhp_plus,greedy
cell.num_objects=[2,3],[6,7] segmenter=released,true_state``. The same seed gives every method the same cells. The
artefact is a folder with

- ``episodes.parquet``: one row per episode, as of :mod:`pipelines.evaluate`; the outcome is that which the robot saw;
- ``executions.csv``: the same episodes with what is true at their end, why the robot was stopped, and latencies;
- ``metrics.json``: rates of both, and mean latencies;
- ``execution.json``: the card.

Episodes are independent tasks of the executor, and a killed run resumes from its journal.
"""

from __future__ import annotations

import logging
import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import EvaluateExecutionConfig
    from pipelines.workflow.tracking import Run
    from visualrhp.evaluation.episodes import Setting
    from visualrhp.types import Outcome

_log = logging.getLogger(__name__)

STAGE = "evaluate_execution"

_JOURNAL = "executions.jsonl"


@dataclass(frozen=True)
class Unit:
    """One episode to run: the task of a worker."""

    config: EvaluateExecutionConfig = field(repr=False)
    index: int

    @property
    def key(self) -> str:
        """Key of the result in the journal."""
        return str(self.index)


@app(STAGE)
def main(config: EvaluateExecutionConfig) -> None:
    """Run the missing episodes, and publish the artefact."""
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work

    name = f"{STAGE} {config.planner.name} {config.segmenter.name}"
    with open_work(config, STAGE, input_hashes(config)) as work, open_run(config, STAGE, name, work) as run:
        publish(evaluate(config, work, run), config.paths.artefact, STAGE)


def evaluate(config: EvaluateExecutionConfig, work: Path, run: Run) -> Path:
    """Run the episodes that are missing in ``work``; return the folder of the artefact."""
    import pandas as pd
    from tqdm import tqdm

    from pipelines.workflow.artefacts import card
    from pipelines.workflow.executor import run_tasks, worker_count
    from pipelines.workflow.workspace import empty_folder
    from visualrhp.evaluation.episodes import episodes_table, write_episodes
    from visualrhp.evaluation.journal import Journal
    from visualrhp.files import atomic_path, write_json

    journal = Journal(work / _JOURNAL)
    units = [Unit(config, index) for index in range(config.num_episodes)]
    missing = [unit for unit in units if unit.key not in journal]
    if journal:
        _log.info("%d episodes are finished, %d remain.", len(journal), len(missing))
    started = time.perf_counter()
    results = run_tasks(run_unit, missing, config.executor)
    for key, row in tqdm(results, total=len(missing), desc="episodes", unit="episode", smoothing=0.05):
        journal.append(key, row)
    wall_time = time.perf_counter() - started

    artefact = empty_folder(work / "artefact")
    setting = setting_of(config)
    table = episodes_table((setting, unit.index, journal[unit.key]["episode"]) for unit in units)
    write_episodes(artefact / "episodes.parquet", table)
    executions = pd.DataFrame([{"episode": unit.index} | journal[unit.key]["execution"] for unit in units])
    with atomic_path(artefact / "executions.csv") as path:
        executions.to_csv(path, index=False, float_format="%.6g")
    metrics = metrics_of(executions)
    seen, true = metrics["success_rate"], metrics["true_success_rate"]
    write_json(artefact / "metrics.json", metrics)
    content = {
        "num_episodes": len(units),
        "networks": input_hashes(config),
        "wall_time_s": round(wall_time, 1),
        "num_workers": worker_count(config.executor),
    }
    write_json(artefact / "execution.json", card(config, STAGE, **content))
    run.log_metrics({name: value for name, value in metrics.items() if value is not None})
    run.log_artifact(artefact)
    _log.info(
        "%s, %s, %s objects: success %.3f as seen, %.3f in truth, of %d episodes.",
        setting.planner,
        setting.experiment,
        setting.scene_num_objects,
        seen,
        true,
        len(units),
    )
    return artefact


def run_unit(unit: Unit) -> tuple[str, dict[str, Any]]:
    """Run one episode; return its key, and its columns of both tables."""
    from pipelines.robot_episode import run_robot
    from visualrhp.errors import CellFault, PerceptionError, SimulationError
    from visualrhp.evaluation.episodes import episode_row
    from visualrhp.types import Outcome

    try:
        done = run_robot(unit.config, unit.index)
    except (CellFault, PerceptionError) as error:
        return unit.key, ended_at_once(unit, Outcome.STOPPED, str(error))
    except SimulationError as error:
        return unit.key, ended_at_once(unit, Outcome.DIVERGED, str(error))
    result, truth = done.result, done.true_end
    assert truth is not None  # of a simulated cell
    execution = {
        "num_objects": result.num_objects,
        "outcome": result.outcome.value,
        "num_actions": result.num_actions,
        "true_success": truth["success"],
        "true_distance": truth["distance_to_target"],
        "num_fallen": len(truth["fallen"]),
        "fault": result.fault,
        "num_withheld": sum(step["is_withheld"] for step in done.actions),
        "cell_time_s": done.cell_time_s,
        "wall_time_s": done.wall_time_s,
        **done.latency_summary,
    }
    return unit.key, {"episode": episode_row(result), "execution": execution}


def ended_at_once(unit: Unit, outcome: Outcome, fault: str) -> dict[str, Any]:
    """The rows of an episode whose first look failed: no action."""
    from visualrhp.embodiment.simulated_cell.sampling import sample_cell
    from visualrhp.evaluation.episodes import RESULT_COLUMNS
    from visualrhp.streams import Split

    config = unit.config
    assert config.cell.name == "simulated"
    num_objects = len(sample_cell(config.cell, config.seed, Split.EVALUATION, unit.index).objects)
    zeros = {"integer": 0, "number": 0.0, "boolean": False}
    row = {name: zeros.get(column.kind) for name, column in RESULT_COLUMNS.items()}
    row |= {"num_objects": num_objects, "outcome": outcome.value, "action_efficiency": float("nan")}
    execution = {
        "num_objects": num_objects,
        "outcome": outcome.value,
        "num_actions": 0,
        "true_success": False,
        "num_fallen": 0,
        "fault": fault,
    }
    return {"episode": row, "execution": execution}


def metrics_of(executions) -> dict[str, float | None]:
    """Rates of outcomes, as seen and in truth, and mean latencies; None where nothing was measured."""
    from visualrhp.types import Outcome

    success = executions["outcome"] == Outcome.SUCCESS.value
    metrics: dict[str, float | None] = {
        "success_rate": float(success.mean()),
        "true_success_rate": float((success & executions["true_success"]).mean()),
        "mean_actions": float(executions.loc[success, "num_actions"].mean()) if success.any() else None,
    }
    for outcome in Outcome:
        metrics[f"outcome/{outcome.value.replace(' ', '_')}"] = float((executions["outcome"] == outcome.value).mean())
    for name in ("mean_perception_s", "mean_decision_s", "mean_perception_and_decision_s", "mean_path_s"):
        if name in executions:
            metrics[name] = float(executions[name].mean())
    return metrics


def setting_of(config: EvaluateExecutionConfig) -> Setting:
    """The columns of the setting in the table of episodes; the experiment is segmenter or world."""
    from dataclasses import asdict

    from visualrhp.evaluation.episodes import Setting
    from visualrhp.evaluation.methods import Method

    cell = config.cell
    assert cell.name == "simulated"
    low, high = cell.num_objects
    return Setting(
        experiment=config.segmenter.name if config.world == "cell" else config.world,
        **asdict(Method.of(config.planner)),
        action_space=config.action_space.name,
        scene_num_objects=str(low) if low == high else f"{low}-{high}",
        object_size=cell.object_size,
        layout=cell.layout,
        noise_level="none",
        seed=config.seed,
    )


def input_hashes(config: EvaluateExecutionConfig) -> dict[str, str]:
    """SHA-256 of the networks of the planner and of the segmenter's file, by name.

    Raises:
        CheckpointError: a network is missing.
    """
    from pipelines.networks import NetworkFile
    from pipelines.planners import find_network, fixes_num_objects, network_name, released_where_untrained

    cell, space = config.cell, config.action_space.name
    assert cell.name == "simulated"
    low, high = cell.num_objects
    hashes: dict[str, str] = {}
    for m in range(low, high + 1) if fixes_num_objects(config.planner) else (low,):
        folder = released_where_untrained(config.planner, space, config.heuristics, m)
        path = find_network(config.planner, space, folder, m)
        if path is not None:
            name = network_name(path, config.paths.outputs, folder)
            hashes[name] = NetworkFile.read(path, name).sha256
    if config.segmenter.file is not None:
        import hashlib

        content = Path(config.segmenter.file).read_bytes() if os.path.isfile(config.segmenter.file) else b""
        hashes[os.path.basename(config.segmenter.file)] = hashlib.sha256(content).hexdigest()
    return hashes


if __name__ == "__main__":
    main()
