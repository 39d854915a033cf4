"""Demonstrations in formats of others: Parquet tables, and Minari data sets (Sec. 6.1).

``transitions.parquet``: a row a transition, demonstrations in their order, steps in theirs.

==================  =================================  =========================================================
column              type                               content
==================  =================================  =========================================================
``demonstration``   int32                              number of the demonstration, from 0
``instance``        int64                              index of the task instance
``step``            int16                              l, from 0
``num_objects``     int8                               m
``gripper_pose``    fixed_size_list<double>[3]         s_l: x [m], y [m], theta [rad]
``gripper_opening`` double                             s_l: distance between the fingers [m]
``gripper_closed``  bool                               s_l: last commanded to close
``object_poses``    list<fixed_size_list<double>[3]>   s_l: [m, 3] x [m], y [m], theta [rad], the desired one first
``action``          int8, or                           a_l: discrete, or
                    fixed_size_list<double>[4]         continuous
``reward``          double                             r_{l+1}
``return``          double                             Monte Carlo return from s_l on (Eq. 4), discount 0.995
``is_goal``         bool                               s_{l+1} is a goal: true in the last row of a demonstration
``next_...``        as above                           s_{l+1}: the four columns of a state
==================  =================================  =========================================================

``scenes.parquet``: a row a demonstration.

==================  =================================  =========================================================
column              type                               content
==================  =================================  =========================================================
``demonstration``   int32                              as above
``instance``        int64                              as above
``num_objects``     int8                               m
``num_actions``     int16                              L
``target``          fixed_size_list<double>[3]         target region: x [m], y [m], radius [m]
``edges``           list<fixed_size_list<double>[2]>   vertices of the surface [m]
``outlines``        list<list<fixed_size_list[2]>>     outline of each object in its body frame [m]
``densities``       list<double>                       of each object [kg/m^2]
``frictions``       list<double>                       of each object
``gripper``         struct<double...>                  fields of :class:`visualrhp.scene.Gripper`
==================  =================================  =========================================================

All numbers are those of the set, to the bit. The schema's metadata holds the content hash and the action space.

A Minari data set is one of the registered environment ``visualrhp/ClutterManipulation-v0``: its observations (label
image or Cartesian features, and the gripper's state), actions (float32 where the set has float64, since that is the
environment's space), rewards, and ``terminated`` at the goal.
"""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from visualrhp.environments.task import ObservationFunction, ObservationName
from visualrhp.errors import ConfigError, DataError
from visualrhp.files import atomic_path
from visualrhp.learning.demonstrations import DemonstrationSet, monte_carlo_returns
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.scene import TaskInstance
from visualrhp.types import ActionSpaceName, Episode

ENVIRONMENT = "visualrhp/ClutterManipulation-v0"

_TRIPLE = pa.list_(pa.float64(), 3)
_POINTS = pa.list_(pa.list_(pa.float64(), 2))
_GRIPPER_FIELDS = tuple(field.name for field in dataclasses.fields(Gripper))
_ROWS_PER_GROUP = 50_000

_STATE_COLUMNS = (
    ("gripper_pose", _TRIPLE),
    ("gripper_opening", pa.float64()),
    ("gripper_closed", pa.bool_()),
    ("object_poses", pa.list_(_TRIPLE)),
)

SCENE_SCHEMA = pa.schema(
    [
        ("demonstration", pa.int32()),
        ("instance", pa.int64()),
        ("num_objects", pa.int8()),
        ("num_actions", pa.int16()),
        ("target", _TRIPLE),
        ("edges", _POINTS),
        ("outlines", pa.list_(_POINTS)),
        ("densities", pa.list_(pa.float64())),
        ("frictions", pa.list_(pa.float64())),
        ("gripper", pa.struct([(name, pa.float64()) for name in _GRIPPER_FIELDS])),
    ]
)


