"""Stages killed by SIGKILL and started again until they are done: the same bytes, and all runs and steps once.

Half of the kills are at random moments, half before the n-th file operation of the process. Every kill ends the whole
process group, and thus the workers.
"""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from pipelines.workflow.publishing import MARK
from tests.torture.killed import COUNT_FILE

REPOSITORY = Path(__file__).resolve().parents[2]
SETTINGS = ("scale=smoke", "executor.num_workers=2", "tracking.system_metrics=false", "seed=1")
_TIMEOUT_S = 300.0
_WITH_TIMES = ("report", "report_ablation", "report_execution", "play", "execute")
_TIMES = re.compile(r"(^|_)time_s|_s$")
"""Found in the names of numbers that are measured times."""


@dataclass(frozen=True)
class Stage:
    """A stage to kill.

    Attributes:
        name: of the pipeline.
        overrides: its arguments; ``{inputs}`` is the folder with the artefacts of :data:`INPUTS`.
        artefact: its folder in the outputs.
        is_tracked: whether it has a run in MLflow.
    """

    name: str
    overrides: tuple[str, ...]
    artefact: str
    is_tracked: bool = True


_DISCRETE = "action_space=discrete"
_DEMONSTRATIONS = "demonstrations={inputs}/generate_demos/discrete"
_START = "heuristic={inputs}/train_il/discrete/image"
_FRAMES = ("num_cells=12", "cell.num_objects=3", "sampling.frames_per_cell=1", "sampling.motions=1")
_NETWORK = ("network.widths=[4,6,8]", "network.blocks=[1,1]", "network.decoder_width=6", "network.fine_width=4")
_ROBOT = ("planner=kinodynamic_rrt", "segmenter=true_state", "cell.num_objects=2")
_PLANNER = ("planner=crafted_heuristic_rhp", "planner.num_rollouts=2", "planner.horizon=1")

STAGES = (
    Stage(
        "generate_demos",
        (_DISCRETE, "demonstrations.count=60", "demonstrations.shard_size=20", "scene.num_objects=[1,5]"),
        "generate_demos/discrete",
    ),
    Stage("train_il", (_DISCRETE, _DEMONSTRATIONS, "learner.epochs=4"), "train_il/discrete/image"),
    Stage("train_rl", (_DISCRETE, _DEMONSTRATIONS, _START, "learner.iterations=4"), "train_rl/discrete/image"),
    Stage(
        "train_il",
        (_DISCRETE, _DEMONSTRATIONS, "observation=cartesian", "observation.num_objects=[1,2]", "learner.epochs=3"),
        "train_il/discrete/cartesian",
    ),
    Stage(
        "expert_iteration",
        (_DISCRETE, _START, "learner.rounds=2", "learner.episodes_per_round=40"),
        "expert_iteration/discrete/image",
    ),
    Stage("evaluate", (*_PLANNER, "num_episodes=60", "scene.num_objects=[1,5]"), "evaluate"),
    Stage(
        "tune_crafted",
        ("search.num_trials=4", "search.num_instances=8", "selection.num_instances=4", "check.num_instances=4"),
        "tune_crafted",
    ),
    Stage("play", (*_PLANNER, "tracking=mlflow", "video.size_px=96"), "play"),
    Stage("verify_demos", (_DISCRETE, _DEMONSTRATIONS), "verify_demos/discrete", is_tracked=False),
    Stage("export_demos", (_DISCRETE, _DEMONSTRATIONS), "export_demos/discrete/parquet", is_tracked=False),
    Stage(
        "report",
        ("evaluation={inputs}/evaluate", "training=[{inputs}/train_il]", "videos.planners=[crafted_heuristic_rhp]"),
        "report",
    ),
    Stage("report_ablation", ("evaluation={inputs}/evaluate",), "report_ablation", is_tracked=False),
    Stage("generate_frames", (*_FRAMES, "executor.num_workers=1"), "segmenter/frames"),
    Stage(
        "train_segmenter",
        (*_NETWORK, "frames={inputs}/segmenter/frames", "learner.batch_size=4", "learner.epochs=4"),
        "segmenter/network",
    ),
    Stage("evaluate_segmenter", ("num_cells=12", "cell.num_objects=3"), "segmenter/evaluation"),
    Stage("execute", (*_ROBOT, "index=1", "tracking=mlflow"), "execute"),
    Stage("evaluate_execution", (*_ROBOT, "num_episodes=8"), "evaluate_execution"),
    Stage(
        "report_execution",
        ("evaluations={inputs}/evaluate_execution", "method=K.RRT"),
        "report_execution",
        is_tracked=False,
    ),
)
_READ_BY_OTHERS = (
    "generate_demos/discrete",
    "train_il/discrete/image",
    "evaluate",
    "segmenter/frames",
    "evaluate_execution",
)
INPUTS = tuple(stage for stage in STAGES if stage.artefact in _READ_BY_OTHERS)


