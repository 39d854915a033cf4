"""Experiment tracking with MLflow: every stage is a run.

The database is ``<outputs>/mlflow.db``, files are under ``<outputs>/mlruns``; ``make ui`` shows them. When DVC runs an
experiment in a copy of the repository, those of the original repository are used. A resumed stage continues its run,
whose id is in a file beside its work folder, and records what is missing there: every metric is recorded once per step.
Runs of killed processes are closed by the next stage.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from pipelines.workflow.artefacts import anchored_outputs, dvc_stage, git_commit
from pipelines.workflow.names import metric_name

if TYPE_CHECKING:
    from mlflow import MlflowClient

    from pipelines.config import PipelineConfig

_WORK_TAG = "visualrhp.work"
"""Tag of a run: the work folder of its stage, relative to the outputs. Its lock shows whether the stage is running."""

_UNFINISHED_UPLOADS = ".artifact.uploading.*"
"""Names that MLflow gives to files while it copies them."""
_MAX_PARAM_LENGTH = 6000
_BATCH = 100


class Run(ABC):
    """A tracked run, which records metrics and files."""

    @property
    @abstractmethod
    def id(self) -> str | None:
        """Id of the run in the tracker; None if nothing is tracked."""

    @abstractmethod
    def log_metrics(self, metrics: Mapping[str, float | int | None], step: int = 0) -> None:
        """Record numbers in one write, except those that are None, and those already recorded for this step.

        ``step`` is an iteration or epoch.
        """

    @abstractmethod
    def log_artifact(self, path: str | os.PathLike[str]) -> None:
        """Record a file, or the content of a folder."""

    @abstractmethod
    def child(self, name: str, params: Mapping[str, Any] | None = None) -> AbstractContextManager[Run]:
        """A run within this one, with the same interface."""


@contextmanager
def open_run(config: PipelineConfig, stage: str, name: str, work: Path | None = None) -> Iterator[Run]:
    """Track the block as a run of ``stage`` called ``name``.

    Args:
        config: recorded as parameters, flattened: ``learner.lr`` and so on.
        stage: the pipeline.
        name: of the run.
        work: work folder of the stage; an unfinished run that was started there is resumed.

    Raises:
        DataError: the database cannot be used.
        StorageError: the disk is full, or a file cannot be written.
    """
    if config.tracking.name == "none":
        yield _NullRun()
        return
    from pipelines.workflow.tracking_database import explain_tracking

    outputs = anchored_outputs(config)
    with explain_tracking(outputs):
        tracker = _Tracker(config, stage, outputs, work)
        tracker.close_orphans()
        with tracker.run(name, parent=None, params=flatten(_params(config))) as run:
            yield run


def flatten(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested dicts, with keys joined by dots: ``{"a": {"b": 1}}`` -> ``{"a.b": 1}``."""
    flat: dict[str, Any] = {}
    for key, value in content.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and value:
            flat |= flatten(value, f"{name}.")
        else:
            flat[name] = value
    return flat


def _params(config: PipelineConfig) -> dict[str, Any]:
    content = dataclasses.asdict(config)
    content["scale"] = config.scale["name"]  # its values are also in the other keys
    if content.get("suite"):
        content["suite"] = ", ".join(content["suite"])
    return content


class _NullRun(Run):
    """A run that is not tracked."""

    @property
    def id(self) -> str | None:
        return None

    def log_metrics(self, metrics: Mapping[str, float | int | None], step: int = 0) -> None:
        pass

    def log_artifact(self, path: str | os.PathLike[str]) -> None:
        pass

    @contextmanager
    def child(self, name: str, params: Mapping[str, Any] | None = None) -> Iterator[Run]:
        yield self


