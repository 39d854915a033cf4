"""Runs in a real MLflow database."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pipelines.config import TrainILConfig
from pipelines.workflow.app import compose
from pipelines.workflow.names import metric_name
from pipelines.workflow.tracking import flatten, open_run
from pipelines.workflow.workspace import locked
from visualrhp.errors import DataError


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One database for all tests: to make one takes seconds."""
    level = logging.getLogger("alembic").level
    yield tmp_path_factory.mktemp("outputs")
    while LEFT_OPEN:
        LEFT_OPEN.pop().__exit__(None, None, None)
    logging.getLogger("alembic").setLevel(level)


@pytest.fixture
def configure(outputs: Path) -> Callable[..., TrainILConfig]:
    def make(*overrides: str) -> TrainILConfig:
        own = [f"paths.outputs={outputs}", "tracking.system_metrics=false"]
        return compose("train_il", TrainILConfig, [*own, *overrides])

    return make


@pytest.fixture
def client(outputs: Path) -> Any:
    from mlflow import MlflowClient

    return MlflowClient(f"sqlite:///{outputs / 'mlflow.db'}")


def test_what_a_run_records(configure: Callable[..., TrainILConfig], client: Any, tmp_path: Path) -> None:
    (tmp_path / "figure.svg").write_text("<svg/>")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "a.txt").write_text("a")
    with open_run(configure("seed=3", "learner.lr=0.25"), "train_il", "imitation continuous image") as run:
        assert run.id is not None
        run.log_metrics({"train/loss": 2.0, "absent": None}, step=0)
        run.log_metrics({"train/loss": 1.0}, step=1)
        run.log_artifact(tmp_path / "figure.svg")
        run.log_artifact(tmp_path / "folder")
    recorded = client.get_run(run.id)
    assert recorded.info.run_name == "imitation continuous image"
    assert recorded.info.status == "FINISHED"
    assert recorded.data.params["seed"] == "3"
    assert recorded.data.params["scale"] == "quick"
    assert recorded.data.params["learner.lr"] == "0.25"
    tags = recorded.data.tags
    assert (tags["stage"], tags["mlflow.source.name"]) == ("train_il", "pipelines.train_il")
    history = client.get_metric_history(run.id, "train/loss")
    assert [(metric.step, metric.value) for metric in history] == [(0, 2.0), (1, 1.0)]
    assert "absent" not in recorded.data.metrics
    assert "figure.svg" in [entry.path for entry in client.list_artifacts(run.id)]
    experiment = client.get_experiment(recorded.info.experiment_id)
    assert experiment.name == "VisualRHP"
    assert experiment.tags["mlflow.experimentKind"] == "custom_model_development"


def test_an_unfinished_run_is_resumed(configure: Callable[..., TrainILConfig], client: Any, tmp_path: Path) -> None:
    ids: list[tuple[Any, Any]] = []

    def interrupted(step: int) -> None:
        with (
            open_run(configure(), "train_il", "resumed", tmp_path) as run,
            run.child("m=4", {"num_objects": 4}) as child,
        ):
            child.log_metrics({"train/loss": float(step)}, step)
            ids.append((run.id, child.id))
            raise KeyboardInterrupt

    for step in range(2):
        with pytest.raises(KeyboardInterrupt):
            interrupted(step)
        assert [client.get_run(run_id).info.status for run_id in ids[-1]] == ["KILLED", "KILLED"]
    assert ids[0] == ids[1]
    parent, child_id = ids[0]
    assert client.get_run(child_id).data.tags["mlflow.parentRunId"] == parent
    assert client.get_run(child_id).data.params == {"num_objects": "4"}
    assert [metric.step for metric in client.get_metric_history(child_id, "train/loss")] == [0, 1]
    with open_run(configure(), "train_il", "resumed", tmp_path):
        pass
    assert client.get_run(parent).info.status == "FINISHED"
    with open_run(configure(), "train_il", "resumed", tmp_path / "other") as other:
        assert other.id != parent


def test_a_failed_run_is_marked_as_failed(configure: Callable[..., TrainILConfig], client: Any) -> None:
    with pytest.raises(ZeroDivisionError), open_run(configure(), "train_il", "failing") as run:
        raise ZeroDivisionError
    assert client.get_run(run.id).info.status == "FAILED"


def test_the_machine_is_recorded(configure: Callable[..., TrainILConfig], client: Any) -> None:
    config = configure("tracking.system_metrics=true")
    with open_run(config, "train_il", "monitored") as run:
        pass  # the monitor writes what it has when it is stopped, or after its interval
    assert client.get_run(run.id).info.status == "FINISHED"


