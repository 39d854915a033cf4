"""Demonstrations in formats of others: every number comes back."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest

from visualrhp.environments.task import ObservationFunction
from visualrhp.errors import ConfigError, DataError
from visualrhp.learning import exports
from visualrhp.learning.demonstrations import DemonstrationSet, DemonstrationWriter, generate_block
from visualrhp.learning.exports import SCENE_SCHEMA, export_minari, export_parquet, transition_schema
from visualrhp.planning import KinodynamicRRT
from visualrhp.scene import SceneDistribution
from visualrhp.types import ActionSpaceName

COUNT = 9


@pytest.fixture(scope="module", params=["continuous", "discrete"])
def stored(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> DemonstrationSet:
    space: ActionSpaceName = request.param
    folder = tmp_path_factory.mktemp(space)
    writer = DemonstrationWriter(folder, space, COUNT, shard_size=4)
    planner = KinodynamicRRT(max_simulations=600)
    writer.add(generate_block(range(14), SceneDistribution(num_objects=(1, 3)), space, planner, 5))
    writer.finish()
    return DemonstrationSet.open(folder)


def test_parquet_keeps_every_bit(tmp_path: Path, stored: DemonstrationSet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exports, "_ROWS_PER_GROUP", 20)
    assert export_parquet(stored, tmp_path) == COUNT
    transitions = pq.read_table(tmp_path / "transitions.parquet")
    assert pq.ParquetFile(tmp_path / "transitions.parquet").num_row_groups > 1
    assert transitions.schema.equals(transition_schema(stored.action_space))
    assert transitions.schema.metadata[b"content_hash"].decode() == stored.card["content_hash"]
    rows, scenes = transitions.to_pylist(), pq.read_table(tmp_path / "scenes.parquet").to_pylist()
    assert len(rows) == stored.num_transitions and len(scenes) == COUNT
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


def test_one_density_is_exported(tmp_path: Path, stored: DemonstrationSet) -> None:
    of_density = int((stored.num_objects == 2).sum())
    assert export_parquet(stored, tmp_path, num_objects=2) == of_density > 0
    rows = pq.read_table(tmp_path / "scenes.parquet").to_pylist()
    assert {row["num_objects"] for row in rows} == {2}
    assert [row["demonstration"] for row in rows] == list(range(of_density))
    with pytest.raises(DataError, match="no demonstration with 7 objects; the set has 1, 2, 3"):
        export_parquet(stored, tmp_path, num_objects=7)


def test_the_documented_columns_are_those_of_the_tables() -> None:
    documented = exports.__doc__ or ""
    for schema in (transition_schema("discrete"), SCENE_SCHEMA):
        for name in schema.names:
            assert f"``{name}``" in documented or name.startswith("next_"), name


@pytest.mark.parametrize("observation", ["image", "cartesian"])
def test_minari_gives_back_what_the_environment_would_show(
    tmp_path: Path, stored: DemonstrationSet, observation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import minari

    num_objects = 2 if observation == "cartesian" else None
    name = f"visualrhp/{stored.action_space}-v0"
    count = export_minari(stored, tmp_path, name, observation, num_objects)
    chosen = [pair for pair in stored if num_objects in (None, pair[0].scene.num_objects)]
    assert count == len(chosen)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    dataset = minari.load_dataset(name)
    assert len(dataset) == count
    assert dataset.total_steps == sum(len(episode) for _, episode in chosen)
    environment = dataset.recover_environment()
    assert environment.spec is not None and environment.spec.id == exports.ENVIRONMENT
    assert dataset.observation_space == environment.observation_space
    assert dataset.action_space == environment.action_space
    observe = ObservationFunction(observation, num_objects)
    for (task, episode), loaded in zip(chosen, dataset.iterate_episodes(), strict=True):
        seen = loaded.observations
        expected = np.stack([observe(task.scene, state) for state in episode.states])
        assert seen["observation"].dtype == expected.dtype
        np.testing.assert_array_equal(seen["observation"], expected)
        assert seen["gripper_closed"].tolist() == [int(state.gripper_closed) for state in episode.states]
        assert all(action in environment.action_space for action in loaded.actions)
        np.testing.assert_allclose(loaded.actions, np.array(episode.actions), rtol=1e-6)
        assert loaded.rewards.tolist() == list(episode.rewards)
        assert loaded.terminations.tolist() == [False] * (len(episode) - 1) + [True]
        assert not loaded.truncations.any()
    # Its first observation is the one that the environment itself gives of that task.
    task, _ = chosen[0]
    first, _ = environment.reset(options={"scene": task.scene, "state": task.state})
    np.testing.assert_array_equal(first["observation"], next(dataset.iterate_episodes()).observations["observation"][0])
    environment.close()


def test_minari_names_that_exist_or_are_none_are_refused(tmp_path: Path, stored: DemonstrationSet) -> None:
    export_minari(stored, tmp_path, "clutter/demos-v0", num_objects=1)
    for name in ("clutter/demos-v0", "no name"):
        with pytest.raises(ConfigError, match=f"Minari cannot make a data set called '{name}'"):
            export_minari(stored, tmp_path, name, num_objects=1)


def test_the_environment_is_the_registered_one() -> None:
    assert gymnasium.spec(exports.ENVIRONMENT).id == exports.ENVIRONMENT
