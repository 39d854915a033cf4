"""The table of episodes: one schema, for what is written and for what is read."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from tests.evaluation.samples import ablation_table, sample_result
from visualrhp.errors import DataError
from visualrhp.evaluation.episodes import (
    EPISODE_COLUMNS,
    RESULT_COLUMNS,
    SETTING_COLUMNS,
    Setting,
    episode_row,
    episodes_table,
    read_episodes,
    read_evaluation,
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
    write_json(tmp_path / "evaluation.json", {"seed": 0})
    episodes, card = read_evaluation(tmp_path)
    pd.testing.assert_frame_equal(episodes, table)
    assert card == {"seed": 0}


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
