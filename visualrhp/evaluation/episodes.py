"""The table of episodes: one row per episode, and the one schema of its columns."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator

from visualrhp.documents import FileKind, brief, shown_path
from visualrhp.errors import DataError
from visualrhp.evaluation.evaluation_card import EVALUATION_CARD, EvaluationCard
from visualrhp.evaluation.failures import Failure, failure_of
from visualrhp.evaluation.methods import ACTION_SPACES, NOISE_ORDER, SIZES, Method
from visualrhp.execution.episode import EpisodeResult
from visualrhp.files import atomic_path
from visualrhp.parameters import one_of, show
from visualrhp.scene.noise import NoiseLevel
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.types import ActionSpaceName, Outcome

ColumnKind = Literal["text", "integer", "optional integer", "number", "boolean"]

_COMMAND: Final = "python -m pipelines.evaluate"
_AGAIN: Final = f"make it again with {_COMMAND}"
EPISODES: Final = FileKind("a table of episodes (a Parquet file)", _AGAIN)

_JSON_TYPES: Final[dict[ColumnKind, tuple[type, ...]]] = {
    "text": (str,),
    "integer": (int,),
    "optional integer": (int, type(None)),
    "number": (float, int),
    "boolean": (bool,),
}
_DTYPES: Final[dict[ColumnKind, str]] = {
    "text": "str",
    "integer": "int64",
    "optional integer": "Int64",
    "number": "float64",
    "boolean": "bool",
}


@dataclass(frozen=True, slots=True)
class EpisodeColumn:
    """A column of the table of episodes: type, meaning with its unit, and values where they are few."""

    kind: ColumnKind
    meaning: str
    values: tuple[str, ...] | None = None


SETTING_COLUMNS: Final[Mapping[str, EpisodeColumn]] = {
    "experiment": EpisodeColumn("text", "block of the suite, or 'single'"),
    "planner": EpisodeColumn("text", "name of the planner"),
    "action_space": EpisodeColumn("text", "'continuous' or 'discrete'", ACTION_SPACES),
    "num_rollouts": EpisodeColumn("optional integer", "n of receding horizon planning"),
    "horizon": EpisodeColumn("optional integer", "h of receding horizon planning"),
    "scene_num_objects": EpisodeColumn("text", "m that was requested: '4', or '1-7' where it is drawn at random"),
    "object_size": EpisodeColumn("text", "'small', 'mixed' or 'large'", SIZES),
    "layout": EpisodeColumn("text", "layout of the scenes (visualrhp.scene.sampling.Layout)"),
    "noise_level": EpisodeColumn("text", "'none', 'low', 'medium' or 'high' (Sec. 8.2)", NOISE_ORDER),
    "seed": EpisodeColumn("integer", "seed of the task instances"),
}
"""Columns that name a setting (:class:`Setting`)."""

RESULT_COLUMNS: Final[Mapping[str, EpisodeColumn]] = {
    "num_objects": EpisodeColumn("integer", "m of the scene"),
    "success": EpisodeColumn("boolean", "whether the task was completed"),
    "dropped": EpisodeColumn("boolean", "whether an object fell off the surface"),
    "outcome": EpisodeColumn("text", "value of Outcome", tuple(outcome.value for outcome in Outcome)),
    "failure": EpisodeColumn(
        "text", "why it failed (Failure); 'none' if it did not", tuple(kind.value for kind in Failure)
    ),
    "num_actions": EpisodeColumn("integer", "actions executed; without a plan, the action limit"),
    "action_efficiency": EpisodeColumn("number", "objects over actions until completion; NaN if not completed"),
    "decision_time_s": EpisodeColumn("number", "wall-clock time of all decisions [s]"),
    "mean_decision_time_s": EpisodeColumn("number", "wall-clock time of decisions per action [s]"),
    "max_decision_time_s": EpisodeColumn("number", "wall-clock time of the longest decision [s]"),
    "simulation_time_s": EpisodeColumn("number", "wall-clock time to execute the actions [s]"),
    "execution_time_s": EpisodeColumn("number", "planning and execution time of the run [s]"),
    "return": EpisodeColumn("number", "G_0 of Sec. 4 over the executed actions"),
    "num_invalid_rollouts": EpisodeColumn("integer", "roll-outs that diverged, over all decisions"),
}
"""Columns that an episode gives (:func:`episode_row`)."""

EPISODE_COLUMNS: Final[Mapping[str, EpisodeColumn]] = {
    **SETTING_COLUMNS,
    "episode": EpisodeColumn("integer", "index of the task instance"),
    **RESULT_COLUMNS,
}
"""The schema of the table of episodes."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A planner in a setting, evaluated on a series of task instances; the attributes are :data:`SETTING_COLUMNS`."""

    experiment: str
    planner: str
    action_space: ActionSpaceName
    num_rollouts: int | None
    horizon: int | None
    scene_num_objects: str
    object_size: str
    layout: str
    noise_level: NoiseLevel
    seed: int

    @classmethod
    def of(
        cls,
        experiment: str,
        planner: Any,
        action_space: ActionSpaceName,
        distribution: SceneDistribution,
        noise_level: NoiseLevel,
        seed: int,
    ) -> Setting:
        """The setting of a planner, or of the parameters of one (:meth:`~visualrhp.evaluation.methods.Method.of`)."""
        low, high = distribution.num_objects
        return cls(
            experiment=experiment,
            **asdict(Method.of(planner)),
            action_space=action_space,
            scene_num_objects=str(low) if low == high else f"{low}-{high}",
            object_size=distribution.object_size,
            layout=distribution.layout,
            noise_level=noise_level,
            seed=seed,
        )


