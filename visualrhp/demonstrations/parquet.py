"""Demonstrations as Parquet tables.

``transitions.parquet``: one row per transition, in the order of demonstrations and steps.

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
``return``          double                             Monte Carlo return from s_l (Eq. 4), discount 0.995
``is_goal``         bool                               s_{l+1} is a goal: true in the last row of a demonstration
``next_...``        as above                           s_{l+1}: the four columns of a state
==================  =================================  =========================================================

``scenes.parquet``: one row per demonstration.

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

The export is lossless. The metadata of the schema holds the content hash and the action space.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.returns import monte_carlo_returns
from visualrhp.files import atomic_path
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.scene import TaskInstance
from visualrhp.types import ActionSpaceName, Episode

_TRIPLE = pa.list_(pa.float64(), 3)
_POINTS = pa.list_(pa.list_(pa.float64(), 2))
_GRIPPER_FIELDS = tuple(field.name for field in dataclasses.fields(Gripper))
ROWS_PER_GROUP = 50_000
"""Number of transitions that are written at a time."""

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
    """Write ``transitions.parquet`` and ``scenes.parquet`` (see the module) to ``folder``, in chunks.

    Args:
        demonstrations: the demonstrations to export.
        folder: of the tables; created if missing.
        num_objects: number of objects whose demonstrations are exported; None for all.

    Returns:
        Number of demonstrations.

    Raises:
        DataError: there is no demonstration with that number of objects.
    """
    folder = Path(folder)
    positions = demonstrations.positions(num_objects)
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
            if len(rows) >= ROWS_PER_GROUP or number == len(positions) - 1:
                transitions.write_table(pa.Table.from_pylist(rows, tables["transitions"]))
                scenes.write_table(pa.Table.from_pylist(scene_rows, tables["scenes"]))
                rows, scene_rows = [], []
    return len(positions)


def _transition_rows(number: int, instance: int, episode: Episode) -> Iterator[dict[str, Any]]:
    returns = monte_carlo_returns(episode.rewards)
    states = [
        {
            "gripper_pose": state.gripper_pose.tolist(),
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
