"""Summaries: which rows count, tables, metrics by method, numbers in words."""

import math
import subprocess
import sys

import pandas as pd
import pytest

from tests.evaluation.samples import ablation_table, sample_table
from visualrhp.evaluation.metrics import wilson_interval
from visualrhp.evaluation.summaries import (
    cell_summaries,
    duration,
    failure_counts,
    main_rows,
    metrics_by_method,
    percent,
    random_num_objects,
    summary_lines,
    summary_tables,
)


@pytest.fixture(scope="module")
def episodes():
    return ablation_table()


def test_the_headline_is_about_mixed_sizes_without_noise_and_random_numbers_of_objects(episodes):
    main = main_rows(episodes)
    columns = ["object_size", "noise_level", "scene_num_objects"]
    assert main[columns].drop_duplicates().to_numpy().tolist() == [["mixed", "none", "1-7"]]
    assert len(main) == 80
    fixed = episodes.loc[episodes["scene_num_objects"] == "4"]
    assert len(main_rows(fixed)) == 80
    pd.testing.assert_frame_equal(random_num_objects(fixed), fixed)
    noisy = episodes.loc[episodes["noise_level"] == "high"]
    assert set(main_rows(noisy)["noise_level"]) == {"high"}, "nothing else is there"


def test_tables_have_a_row_per_line_and_key(episodes):
    tables = summary_tables(episodes)
    assert {name: len(table) for name, table in tables.items()} == {
        "summary": 8,  # 4 methods, 2 action spaces
        "by_num_objects": 8 * 7,
        "by_size": 8 * 3 * 3,
        "by_noise": 8 * 7 + 4 * 7,
        "failures": 8 * 7 + 4 * 7,
    }
    assert list(tables["by_num_objects"].columns[:3]) == ["label", "num_objects", "episodes"]
    assert set(tables["summary"]["label"]) >= {"VisualRHP 3x3, continuous", "mine 2x5, discrete"}


def test_metrics_by_method_leave_out_what_has_no_value():
    episodes = sample_table({"planner": "Greedy", "success": number < 2} for number in range(5))
    metrics = metrics_by_method(episodes)["continuous"]["Greedy"]
    assert metrics["success_rate"] == 0.4 and metrics["episodes"] == 5
    assert metrics["success_rate_low"] == pytest.approx(wilson_interval(2, 5).low, abs=1e-6)
    none = metrics_by_method(episodes.loc[~episodes["success"]])["continuous"]["Greedy"]
    assert none["success_rate"] == 0.0 and "action_efficiency" not in none


def test_every_cell_is_summarized_in_the_order_of_legends(episodes):
    cells = list(cell_summaries(episodes))
    assert list(dict.fromkeys((cell.setting["action_space"], cell.setting["method"]) for cell in cells)) == [
        (space, method)
        for space in ("continuous", "discrete")
        for method in ("VisualRHP 6x6", "VisualRHP 3x3", "Greedy", "mine 2x5")
    ]
    assert len({cell.name for cell in cells}) == len(cells)
    assert sum(cell.setting["num_episodes"] for cell in cells) == len(episodes)
    (cell,) = (cell for cell in cells if cell.name == "Greedy, continuous, 4 objects, noise high")
    keys = {"planner": "Greedy", "action_space": "continuous", "scene_num_objects": "4", "noise_level": "high"}
    rows = episodes.loc[(episodes[list(keys)] == pd.Series(keys)).all(axis=1)]
    assert cell.metrics["success_rate"] == rows["success"].mean()
    failures = [count for name, count in cell.metrics.items() if name.startswith("failures/")]
    assert sum(failures) == (~rows["success"]).sum() > 0


def test_failures_are_counted_by_method_and_number_of_objects():
    kinds = ["none", "idle", "idle", "jam"]
    rows = [{"success": kind == "none", "failure": kind} for kind in kinds]
    others = [{"num_objects": 5, "success": False, "failure": "jam"}, {"object_size": "small", "success": True}]
    table = failure_counts(sample_table([*rows, *others]))
    assert table["episodes"].tolist() == [4, 1]
    assert (table["idle"].tolist(), table["jam"].tolist(), table["gave up"].tolist()) == ([2, 0], [1, 1], [0, 0])
    assert "none" not in table


def test_lines_of_text(episodes):
    first, *lines = summary_lines(episodes, 12).splitlines()
    assert first.startswith(f"{len(episodes)} episodes in 12 settings.")
    assert len(lines) == 8 and all("(10 episodes)" in line for line in lines)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(math.nan, "–"), (0.0123, "12.3 ms"), (1.5, "1.5 s"), (119.0, "119 s"), (600.0, "10 min"), (9000.0, "2.5 h")],
)
def test_durations(seconds, words):
    assert duration(seconds) == words


def test_rates():
    assert (percent(0.125), percent(0.125, 1), percent(math.nan)) == ("12%", "12.5%", "–")
    assert (percent(0.995), percent(1.0), percent(0.004), percent(0.0)) == ("99.5%", "100%", "0.4%", "0%")


def test_numbers_are_computed_without_code_for_figures_and_pages():
    modules = ("episodes", "journal", "methods", "metrics", "summaries", "weight_search", "weight_search_tables")
    code = (
        f"import sys; from visualrhp.evaluation import {', '.join(modules)}; "
        "print([name for name in ('matplotlib', 'jinja2', 'cv2', 'torch', 'optuna') if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
