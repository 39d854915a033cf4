"""The table of episodes: one schema, for what is written and for what is read."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.evaluation.samples import ablation_table, evaluation_card, sample_result
from visualrhp.errors import DataError
from visualrhp.evaluation.episodes import (
    EPISODE_COLUMNS,
    RESULT_COLUMNS,
    SETTING_COLUMNS,
    Setting,
    check_row,
    episode_row,
    episodes_table,
    read_episodes,
    read_evaluation,
    write_episodes,
)
from visualrhp.files import write_json
from visualrhp.heuristics.crafted import CraftedHeuristic
from visualrhp.planning import RecedingHorizon
from visualrhp.planning.decision_task import RecedingHorizonParameters
from visualrhp.scene import SceneDistribution
from visualrhp.types import Outcome


def setting(planner: object, num_objects: tuple[int, int] = (1, 7)) -> Setting:
    distribution = SceneDistribution(num_objects=num_objects, object_size="small")
    return Setting.of("block", planner, "continuous", distribution, "low", 3)


def test_a_row_has_the_columns_of_the_schema() -> None:
    row = episode_row(sample_result(num_actions=8, decision_time_s=0.4, simulation_time_s=0.1))
    assert list(row) == list(RESULT_COLUMNS)
    assert row["mean_decision_time_s"] == pytest.approx(0.05)
    assert row["execution_time_s"] == pytest.approx(0.5)
    assert (row["success"], row["dropped"], row["num_objects"], row["action_efficiency"]) == (True, False, 4, 0.5)


@pytest.mark.parametrize("outcome", list(Outcome))
def test_outcomes_are_plain_text(outcome: Outcome) -> None:
    row = episode_row(sample_result(outcome))
    assert type(row["outcome"]) is str and row["outcome"] == outcome
    assert json.loads(json.dumps(row))["outcome"] == outcome


def test_a_setting_is_named_by_planner_and_distribution() -> None:
    planner = RecedingHorizon(CraftedHeuristic("continuous"), num_rollouts=8, horizon=4, name="mine")
    found = setting(planner)
    assert (found.planner, found.num_rollouts, found.horizon) == ("mine", 8, 4)
    assert (found.scene_num_objects, found.object_size, found.noise_level, found.seed) == ("1-7", "small", "low", 3)
    assert setting(planner, (4, 4)).scene_num_objects == "4"
    assert setting(RecedingHorizonParameters(num_rollouts=8, horizon=4, name="mine")) == found


def test_the_table_has_a_row_per_episode_in_the_types_of_the_schema() -> None:
    class Plain:
        name = "Plain"

    row = episode_row(sample_result("dropped"))
    table = episodes_table([(setting(Plain()), index, row) for index in (5, 2)])
    assert list(table.columns) == list(EPISODE_COLUMNS) == [*SETTING_COLUMNS, "episode", *RESULT_COLUMNS]
    assert table["episode"].tolist() == [5, 2]
    assert bool(table[["horizon", "action_efficiency"]].isna().to_numpy().all())
    types = {name: str(table[name].dtype) for name in ("horizon", "seed", "success", "return")}
    assert types == {"horizon": "Int64", "seed": "int64", "success": "bool", "return": "float64"}
    assert episodes_table([]).empty


def test_what_is_written_is_read(tmp_path: Path) -> None:
    table = ablation_table()
    table.to_parquet(tmp_path / "episodes.parquet", index=False)
    write_json(tmp_path / "evaluation.json", evaluation_card(table))
    episodes, card = read_evaluation(tmp_path)
    pd.testing.assert_frame_equal(episodes, table)
    assert card == evaluation_card(table)


def test_tables_that_cannot_be_used_are_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "episodes.parquet"
    with pytest.raises(DataError, match=r"no file episodes\.parquet; make it with python -m pipelines\.evaluate"):
        read_episodes(path)
    table = ablation_table()
    table.to_parquet(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(DataError, match="damaged or is not a Parquet file"):
        read_episodes(path)
    table.drop(columns=["success", "return"]).to_parquet(path)
    with pytest.raises(DataError, match="lacks the columns success, return"):
        read_episodes(path)
    table.iloc[:0].to_parquet(path)
    with pytest.raises(DataError, match="no rows"):
        read_episodes(path)
    table.assign(success="yes").to_parquet(path)
    with pytest.raises(DataError, match=r"the column success of .* is str, not boolean"):
        read_episodes(path)


def refused(path: Path, words: str) -> None:
    with pytest.raises(DataError, match=words) as caught:
        read_episodes(path)
    message = str(caught.value)
    assert "episodes.parquet" in message and "python -m pipelines.evaluate" in message
    assert len(message) < 2000 and "\n" not in message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"action_space": "both"}, "the column action_space has the value both, not continuous or discrete"),
        ({"noise_level": "loud"}, "the value loud"),
        ({"object_size": "huge"}, "the value huge"),
        ({"outcome": "lost"}, "the value lost"),
        ({"num_actions": -1}, "the column num_actions has negative numbers"),
        ({"horizon": -3}, "the column horizon has negative numbers"),
        ({"decision_time_s": np.inf}, "the column decision_time_s has infinite numbers"),
        ({"return": "text"}, "the column return of .* is str, not number"),
        ({"num_objects": 1.5}, "the column num_objects of .* is float64, not integer"),
        ({"success": None}, "the column success of .* not boolean"),
        ({"layout": None}, "layout"),
    ],
)
def test_values_that_are_not_possible_are_named(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    path = tmp_path / "episodes.parquet"
    table = ablation_table()
    table.assign(**change).to_parquet(path)
    refused(path, words)
    if len(change) == 1 and isinstance(value := next(iter(change.values())), str) and "value" in words:
        name = next(iter(change))
        table.assign(**{name: [value, *table[name][1:]]}).to_parquet(path)  # once is enough
        refused(path, words)


def test_altered_bits_of_the_values_are_noticed(tmp_path: Path) -> None:
    path = tmp_path / "episodes.parquet"
    table = ablation_table()
    write_episodes(path, table)
    pd.testing.assert_frame_equal(read_episodes(path), table)
    content = path.read_bytes()
    footer = int.from_bytes(content[-8:-4], "little") + 8
    rng = np.random.default_rng(0)
    for position in rng.integers(4, len(content) - footer, 60):
        damaged = bytearray(content)
        damaged[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        with contextlib.suppress(DataError):
            pd.testing.assert_frame_equal(read_episodes(path), table)  # a byte that is not read


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "episodes.parquet"
    path.mkdir()
    refused(path, "is a folder")
    path.rmdir()
    path.symlink_to(tmp_path / "nowhere")
    refused(path, "which does not exist")
    path.unlink()
    os.mkfifo(path)
    refused(path, "not a regular file")
    path.unlink()
    path.write_bytes(b"")
    refused(path, "0 bytes")
    path.write_bytes(b"PAR1" + b"\xff" * 40 + b"PAR1")
    refused(path, "damaged or is not a Parquet file")


def test_the_card_belongs_to_the_table(tmp_path: Path) -> None:
    table = ablation_table()
    write_episodes(tmp_path / "episodes.parquet", table.iloc[1:])
    write_json(tmp_path / "evaluation.json", evaluation_card(table))
    with pytest.raises(
        DataError, match=rf"evaluation\.json .*of {len(table)} episodes, but the table has {len(table) - 1}"
    ):
        read_evaluation(tmp_path)


def test_rows_have_a_schema() -> None:
    row = json.loads(json.dumps(episode_row(sample_result("dropped"))))
    assert check_row(row) is row
    for change in (
        {"success": 1},
        {"outcome": "x"},
        {"num_actions": -1},
        {"num_actions": 10**12},
        {"return": "1"},
        {"a": 1},
    ):
        with pytest.raises(ValueError, match=next(iter(change))):
            check_row(row | change)
    with pytest.raises(ValueError, match="return"):
        check_row({name: value for name, value in row.items() if name != "return"})
