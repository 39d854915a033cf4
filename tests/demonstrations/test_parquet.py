"""Parquet tables hold every number of a set."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.demonstrations.conftest import STORED_COUNT
from visualrhp.demonstrations import parquet
from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.parquet import SCENE_SCHEMA, export_parquet, transition_schema
from visualrhp.errors import DataError


def test_parquet_keeps_every_bit(tmp_path: Path, stored: DemonstrationSet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "ROWS_PER_GROUP", 20)
    assert export_parquet(stored, tmp_path) == STORED_COUNT
    transitions = pq.read_table(tmp_path / "transitions.parquet")
    assert pq.ParquetFile(tmp_path / "transitions.parquet").num_row_groups > 1
    assert transitions.schema.equals(transition_schema(stored.action_space))
    assert transitions.schema.metadata[b"content_hash"].decode() == stored.card["content_hash"]
    rows, scenes = transitions.to_pylist(), pq.read_table(tmp_path / "scenes.parquet").to_pylist()
    assert len(rows) == stored.num_transitions and len(scenes) == STORED_COUNT
    returns = stored.returns()
    row_number = 0
    for number, (task, episode) in enumerate(stored):
        scene = scenes[number]
        assert scene["instance"] == stored.indices[number] and scene["num_actions"] == len(episode)
        assert scene["target"] == [*task.scene.target.position, task.scene.target.radius]
        assert scene["edges"] == task.scene.edges.tolist()
        assert scene["outlines"] == [shape.outline.tolist() for shape in task.scene.objects]
        assert scene["frictions"] == [shape.friction for shape in task.scene.objects]
        assert scene["densities"] == [shape.density for shape in task.scene.objects]
        assert scene["gripper"] == dataclasses.asdict(task.scene.gripper)
        for step in range(len(episode)):
            row = rows[row_number]
            assert (row["demonstration"], row["instance"], row["step"]) == (number, stored.indices[number], step)
            for prefix, state in (("", episode.states[step]), ("next_", episode.states[step + 1])):
                vector = [
                    *row[f"{prefix}gripper_pose"],
                    row[f"{prefix}gripper_opening"],
                    float(row[f"{prefix}gripper_closed"]),
                    *np.ravel(row[f"{prefix}object_poses"]),
                ]
                assert np.array(vector).tobytes() == state.vector.tobytes()
            assert np.array_equal(row["action"], episode.actions[step])
            assert row["reward"] == episode.rewards[step] and row["return"] == returns[row_number]
            assert row["is_goal"] == (step == len(episode) - 1)
            row_number += 1


def test_one_number_of_objects_is_exported(tmp_path: Path, stored: DemonstrationSet) -> None:
    expected = int((stored.num_objects == 2).sum())
    assert export_parquet(stored, tmp_path, num_objects=2) == expected > 0
    rows = pq.read_table(tmp_path / "scenes.parquet").to_pylist()
    assert {row["num_objects"] for row in rows} == {2}
    assert [row["demonstration"] for row in rows] == list(range(expected))
    with pytest.raises(DataError, match="no demonstration with 7 objects; the set has 1, 2, 3"):
        export_parquet(stored, tmp_path, num_objects=7)


def test_the_documented_columns_are_those_of_the_tables() -> None:
    documented = parquet.__doc__ or ""
    for schema in (transition_schema("discrete"), SCENE_SCHEMA):
        for name in schema.names:
            assert f"``{name}``" in documented or name.startswith("next_"), name
