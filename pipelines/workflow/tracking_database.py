"""The MLflow database of the outputs: opened, checked, and adapted when the outputs were moved or copied."""

from __future__ import annotations

import contextlib
import logging
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pipelines.workflow.surroundings import storage_error
from visualrhp.errors import ConfigError, DataError
from visualrhp.files import atomic_path

if TYPE_CHECKING:
    from mlflow import MlflowClient

DATABASE: Final = "mlflow.db"
ARTIFACTS: Final = "mlruns"
_TIMEOUT_S = 60
PATIENCE_S = 20
"""How long a start waits for a database that another process uses."""
_DESCRIPTION = """\
Runs of the pipelines. Every stage is a run; parts of a stage are its children. Charts are grouped by `train/`,
`validation/`, `collection/` and so on; select runs and press *Compare* to compare them. Videos and figures are
among the artefacts.
"""
_LOCATIONS: Final = (
    ("experiments", "artifact_location"),
    ("runs", "artifact_uri"),
    ("logged_models", "artifact_location"),
)
"""Tables and columns with absolute paths of files; all have the id of an experiment."""
_OWN_TAG: Final = "visualrhp.outputs"
"""Tag of the experiments whose files are in the outputs."""
_OWN_NOTE: Final = "Runs of the pipelines.%"
"""Begin of the description, which experiments of earlier versions have, too."""
_MAX_NAME: Final = 250


def open_experiment(outputs: Path, name: str) -> tuple[MlflowClient, str]:
    """Connect to the database in ``outputs``; create it and the experiment if they do not exist.

    Returns:
        The client, and the id of the experiment.

    Raises:
        ConfigError: ``name`` is not a valid name of an experiment, or MLflow cannot use the path of ``outputs``.
        DataError: the database cannot be used.
    """
    if not name.strip() or len(name) > _MAX_NAME or name == "Default":
        raise ConfigError(
            f"tracking.experiment={name[:80]!r} cannot be used: it should be the name of an MLflow experiment, of at "
            f"most {_MAX_NAME} characters, and not Default, which is MLflow's own."
        )
    if found := sorted(set("?%") & set(str(outputs))):
        raise ConfigError(
            f"MLflow cannot have its database in {outputs}, whose path contains {' and '.join(found)}; choose another "
            "folder with paths.outputs, or set tracking=none."
        )
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"
    for noisy in ("alembic", "mlflow.store.db.utils", "mlflow.system_metrics"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    outputs.mkdir(parents=True, exist_ok=True)
    check_database(outputs / DATABASE)
    from filelock import FileLock
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException

    # Two processes that both find no tables would both create them.
    with FileLock(outputs / "mlflow.lock"):
        is_new = _create_database(outputs / DATABASE)
        if not is_new:
            relocate(outputs)
        client = MlflowClient(database_uri(outputs / DATABASE))
        experiment = client.get_experiment_by_name(name)
        if experiment is None:
            if is_new:
                with contextlib.suppress(MlflowException):
                    client.delete_experiment("0")  # MLflow's empty default experiment
            # With this kind, the UI opens on training runs; without it, on traces of language models.
            kind = {"mlflow.experimentKind": "custom_model_development", "mlflow.note.content": _DESCRIPTION}
            location = (outputs / ARTIFACTS).as_uri()
            tags = {**kind, _OWN_TAG: ARTIFACTS}
            return client, client.create_experiment(name, artifact_location=location, tags=tags)
        if experiment.lifecycle_stage != "active":
            raise ConfigError(
                f"The MLflow experiment {name} was deleted; restore it (mlflow experiments restore --experiment-id "
                f"{experiment.experiment_id}), or choose another name with tracking.experiment=<name>."
            )
        return client, experiment.experiment_id


def database_uri(path: Path) -> str:
    """The URI of a database for MLflow."""
    return f"sqlite:///{path.as_posix()}?timeout={_TIMEOUT_S}"


def check_database(path: Path) -> None:
    """Check that a database can be read, which MLflow would try for minutes.

    Raises:
        DataError: it is damaged, not a file, or not accessible.
    """
    advice = "move it away to start a new one, or run without tracking (tracking=none)"
    if not path.exists() and not path.is_symlink():
        return
    if not path.is_file():
        what = "a folder" if path.is_dir() else "not a file"
        raise DataError(f"{path} is {what}, but should be the database of MLflow; {advice}")
    if not os.access(path, os.R_OK | os.W_OK):
        raise DataError(f"{path}, the database of MLflow, is not readable and writable for this user; {advice}")
    try:
        with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True, timeout=PATIENCE_S)) as connection:
            for table, column in _LOCATIONS:
                if _has_column(connection, table, column):
                    connection.execute(f"SELECT {column} FROM {table} LIMIT 1").fetchall()
    except sqlite3.Error as error:
        if _is_in_use(error):
            raise DataError(
                f"{path}, the database of MLflow, is in use by another process; rerun the command when it is free, or "
                "run without tracking (tracking=none)"
            ) from error
        raise DataError(f"{path}, the database of MLflow, is damaged ({error}); {advice}") from error