class _Tracker:
    """Makes, resumes and ends the runs of one stage."""

    def __init__(self, config: PipelineConfig, stage: str, outputs: Path, work: Path | None) -> None:
        from pipelines.workflow.tracking_database import open_experiment
        from pipelines.workflow.workspace import RUNS_SUFFIX

        self.client, self.experiment_id = open_experiment(outputs, config.tracking.experiment)
        self.stage = stage
        self.system_metrics = config.tracking.system_metrics
        self._outputs = outputs
        self._work = work
        self._run_file = work.with_name(work.name + RUNS_SUFFIX) if work is not None else None

    def close_orphans(self) -> None:
        """Mark the runs of stages that were killed, and not resumed, as killed.

        A stage that runs holds the lock of its work folder. Runs without a work folder are not changed.
        """
        from pipelines.workflow.workspace import is_locked

        running = self.client.search_runs([self.experiment_id], "attributes.status = 'RUNNING'", max_results=1000)
        own, resumed = self._work_name(), set(self._known().values())
        for run in running:
            work = run.data.tags.get(_WORK_TAG)
            if work is None or run.info.run_id in resumed:
                continue
            if work == own or not is_locked(self._outputs / work):
                self.client.set_terminated(run.info.run_id, "KILLED")

    @contextmanager
    def run(self, name: str, parent: _MlflowRun | None, params: Mapping[str, Any]) -> Iterator[_MlflowRun]:
        """A run for the duration of the block: RUNNING, then FINISHED, FAILED or, if it was interrupted, KILLED."""
        path = f"{parent.path}/{name}" if parent else name
        run_id = self._unfinished(path)
        resumed = run_id is not None
        if run_id is None:
            run_id = self.client.create_run(
                self.experiment_id, run_name=name, tags=self._tags(parent), start_time=int(time.time() * 1000)
            ).info.run_id
            self._remember(path, run_id)
        else:
            self.client.update_run(run_id, status="RUNNING")
            self._remove_unfinished_uploads(run_id)
        run = _MlflowRun(self, path, run_id, _recorded_steps(self.client, run_id) if resumed else {})
        _log_params(self.client, run_id, params)
        monitor = self._monitor(run_id, resumed) if parent is None and self.system_metrics else contextlib.nullcontext()
        status = "FAILED"
        try:
            with monitor:
                yield run
            status = "FINISHED"
        except (KeyboardInterrupt, SystemExit, GeneratorExit):
            status = "KILLED"
            raise
        finally:
            self.client.set_terminated(run_id, status)

    def _remove_unfinished_uploads(self, run_id: str) -> None:
        """Remove the files that MLflow had copied in part when it was killed."""
        from pipelines.workflow.tracking_database import ARTIFACTS

        for path in (self._outputs / ARTIFACTS / run_id).rglob(_UNFINISHED_UPLOADS):
            path.unlink()

    def _tags(self, parent: _MlflowRun | None) -> dict[str, str]:
        tags = {
            "stage": self.stage,
            "mlflow.source.name": f"pipelines.{self.stage}",
            "mlflow.source.type": "LOCAL",
            "mlflow.source.git.commit": git_commit(),
            "dvc.stage": dvc_stage(),
            "dvc.experiment": os.environ.get("DVC_EXP_NAME"),
            "mlflow.parentRunId": parent.id if parent else None,
            _WORK_TAG: self._work_name(),
        }
        return {key: value for key, value in tags.items() if value}

    def _unfinished(self, path: str) -> str | None:
        """Id of the run of this name in the work folder, if it is also in the database."""
        from mlflow.exceptions import MlflowException

        run_id = self._known().get(path)
        if run_id is None:
            return None
        try:
            run = self.client.get_run(run_id)
        except MlflowException:
            return None
        return run_id if run.info.lifecycle_stage == "active" else None

    def _known(self) -> dict[str, str]:
        """Ids of the runs of this work folder, by path."""
        from visualrhp.documents import FileKind

        kind = FileKind("ids of runs (JSON)", "delete it; the stage then continues, with a new run in MLflow")
        if self._run_file is None or not os.path.lexists(self._run_file):
            return {}
        return kind.read(self._run_file, dict[str, str])

    def _remember(self, path: str, run_id: str) -> None:
        if self._run_file is not None:
            from visualrhp.files import write_json

            write_json(self._run_file, {**self._known(), path: run_id})

    def _work_name(self) -> str | None:
        if self._work is None or not self._work.is_relative_to(self._outputs):
            return None
        return self._work.relative_to(self._outputs).as_posix()

    def _monitor(self, run_id: str, resumed: bool) -> AbstractContextManager[object]:
        from mlflow.system_metrics.system_metrics_monitor import SystemMetricsMonitor

        return _Monitoring(SystemMetricsMonitor(run_id, resume_logging=resumed, tracking_uri=self.client.tracking_uri))


class _Monitoring:
    """Run MLflow's system monitor during a block."""

    def __init__(self, monitor: Any) -> None:
        self._monitor = monitor

    def __enter__(self) -> _Monitoring:
        self._monitor.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._monitor.finish()


class _MlflowRun(Run):
    """A run in MLflow."""

    def __init__(self, tracker: _Tracker, path: str, run_id: str, recorded: dict[str, set[int]]) -> None:
        """``recorded`` has the steps of every metric in the database."""
        self.path = path
        self._tracker = tracker
        self._id = run_id
        self._recorded = recorded

    @property
    def id(self) -> str:
        return self._id

    def log_metrics(self, metrics: Mapping[str, float | int | None], step: int = 0) -> None:
        from mlflow.entities import Metric

        now = int(time.time() * 1000)
        present = {metric_name(key): float(value) for key, value in metrics.items() if value is not None}
        entries = [
            Metric(name, value, now, step)
            for name, value in present.items()
            if step not in self._recorded.get(name, ())
        ]
        if entries:
            self._tracker.client.log_batch(self._id, metrics=entries)
        for entry in entries:
            self._recorded.setdefault(entry.key, set()).add(step)

    def log_artifact(self, path: str | os.PathLike[str]) -> None:
        if Path(path).is_dir():
            self._tracker.client.log_artifacts(self._id, str(path))
        else:
            self._tracker.client.log_artifact(self._id, str(path))

    def child(self, name: str, params: Mapping[str, Any] | None = None) -> AbstractContextManager[Run]:
        return self._tracker.run(name, parent=self, params=flatten(params or {}))


def _recorded_steps(client: MlflowClient, run_id: str) -> dict[str, set[int]]:
    """The steps of every metric of a run but those of the machine."""
    names = [name for name in client.get_run(run_id).data.metrics if not name.startswith("system/")]
    return {name: {entry.step for entry in client.get_metric_history(run_id, name)} for name in names}


def _log_params(client: MlflowClient, run_id: str, params: Mapping[str, Any]) -> None:
    from mlflow.entities import Param

    entries = [Param(key, str(value)[:_MAX_PARAM_LENGTH]) for key, value in params.items()]
    known = client.get_run(run_id).data.params  # parameters of a resumed run cannot be changed
    entries = [entry for entry in entries if entry.key not in known]
    for start in range(0, len(entries), _BATCH):
        client.log_batch(run_id, params=entries[start : start + _BATCH])
