"""The database of MLflow: created, moved, and refused where it cannot be used."""

from __future__ import annotations

import shutil
import sqlite3
import time
from contextlib import closing
from pathlib import Path

import pytest

from pipelines.workflow.tracking_database import (
    ARTIFACTS,
    DATABASE,
    check_database,
    explain_tracking,
    open_experiment,
)
from visualrhp.errors import ConfigError, DataError, StorageError


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Outputs with a run that has a file."""
    folder = tmp_path_factory.mktemp("original") / "outputs"
    client, experiment_id = open_experiment(folder, "VisualRHP")
    (folder / "figure.svg").write_text("<svg/>")
    client.log_artifact(client.create_run(experiment_id).info.run_id, str(folder / "figure.svg"))
    return folder


@pytest.mark.parametrize("place", ["moved", "a#b", "ü (with space) [1]"])
def test_runs_follow_the_outputs(outputs: Path, tmp_path: Path, place: str) -> None:
    there = tmp_path / place
    shutil.copytree(outputs, there)
    client, experiment_id = open_experiment(there, "VisualRHP")
    assert client.get_experiment(experiment_id).artifact_location == (there / ARTIFACTS).as_uri()
    (run,) = client.search_runs([experiment_id])
    assert run.info.artifact_uri == f"{(there / ARTIFACTS).as_uri()}/{run.info.run_id}/artifacts"
    assert Path(client.download_artifacts(run.info.run_id, "figure.svg")).read_text() == "<svg/>"
    before = sorted(outputs.rglob("*"))
    new = client.create_run(experiment_id).info.run_id
    client.log_artifact(new, str(outputs / "figure.svg"))
    assert sorted(outputs.rglob("*")) == before
    assert (there / ARTIFACTS / new / "artifacts" / "figure.svg").is_file()
    assert [path.name for path in tmp_path.iterdir()] == [place]


def test_paths_that_mlflow_misreads_are_refused(tmp_path: Path) -> None:
    for name in ("what?", "50%25", "a?b=c&d"):
        with pytest.raises(ConfigError, match=r"whose path contains [?%]; choose another"):
            open_experiment(tmp_path / name, "VisualRHP")
    assert not any(tmp_path.iterdir())


def test_the_original_does_not_change(outputs: Path) -> None:
    client, experiment_id = open_experiment(outputs, "VisualRHP")
    assert client.get_experiment(experiment_id).artifact_location == (outputs / ARTIFACTS).as_uri()


@pytest.mark.parametrize("damage", ["a folder", "no database", "truncated", "a dangling link", "a link loop"])
def test_a_database_that_cannot_be_read_is_refused_at_once(outputs: Path, tmp_path: Path, damage: str) -> None:
    path = tmp_path / DATABASE
    if damage == "a folder":
        path.mkdir()
    elif damage == "no database":
        path.write_text("my notes")
    elif damage == "truncated":
        path.write_bytes((outputs / DATABASE).read_bytes()[:5000])
    else:
        path.symlink_to(tmp_path / ("nowhere" if damage == "a dangling link" else DATABASE))
    started = time.monotonic()
    with pytest.raises(DataError, match=rf"{DATABASE}.*tracking=none"):
        open_experiment(tmp_path, "VisualRHP")
    assert time.monotonic() - started < 5.0


def test_a_killed_creation_is_started_again(tmp_path: Path) -> None:
    (tmp_path / DATABASE).touch()
    check_database(tmp_path / DATABASE)
    (tmp_path / ".mlflow.ab12.tmp.db").write_bytes(b"SQLite format 3")
    (tmp_path / ".mlflow.ab12.tmp.db-journal").write_bytes(b"")
    client, experiment_id = open_experiment(tmp_path, "VisualRHP")
    assert client.search_runs([experiment_id]) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == [DATABASE, "mlflow.lock"]


def test_names_of_experiments_are_checked(outputs: Path) -> None:
    for name in (" ", "Default", "x" * 600):
        with pytest.raises(ConfigError, match=r"tracking\.experiment=.* cannot be used"):
            open_experiment(outputs, name)
    client, experiment_id = open_experiment(outputs, "to be deleted")
    client.delete_experiment(experiment_id)
    with pytest.raises(ConfigError, match="was deleted"):
        open_experiment(outputs, "to be deleted")


def test_runs_and_experiments_of_others_are_not_touched(tmp_path: Path) -> None:
    from mlflow import MlflowClient

    client = MlflowClient(f"sqlite:///{tmp_path / DATABASE}")
    run_id = client.create_run("0").info.run_id
    elsewhere = (tmp_path / "other" / ARTIFACTS).as_uri()
    mine = client.create_experiment("mine", artifact_location=elsewhere)
    for _ in range(2):
        client, _ = open_experiment(tmp_path, "VisualRHP")
    assert client.get_run(run_id).info.lifecycle_stage == "active"
    assert client.get_experiment("0").lifecycle_stage == "active"
    assert client.get_experiment(mine).artifact_location == elsewhere


def test_a_database_in_use_is_not_called_damaged(
    outputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipelines.workflow.tracking_database.PATIENCE_S", 0.1)
    shutil.copytree(outputs, tmp_path / "outputs")
    database = tmp_path / "outputs" / DATABASE
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        with pytest.raises(DataError, match="is in use by another process"):
            check_database(database)


def test_errors_of_mlflow_are_explained(tmp_path: Path) -> None:
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import OperationalError

    with pytest.raises(DataError, match=r"MLflow failed with .*: no such run"), explain_tracking(tmp_path):
        raise MlflowException("no such run")
    with pytest.raises(StorageError, match="no space left"), explain_tracking(tmp_path):
        raise OperationalError("INSERT", {}, Exception("database or disk is full"))
    with pytest.raises(ZeroDivisionError), explain_tracking(tmp_path):
        raise ZeroDivisionError
