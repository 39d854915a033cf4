"""The table of episodes: one row per episode, and the one schema of its columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

import pandas as pd
import pyarrow as pa

from visualrhp.errors import DataError
from visualrhp.evaluation.methods import Method
from visualrhp.execution.episode import EpisodeResult
from visualrhp.files import read_json
from visualrhp.scene.noise import NoiseLevel
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.types import ActionSpaceName

ColumnKind = Literal["text", "integer", "optional integer", "number", "boolean"]

_DTYPES: Final[dict[ColumnKind, str]] = {
    "text": "str",
    "integer": "int64",
    "optional integer": "Int64",
    "number": "float64",
    "boolean": "bool",
}


@dataclass(frozen=True, slots=True)
class EpisodeColumn:
    """A column of the table of episodes: type, and meaning with its unit."""

    kind: ColumnKind
    meaning: str


SETTING_COLUMNS: Final[Mapping[str, EpisodeColumn]] = {
    "experiment": EpisodeColumn("text", "block of the suite, or 'single'"),
    "planner": EpisodeColumn("text", "name of the planner"),
    "action_space": EpisodeColumn("text", "'continuous' or 'discrete'"),
    "num_rollouts": EpisodeColumn("optional integer", "n of receding horizon planning"),
    "horizon": EpisodeColumn("optional integer", "h of receding horizon planning"),
    "scene_num_objects": EpisodeColumn("text", "m that was requested: '4', or '1-7' where it is drawn at random"),
    "object_size": EpisodeColumn("text", "'small', 'mixed' or 'large'"),
    "layout": EpisodeColumn("text", "layout of the scenes (visualrhp.scene.sampling.Layout)"),
    "noise_level": EpisodeColumn("text", "'none', 'low', 'medium' or 'high' (Sec. 8.2)"),
    "seed": EpisodeColumn("integer", "seed of the task instances"),
}
"""Columns that name a setting (:class:`Setting`)."""

RESULT_COLUMNS: Final[Mapping[str, EpisodeColumn]] = {
    "num_objects": EpisodeColumn("integer", "m of the scene"),
    "success": EpisodeColumn("boolean", "whether the task was completed"),
    "dropped": EpisodeColumn("boolean", "whether an object fell off the surface"),
    "outcome": EpisodeColumn("text", "value of Outcome"),
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


def read_episodes(path: Path) -> pd.DataFrame:
    """Read a table of episodes from a Parquet file.

    Raises:
        DataError: the file is missing or damaged, lacks a column, has one of another type, or has no rows.
    """
    if not path.is_file():
        raise DataError(f"{path.parent} has no file {path.name}; make it with python -m pipelines.evaluate")
    again = "make it again with python -m pipelines.evaluate"
    try:
        episodes = pd.read_parquet(path)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DataError(f"{path} is damaged or is not a Parquet file ({error}); {again}") from error
    missing = [name for name in EPISODE_COLUMNS if name not in episodes.columns]
    if missing:
        raise DataError(f"{path} lacks the columns {', '.join(missing)}; {again}")
    if episodes.empty:
        raise DataError(f"{path} has no rows; {again}")
    for name, column in EPISODE_COLUMNS.items():
        if not _has_kind(episodes[name], column.kind):
            raise DataError(f"the column {name} of {path} is {episodes[name].dtype}, not {column.kind}; {again}")
    return episodes


def read_evaluation(folder: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """The table of episodes and the card in a folder made by ``python -m pipelines.evaluate``.

    Raises:
        DataError: either is missing or damaged (:func:`read_episodes`).
    """
    return read_episodes(folder / "episodes.parquet"), read_json(folder / "evaluation.json")


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
