"""Experiment tracking with MLflow: every stage is a run.

The database is ``<outputs>/mlflow.db``, files are under ``<outputs>/mlruns``; ``make ui`` shows them. When DVC runs an
experiment in a copy of the repository, those of the original repository are used. A resumed stage continues its run,
whose id is in its work folder.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
import os
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from pipelines.workflow.artefacts import anchored_outputs, dvc_stage, git_commit

if TYPE_CHECKING:
    from mlflow import MlflowClient

    from pipelines.config import PipelineConfig

_RUN_FILE = "mlflow_runs.json"
_MAX_PARAM_LENGTH = 6000
_BATCH = 100
_DESCRIPTION = """\
Runs of the pipelines. Every stage is a run; parts of a stage are its children. Charts are grouped by `train/`,
`validation/`, `collection/` and so on; select runs and press *Compare* to compare them. Videos and figures are
among the artefacts.
"""


class Run(ABC):
    """A tracked run, which records metrics and files."""

    @property
    @abstractmethod
    def id(self) -> str | None:
        """Id of the run in the tracker; None if nothing is tracked."""

    @abstractmethod
    def log_metrics(self, metrics: Mapping[str, float | int | None], step: int = 0) -> None:
        """Record numbers in one write, except those that are None. ``step`` is an iteration or epoch."""

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
    """
    if config.tracking.name == "none":
        yield _NullRun()
        return
    tracker = _Tracker(config, stage, work)
    with tracker.run(name, parent=None, params=flatten(_params(config))) as run:
        yield run


def metric_name(name: str) -> str:
    """``name`` in the characters that MLflow allows: "rate/VisualRHP+ 3x3" -> "rate/VisualRHP plus 3x3"."""
    return re.sub(r"[^\w\-. :/]", "_", name.replace("+", " plus"))


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

    def __init__(self, config: PipelineConfig, stage: str, work: Path | None) -> None:
        outputs = anchored_outputs(config)
        self.client, self.experiment_id = _open_experiment(outputs, config.tracking.experiment)
        self.stage = stage
        self.system_metrics = config.tracking.system_metrics
        self._run_file = work / _RUN_FILE if work is not None else None

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
        run = _MlflowRun(self, path, run_id)
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

    def _tags(self, parent: _MlflowRun | None) -> dict[str, str]:
        tags = {
            "stage": self.stage,
            "mlflow.source.name": f"pipelines.{self.stage}",
            "mlflow.source.type": "LOCAL",
            "mlflow.source.git.commit": git_commit(),
            "dvc.stage": dvc_stage(),
            "dvc.experiment": os.environ.get("DVC_EXP_NAME"),
            "mlflow.parentRunId": parent.id if parent else None,
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
        if self._run_file is None or not self._run_file.is_file():
            return {}
        return json.loads(self._run_file.read_text(encoding="utf-8"))

    def _remember(self, path: str, run_id: str) -> None:
        if self._run_file is not None:
            from visualrhp.files import write_json

            write_json(self._run_file, {**self._known(), path: run_id})

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

    def __init__(self, tracker: _Tracker, path: str, run_id: str) -> None:
        self.path = path
        self._tracker = tracker
        self._id = run_id

    @property
    def id(self) -> str:
        return self._id

    def log_metrics(self, metrics: Mapping[str, float | int | None], step: int = 0) -> None:
        from mlflow.entities import Metric

        now = int(time.time() * 1000)
        entries = [
            Metric(metric_name(key), float(value), now, step) for key, value in metrics.items() if value is not None
        ]
        if entries:
            self._tracker.client.log_batch(self._id, metrics=entries)

    def log_artifact(self, path: str | os.PathLike[str]) -> None:
        if Path(path).is_dir():
            self._tracker.client.log_artifacts(self._id, str(path))
        else:
            self._tracker.client.log_artifact(self._id, str(path))

    def child(self, name: str, params: Mapping[str, Any] | None = None) -> AbstractContextManager[Run]:
        return self._tracker.run(name, parent=self, params=flatten(params or {}))


def _open_experiment(outputs: Path, name: str) -> tuple[MlflowClient, str]:
    """Connect to the database in ``outputs``; create it and the experiment if they do not exist."""
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"
    for noisy in ("alembic", "mlflow.store.db.utils", "mlflow.system_metrics"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    from filelock import FileLock
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException

    outputs.mkdir(parents=True, exist_ok=True)
    # Two processes that both find no tables would both create them.
    with FileLock(outputs / "mlflow.lock"):
        client = MlflowClient(f"sqlite:///{outputs / 'mlflow.db'}?timeout=60")
        experiment = client.get_experiment_by_name(name)
        if experiment is not None:
            return client, experiment.experiment_id
        with contextlib.suppress(MlflowException):
            client.delete_experiment("0")  # MLflow's empty default experiment
        # With this kind, the UI opens on training runs; without it, on traces of language models.
        tags = {"mlflow.experimentKind": "custom_model_development", "mlflow.note.content": _DESCRIPTION}
        return client, client.create_experiment(name, artifact_location=(outputs / "mlruns").as_uri(), tags=tags)


def _log_params(client: MlflowClient, run_id: str, params: Mapping[str, Any]) -> None:
    from mlflow.entities import Param

    entries = [Param(key, str(value)[:_MAX_PARAM_LENGTH]) for key, value in params.items()]
    known = client.get_run(run_id).data.params  # parameters of a resumed run cannot be changed
    entries = [entry for entry in entries if entry.key not in known]
    for start in range(0, len(entries), _BATCH):
        client.log_batch(run_id, params=entries[start : start + _BATCH])