def episode_row(result: EpisodeResult) -> dict[str, Any]:
    """The :data:`RESULT_COLUMNS` of an episode, as JSON but for NaN."""
    return {
        "num_objects": result.num_objects,
        "success": result.success,
        "dropped": result.dropped,
        "outcome": result.outcome.value,
        "failure": failure_of(result.scene, result.episode).value,
        "num_actions": result.num_actions,
        "action_efficiency": result.action_efficiency,
        "decision_time_s": result.decision_time_s,
        "mean_decision_time_s": result.decision_time_s / max(1, result.num_actions),
        "max_decision_time_s": max((timed.time_s for timed in result.decisions), default=0.0),
        "simulation_time_s": result.simulation_time_s,
        "execution_time_s": result.execution_time_s,
        "return": result.discounted_return,
        "num_invalid_rollouts": result.num_invalid_rollouts,
    }


def episodes_table(episodes: Iterable[tuple[Setting, int, Mapping[str, Any]]]) -> pd.DataFrame:
    """The table of (setting, index of the task instance, :func:`episode_row`), in their order."""
    rows = [asdict(setting) | {"episode": index} | dict(row) for setting, index, row in episodes]
    table = pd.DataFrame(rows, columns=list(EPISODE_COLUMNS))
    return table.astype({name: _DTYPES[column.kind] for name, column in EPISODE_COLUMNS.items()})


def write_episodes(path: Path, episodes: pd.DataFrame) -> None:
    """Write a table of episodes to a Parquet file, atomically, with checksums that reading verifies."""
    with atomic_path(path) as temporary:
        episodes.to_parquet(temporary, index=False, write_page_checksum=True)


def read_episodes(path: Path) -> pd.DataFrame:
    """Read a table of episodes from a Parquet file.

    Raises:
        DataError: the file is missing or damaged, lacks a column, has one of another type or with a value that is not
            possible, or has no rows.
    """
    if not os.path.lexists(path):
        raise DataError(f"{shown_path(path.parent)} has no file {path.name}; make it with {_COMMAND}")
    EPISODES.require(path)
    try:
        episodes = pd.read_parquet(path, page_checksum_verification=True)
    except Exception as error:  # pyarrow and pandas raise almost anything for bytes that they did not write
        raise EPISODES.unusable(path, f"is damaged or is not a Parquet file ({brief(error)})") from error
    missing = [name for name in EPISODE_COLUMNS if name not in episodes.columns]
    if missing:
        raise EPISODES.unusable(path, f"lacks the columns {', '.join(missing)}")
    if episodes.empty:
        raise EPISODES.unusable(path, "has no rows")
    for name, column in EPISODE_COLUMNS.items():
        if not _has_kind(episodes[name], column.kind):
            shown = shown_path(path)
            raise DataError(f"the column {name} of {shown} is {episodes[name].dtype}, not {column.kind}; {_AGAIN}.")
        if problem := _impossible(episodes[name], column):
            raise EPISODES.damaged(path, f"the column {name} has {problem}")
    return episodes


def read_evaluation(folder: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """The table of episodes and the card in a folder made by ``python -m pipelines.evaluate``.

    Raises:
        DataError: either is missing or damaged, or they do not belong together.
    """
    episodes = read_episodes(folder / "episodes.parquet")
    path = folder / "evaluation.json"
    card = EVALUATION_CARD.read_content(path)
    content: EvaluationCard = EVALUATION_CARD.check(path, EvaluationCard, card)
    if content.num_episodes != len(episodes):
        raise EVALUATION_CARD.damaged(
            path, f"it is of {content.num_episodes} episodes, but the table has {len(episodes)}"
        )
    return episodes, card


def check_row(row: Mapping[str, Any]) -> Mapping[str, Any]:
    """Check that a row of JSON values is one of :func:`episode_row`.

    Raises:
        ValueError: it lacks a column, has another one, or one with another type of value.
    """
    if unlike := sorted(row.keys() ^ RESULT_COLUMNS.keys()):
        raise ValueError(f"the columns {', '.join(unlike)[:200]} are missing or unknown")
    for name, column in RESULT_COLUMNS.items():
        value = row[name]
        if type(value) not in _JSON_TYPES[column.kind] or (column.values and value not in column.values):
            raise ValueError(f"{name}={show(value)} is not {column.kind}: {column.meaning}")
        if column.kind == "integer" and not 0 <= value < 1 << 31:
            raise ValueError(f"{name}={show(value)} is out of range")
    return row


EpisodeRow = Annotated[dict[str, Any], AfterValidator(check_row)]
"""The schema of an :func:`episode_row` in a journal."""


def _impossible(values: Any, column: EpisodeColumn) -> str | None:
    """What is wrong with the values of a column of the right type; None if nothing is."""
    if column.kind not in ("number", "optional integer") and values.isna().any():
        return "missing values"
    if column.values is not None and (unknown := sorted(set(values) - set(column.values))):
        return f"the value {show(unknown[0])}, not {one_of(column.values)}"
    if column.kind in ("integer", "optional integer") and (values.dropna().astype("int64") < 0).any():
        return "negative numbers"
    if column.kind == "number" and np.isinf(values.to_numpy(np.float64, na_value=np.nan)).any():
        return "infinite numbers"
    return None


def _has_kind(values: Any, kind: ColumnKind) -> bool:
    types = pd.api.types
    match kind:
        case "text":
            return types.is_string_dtype(values)
        case "integer":
            return types.is_integer_dtype(values)
        case "optional integer":
            return types.is_integer_dtype(values) or bool(values.isna().all())
        case "boolean":
            return types.is_bool_dtype(values)
        case "number":
            return types.is_float_dtype(values) or types.is_integer_dtype(values)