def test_dvc_and_git_are_named(
    configure: Callable[..., TrainILConfig], client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DVC_STAGE", "train_il@continuous-image")
    monkeypatch.setattr("pipelines.workflow.tracking.git_commit", lambda: "0123abc")
    with open_run(configure(), "train_il", "under DVC") as run:
        pass
    tags = client.get_run(run.id).data.tags
    assert (tags["dvc.stage"], tags["mlflow.source.git.commit"]) == ("train_il@continuous-image", "0123abc")


def test_no_tracking_makes_nothing(tmp_path: Path) -> None:
    config = compose("train_il", TrainILConfig, ["tracking=none", f"paths.outputs={tmp_path / 'outputs'}"])
    with open_run(config, "train_il", "untracked") as run, run.child("m=1") as child:
        run.log_metrics({"a": 1.0}, 0)
        child.log_artifact(tmp_path)
        assert run.id is None
    assert not (tmp_path / "outputs").exists()


@pytest.mark.parametrize("name", ["success_rate/VisualRHP+ 3x3", "a (b), c=[1,2]?", "progress/a_b-c.d: e"])
def test_metrics_of_any_name_are_recorded(configure: Callable[..., TrainILConfig], client: Any, name: str) -> None:
    with open_run(configure(), "train_il", "names") as run:
        run.log_metrics({name: 0.5})
    assert client.get_run(run.id).data.metrics == {metric_name(name): 0.5}


def test_flatten() -> None:
    assert flatten({"a": {"b": 1, "c": {"d": (1, 7)}}, "e": {}}) == {"a.b": 1, "a.c.d": (1, 7), "e": {}}


# ------------------------------------------------------------------------------------------------------- after a kill
@pytest.fixture
def work(outputs: Path, request: pytest.FixtureRequest) -> Path:
    """A work folder in the outputs."""
    folder = outputs / "work" / "train_il" / str(abs(hash(request.node.name)))
    folder.mkdir(parents=True)
    return folder


LEFT_OPEN: list[Any] = []
"""Runs of killed processes; a run that is collected as garbage would end as KILLED."""


def kill(config: TrainILConfig, work: Path, metrics: dict[str, float], step: int) -> str:
    """A process that is killed while its run is open: the run stays RUNNING."""
    opened = open_run(config, "train_il", "killed", work)
    run = opened.__enter__()
    LEFT_OPEN.append(opened)
    run.log_metrics(metrics, step)
    assert run.id is not None
    return run.id


def test_every_step_is_recorded_once(configure: Callable[..., TrainILConfig], client: Any, work: Path) -> None:
    first = kill(configure(), work, {"train/loss": 2.0}, 0)
    assert client.get_run(first).info.status == "RUNNING"
    with open_run(configure(), "train_il", "killed", work) as run:
        for step in range(3):  # a resumed stage tracks its whole history
            run.log_metrics({"train/loss": 2.0 - step, "train/other": 1.0}, step)
    assert run.id == first
    for name in ("train/loss", "train/other"):
        assert [metric.step for metric in client.get_metric_history(first, name)] == [0, 1, 2]


def test_runs_of_killed_processes_are_closed(configure: Callable[..., TrainILConfig], client: Any, work: Path) -> None:
    orphan = kill(configure(), work, {}, 0)
    runs = work.with_name(work.name + ".runs.json")
    runs.unlink()  # killed before the id was stored
    with locked(work), open_run(configure(), "train_il", "next", work) as run:
        assert client.get_run(orphan).info.status == "KILLED"
        with open_run(configure(), "train_il", "at the same time"):
            assert client.get_run(run.id).info.status == "RUNNING"
    assert client.get_run(run.id).info.status == "FINISHED"


def test_damaged_ids_are_named(configure: Callable[..., TrainILConfig], work: Path) -> None:
    runs = work.with_name(work.name + ".runs.json")
    for content in ("[]", '{"a": 1}', "{", ""):
        runs.write_text(content)
        with (
            pytest.raises(DataError, match=r"\.runs\.json .*delete it"),
            open_run(configure(), "train_il", "damaged", work),
        ):
            pass


def test_half_copied_files_are_removed(configure: Callable[..., TrainILConfig], outputs: Path, work: Path) -> None:
    run_id = kill(configure(), work, {}, 0)
    half = outputs / "mlruns" / run_id / "artifacts" / "videos" / ".artifact.uploading.ab12cd"
    half.parent.mkdir(parents=True)
    half.write_text("half")
    with open_run(configure(), "train_il", "killed", work) as run:
        assert run.id == run_id
        assert not half.exists()