def transition_schema(action_space: ActionSpaceName) -> pa.Schema:
    """Columns and types of ``transitions.parquet``."""
    return pa.schema(
        [
            ("demonstration", pa.int32()),
            ("instance", pa.int64()),
            ("step", pa.int16()),
            ("num_objects", pa.int8()),
            *_STATE_COLUMNS,
            ("action", pa.int8() if action_space == "discrete" else pa.list_(pa.float64(), 4)),
            ("reward", pa.float64()),
            ("return", pa.float64()),
            ("is_goal", pa.bool_()),
            *((f"next_{name}", kind) for name, kind in _STATE_COLUMNS),
        ]
    )


def export_parquet(demonstrations: DemonstrationSet, folder: str | Path, num_objects: int | None = None) -> int:
    """Write ``transitions.parquet`` and ``scenes.parquet`` (see the module) to ``folder``; a part at a time.

    Args:
        demonstrations: what to export.
        folder: where to; created.
        num_objects: density whose demonstrations are exported; None for all.

    Returns:
        Number of demonstrations.

    Raises:
        DataError: there is no demonstration of that density.
    """
    folder = Path(folder)
    positions = _positions(demonstrations, num_objects)
    about = {"action_space": demonstrations.action_space, "content_hash": str(demonstrations.card["content_hash"])}
    tables = {
        "transitions": transition_schema(demonstrations.action_space).with_metadata(about),
        "scenes": SCENE_SCHEMA.with_metadata(about),
    }
    with (
        atomic_path(folder / "transitions.parquet") as transitions_path,
        atomic_path(folder / "scenes.parquet") as scenes_path,
        pq.ParquetWriter(transitions_path, tables["transitions"]) as transitions,
        pq.ParquetWriter(scenes_path, tables["scenes"]) as scenes,
    ):
        rows: list[dict[str, Any]] = []
        scene_rows: list[dict[str, Any]] = []
        for number, position in enumerate(positions):
            task, episode = demonstrations[position]
            instance = int(demonstrations.indices[position])
            rows += _transition_rows(number, instance, episode)
            scene_rows.append(_scene_row(number, instance, task, episode))
            if len(rows) >= _ROWS_PER_GROUP or number == len(positions) - 1:
                transitions.write_table(pa.Table.from_pylist(rows, tables["transitions"]))
                scenes.write_table(pa.Table.from_pylist(scene_rows, tables["scenes"]))
                rows, scene_rows = [], []
    return len(positions)


