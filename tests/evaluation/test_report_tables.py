"""Formatted rows of results."""

from __future__ import annotations

import math

import pandas as pd
import pytest

from tests.evaluation.samples import report_table, sample_table
from visualrhp.evaluation.report_tables import (
    decision_time,
    detail_tables,
    main_table,
    number,
    paired_rows,
    results_table,
)


def test_methods_are_listed_in_order_and_groups_are_separated() -> None:
    table = main_table(report_table())
    assert table["headings"] == ["Method", "Actions"]
    assert [row["labels"] for row in table["rows"]] == [
        [method, space] for method in ("VisualRHP 3x3", "Greedy", "K.RRT") for space in ("continuous", "discrete")
    ]
    assert [row["starts_group"] for row in table["rows"]] == [False, False, True, False, True, False]
    first = table["rows"][0]
    assert (first["success"], first["success_range"], first["dropped"], first["episodes"]) == (
        "90%",
        "65–98",
        "10%",
        10,
    )
    assert first["low_percent"] + first["width_percent"] == pytest.approx(98, abs=0.6)


def test_sizes_and_noise_have_tables_where_they_vary() -> None:
    tables = detail_tables(report_table())
    assert [table["title"] for table in tables["environments"]] == ["By number of objects", "By object size"]
    sizes = [row["labels"][2] for row in tables["environments"][1]["rows"][:2]]
    assert sizes == ["small", "mixed"]
    levels = [row["labels"][2] for row in tables["robustness"][0]["rows"][:2]]
    assert levels == ["none", "high"]
    mixed = report_table().loc[lambda table: table["object_size"] == "mixed"]
    assert len(detail_tables(mixed)["environments"]) == 1


def test_what_has_no_value_is_a_dash() -> None:
    table = sample_table([{"success": False, "num_actions": 49}])
    (row,) = results_table(table, {"method": "Method"}, "", "")["rows"]
    assert (row["efficiency"], row["efficiency_range"], row["time_range"]) == ("–", "", "")
    assert (number(math.nan), number(0.125)) == ("–", "0.12")


def test_decision_times_are_per_action() -> None:
    table = sample_table([{"num_actions": 10, "decision_time_s": 1.0}, {"num_actions": 30, "decision_time_s": 1.0}])
    assert decision_time(table) == pytest.approx(0.05)
    assert decision_time(table.iloc[:0]) == 0.0


def test_paired_rows_are_formatted_with_signs_and_without_a_negative_zero() -> None:
    own = report_table().loc[lambda table: table["planner"] == "Greedy"]
    search = own.assign(planner="K.RRT closed loop", num_rollouts=None, horizon=None)
    rows = paired_rows(pd.concat([own, search]))
    assert rows and {row["reference"] for row in rows} == {"K.RRT closed loop"}
    assert {(row["success"], row["actions"], row["success_p"]) for row in rows} == {("+0.0%", "+0.0", "1.000")}