def relocate(outputs: Path) -> None:
    """Let the files of all runs be found in ``outputs`` after these were moved or copied.

    MLflow stores absolute paths. Those of the experiments of the pipelines are changed; other experiments are not.
    """
    location = (outputs / ARTIFACTS).as_uri()
    with closing(sqlite3.connect(outputs / DATABASE, timeout=_TIMEOUT_S)) as connection, connection:
        if not _has_column(connection, "experiments", "artifact_location"):
            return
        found = connection.execute(
            "SELECT DISTINCT experiment_id, artifact_location FROM experiments JOIN experiment_tags "
            "USING (experiment_id) WHERE key = ? OR (key = 'mlflow.note.content' AND value LIKE ?)",
            (_OWN_TAG, _OWN_NOTE),
        ).fetchall()
        for experiment, place in found:
            if not place or place == location or not (place.startswith("file:") and place.endswith(f"/{ARTIFACTS}")):
                continue
            for table, column in _LOCATIONS:
                if _has_column(connection, table, column):
                    connection.execute(
                        f"UPDATE {table} SET {column} = ? || substr({column}, ?) "
                        f"WHERE experiment_id = ? AND ({column} = ? OR substr({column}, 1, ?) = ?)",
                        (location, len(place) + 1, experiment, place, len(place) + 1, f"{place}/"),
                    )


@contextmanager
def explain_tracking(outputs: Path) -> Iterator[None]:
    """Report failures of MLflow and its database in the block in one sentence.

    Raises:
        StorageError: the disk is full, or a file cannot be written.
        DataError: MLflow failed for another reason.
    """
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except (MlflowException, SQLAlchemyError, sqlite3.Error) as error:
        if (explained := storage_error(error, outputs / "work")) is not None:
            raise explained from error
        text = " ".join(str(error).split())
        if _is_in_use(error):
            raise DataError(
                f"{outputs / DATABASE}, the database of MLflow, is in use by another process; rerun the command to "
                "resume when it is free"
            ) from error
        raise DataError(
            f"MLflow failed with {outputs / DATABASE}: {text[:500]}. Rerun the command to resume, or run without "
            "MLflow (tracking=none)."
        ) from error


def _is_in_use(error: Exception) -> bool:
    return any(word in str(error) for word in ("database is locked", "database table is locked", "SQLITE_BUSY"))


def _create_database(path: Path) -> bool:
    """Create the database of MLflow if there is none, in one step: MLflow cannot continue with half of its tables.

    Returns:
        Whether it was created.
    """
    from mlflow import MlflowClient

    for unfinished in path.parent.glob(f".{path.stem}.*.tmp{path.suffix}*"):  # of a killed process
        unfinished.unlink()
    if path.exists() and path.stat().st_size > 0:
        return False
    with atomic_path(path) as temporary:
        MlflowClient(database_uri(temporary)).search_experiments()
    return True


def _has_column(connection: sqlite3.Connection, table: str, column: str) -> bool:
    return any(row[1] == column for row in connection.execute(f"PRAGMA table_info({table})"))