@dataclass
class Tally:
    """What happened to a stage."""

    kills: int = 0
    completions: int = 0
    seconds: float = 0.0
    differences: list[str] = field(default_factory=list)


def command(stage: Stage, inputs: Path, outputs: Path, operation: int = 0) -> list[str]:
    overrides = [override.format(inputs=inputs) for override in stage.overrides]
    tracked = [] if stage.is_tracked else ["tracking=none"]
    start = [sys.executable, "-m", "tests.torture.killed", str(operation), stage.name]
    return [*start, *SETTINGS, *tracked, *overrides, f"paths.outputs={outputs}"]


def execute(arguments: list[str], kill_after_s: float | None = None, count_file: Path | None = None) -> bool:
    """Whether a command succeeded; False if it was killed.

    Raises:
        RuntimeError: it failed.
    """
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    if count_file is not None:
        environment[COUNT_FILE] = str(count_file)
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            arguments,
            cwd=REPOSITORY,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
        )
        try:
            code = process.wait(_TIMEOUT_S if kill_after_s is None else kill_after_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if kill_after_s is None:
                raise
            return False
        if code == -signal.SIGKILL:
            return False
        if code:
            errors.seek(0)
            raise RuntimeError(f"{' '.join(arguments[2:])}: exit code {code}: {errors.read()[-2000:]}")
    return True


def without_times(value: Any) -> Any:
    """A JSON document without measured times."""
    if isinstance(value, dict):
        return {
            key: without_times(entry)
            for key, entry in value.items()
            if not _TIMES.search(key) and key not in ("num_workers", "num_reused", "date")
        }
    return [without_times(entry) for entry in value] if isinstance(value, list) else value


def contents(folder: Path) -> dict[str, Any]:
    """Every file of an artefact, without measured times; of files with pictures of times, only their presence."""
    found: dict[str, Any] = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = path.relative_to(folder).as_posix()
        if path.name == MARK:
            found[name] = sorted(json.loads(path.read_text())["files"])
        elif path.suffix == ".json":
            found[name] = without_times(json.loads(path.read_text()))
        elif path.name == "episodes.parquet":
            table = pd.read_parquet(path)
            table = table[[column for column in table if not str(column).endswith("_time_s")]]
            found[name] = table.to_csv()
        elif path.suffix == ".csv":
            table = pd.read_csv(path)
            columns = [column for column in table if "time" not in str(column) and not _TIMES.search(str(column))]
            found[name] = table[columns].to_csv()
        elif folder.name in ("report", "report_ablation", "play", "execute") and path.suffix in (
            ".html",
            ".svg",
            ".png",
            ".webm",
        ):
            found[name] = None  # they show times
        else:
            found[name] = path.read_bytes()
    return found


def differences(whole: Mapping[str, Any], interrupted: Mapping[str, Any]) -> Iterator[str]:
    for name in sorted(whole.keys() | interrupted.keys()):
        if name not in whole or name not in interrupted:
            yield f"{name} is only {'with' if name in interrupted else 'without'} kills"
        elif whole[name] != interrupted[name]:
            yield f"{name} differs"


def faults_of_runs(outputs: Path, whole: Path) -> Iterator[str]:
    """Faults in MLflow: runs that are not finished, twice there, or do not have every step once."""
    expected, found = runs_of(whole), runs_of(outputs)
    for name, times in Counter(name for name, _, _ in found).items():
        if times > 1:
            yield f"MLflow has {times} finished runs {name}"
    by_name = {name: steps for name, _, steps in found}
    for name, _, steps in expected:
        if by_name.get(name) != steps:
            missing = sorted(set(steps) ^ set(by_name.get(name, ())))
            yield f"MLflow: the steps of {name} differ: {missing[:5]}"
    if by_name.keys() - {name for name, _, _ in expected}:
        yield "MLflow has other runs"


def runs_of(outputs: Path) -> list[tuple[str, str, list[tuple[str, int]]]]:
    """Name, status and steps of every run that is not KILLED."""
    from mlflow import MlflowClient

    client = MlflowClient(f"sqlite:///{outputs / 'mlflow.db'}")
    found = []
    for run in client.search_runs([entry.experiment_id for entry in client.search_experiments()]):
        if run.info.status == "KILLED":
            continue
        steps = [
            (name, entry.step)
            for name in run.data.metrics
            if not name.startswith("progress/")  # rows at shares of the remaining work
            for entry in client.get_metric_history(run.info.run_id, name)
        ]
        found.append((f"{run.info.run_name} {run.info.status}", run.info.status, sorted(steps)))
    return sorted(found)


def leftovers(outputs: Path) -> Iterator[str]:
    """Files that should not be there when a stage is done."""
    for path in outputs.rglob("*"):
        hidden = path.name.startswith(".") and path.name not in (MARK, ".hydra")
        if hidden or ("work" in path.relative_to(outputs).parts[:1] and path.is_file()):
            yield f"{path.relative_to(outputs)} is left"


def is_done(stage: Stage, outputs: Path) -> bool:
    """Whether a process that was killed had already ended its work."""
    work = outputs / "work" / stage.name
    return (outputs / stage.artefact).is_dir() and not (work.is_dir() and any(path.is_dir() for path in work.iterdir()))


def torture(stage: Stage, inputs: Path, folder: Path, num_kills: int, rng: random.Random) -> Tally:
    """Kill a stage ``num_kills`` times; compare what it has made when it is done with what it makes without kills."""
    tally, begun = Tally(), time.perf_counter()
    whole, count_file = folder / "whole", folder / "count"
    execute(command(stage, inputs, whole), count_file=count_file)
    seconds, operations = time.perf_counter() - begun, int(count_file.read_text())
    expected = contents(whole / stage.artefact)
    while tally.kills < num_kills:
        outputs = folder / f"interrupted{tally.completions}"
        is_complete, was_killed = False, False
        while not is_complete and tally.kills < num_kills:
            if rng.random() < 0.5:
                was_killed = not execute(command(stage, inputs, outputs), rng.uniform(0.2, 1.0) * seconds)
            else:
                was_killed = not execute(command(stage, inputs, outputs, rng.randint(1, operations)))
            tally.kills += was_killed
            is_complete = not was_killed or is_done(stage, outputs)
        if not is_complete:
            was_killed = not execute(command(stage, inputs, outputs))
        tally.completions += 1
        tally.differences += differences(expected, contents(outputs / stage.artefact))
        if not was_killed:  # the next start removes what a kill leaves
            tally.differences += leftovers(outputs)
        if stage.is_tracked:
            tally.differences += faults_of_runs(outputs, whole)
    tally.seconds = time.perf_counter() - begun
    return tally


def make_inputs(folder: Path, stages: Sequence[Stage] = INPUTS) -> Path:
    """The artefacts that other stages read."""
    for stage in stages:
        execute(command(stage, folder, folder))
    return folder


def run(num_kills: int, seed: int) -> dict[str, Any]:
    """Kill every stage, ``num_kills`` times in all; prints a line for each."""
    rng, total = random.Random(seed), Tally()
    with tempfile.TemporaryDirectory() as folder:
        inputs = make_inputs(Path(folder) / "inputs")
        for number, stage in enumerate(STAGES):
            share = num_kills // len(STAGES) + (number < num_kills % len(STAGES))
            tally = torture(stage, inputs, Path(folder) / str(number), share, rng)
            print(json.dumps({"stage": stage.artefact, **vars(tally)}), flush=True)
            total.kills += tally.kills
            total.completions += tally.completions
            total.seconds += tally.seconds
            total.differences += [f"{stage.artefact}: {difference}" for difference in tally.differences]
    return vars(total)