def export_minari(
    demonstrations: DemonstrationSet,
    folder: str | Path,
    dataset_id: str,
    observation: ObservationName = "image",
    num_objects: int | None = None,
) -> int:
    """Write a Minari data set (see the module), stored as HDF5; ``MINARI_DATASETS_PATH=<folder>`` finds it.

    Args:
        demonstrations: what to export.
        folder: of Minari data sets; created.
        dataset_id: what Minari calls it: ``(namespace/)(environment/)name-v0``.
        observation: what it shows of a state.
        num_objects: density whose demonstrations are exported; None for all (Cartesian features need one).

    Returns:
        Number of demonstrations.

    Raises:
        ConfigError: Minari is not installed, ``dataset_id`` is no name of its kind or exists in ``folder``, or
            Cartesian features are wanted of all densities.
        DataError: there is no demonstration of that density.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
    except ImportError as error:
        raise ConfigError("the package minari is not installed: pip install '.[minari]'") from error
    positions = _positions(demonstrations, num_objects)
    densities = demonstrations.num_objects
    bounds = (int(densities.min()), int(densities.max())) if num_objects is None else (num_objects, num_objects)
    observe = ObservationFunction(observation, num_objects)
    arguments = {"action_space": demonstrations.action_space, "observation": observation, "num_objects": bounds}
    environment = gymnasium.make(ENVIRONMENT, **arguments)

    def buffer(position: int) -> EpisodeBuffer:
        task, episode = demonstrations[position]
        actions: Any = _environment_actions(episode, environment.action_space)  # an array, as Minari stores it
        return EpisodeBuffer(
            observations={
                "observation": np.stack([observe(task.scene, state) for state in episode.states]),
                "gripper_closed": np.array([state.gripper_closed for state in episode.states], dtype=np.int64),
            },
            actions=actions,
            rewards=list(episode.rewards),
            terminations=[False] * (len(episode) - 1) + [True],
            truncations=[False] * len(episode),
        )

    with _minari_folder(Path(folder)), warnings.catch_warnings():
        # There is no address of the authors and of their code to give.
        warnings.filterwarnings("ignore", "`(author_email|code_permalink)` is set to None", UserWarning)
        try:
            # One file (Arrow would be two files an episode). Labels are no intensities: JPEG would make others of them.
            dataset = minari.create_dataset_from_buffers(
                dataset_id,
                [buffer(positions[0])],
                env=environment.spec,
                eval_env=environment.spec,
                algorithm_name="kinodynamic RRT",
                author="The VisualRHP authors",
                description=f"Demonstrations, content hash {demonstrations.card['content_hash']}",
                data_format="hdf5",
                jpeg_encoding=False,
            )
        except ValueError as error:
            raise ConfigError(f"Minari cannot make a data set called {dataset_id!r} in {folder}: {error}") from error
        dataset.storage.update_episodes(buffer(position) for position in positions[1:])  # one at a time
    environment.close()
    return len(positions)


def _positions(demonstrations: DemonstrationSet, num_objects: int | None) -> list[int]:
    every = demonstrations.num_objects
    positions = np.arange(len(every)) if num_objects is None else np.flatnonzero(every == num_objects)
    if not len(positions):
        raise DataError(
            f"there is no demonstration with {num_objects} objects; the set has "
            f"{', '.join(str(m) for m in np.unique(every)) or 'none at all'}"
        )
    return positions.tolist()


def _transition_rows(number: int, instance: int, episode: Episode) -> Iterator[dict[str, Any]]:
    returns = monte_carlo_returns(episode.rewards)
    states = [
        {
            "gripper_pose": state.robot_pose.tolist(),
            "gripper_opening": state.gripper_opening,
            "gripper_closed": state.gripper_closed,
            "object_poses": state.object_poses.tolist(),
        }
        for state in episode.states
    ]
    for step, action in enumerate(episode.actions):
        yield {
            "demonstration": number,
            "instance": instance,
            "step": step,
            "num_objects": episode.states[0].num_objects,
            **states[step],
            "action": action.tolist() if isinstance(action, np.ndarray) else action,
            "reward": episode.rewards[step],
            "return": float(returns[step]),
            "is_goal": step == len(episode) - 1,
            **{f"next_{name}": value for name, value in states[step + 1].items()},
        }


def _scene_row(number: int, instance: int, task: TaskInstance, episode: Episode) -> dict[str, Any]:
    scene = task.scene
    return {
        "demonstration": number,
        "instance": instance,
        "num_objects": scene.num_objects,
        "num_actions": len(episode),
        "target": [*scene.target.position.tolist(), scene.target.radius],
        "edges": scene.edges.tolist(),
        "outlines": [shape.outline.tolist() for shape in scene.objects],
        "densities": [shape.density for shape in scene.objects],
        "frictions": [shape.friction for shape in scene.objects],
        "gripper": dataclasses.asdict(scene.gripper),
    }


def _environment_actions(episode: Episode, space: gymnasium.Space[Any]) -> npt.NDArray[Any]:
    actions = np.array(episode.actions)
    if isinstance(space, gymnasium.spaces.Box):
        return actions.astype(np.float32).clip(space.low, space.high)
    return actions


@contextmanager
def _minari_folder(folder: Path) -> Iterator[None]:
    """Minari knows its folder from the environment alone."""
    name = "MINARI_DATASETS_PATH"
    before = os.environ.get(name)
    os.environ[name] = str(folder.absolute())
    try:
        yield
    finally:
        del os.environ[name]
        if before is not None:
            os.environ[name] = before
