"""The document of an ablation: its numbers are those of the rows, computed another way."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.evaluation.samples import ablation_table, sample_table
from visualrhp.evaluation.ablation_results import (
    RACERS,
    commonest_failures,
    density_table,
    failures_table,
    main_table,
    pairs_table,
    race,
    results_document,
)

EPISODES = ablation_table()


def test_the_main_table_is_that_of_the_headline_rows() -> None:
    table = main_table(EPISODES).set_index(["method", "actions"])
    chosen = (EPISODES["noise_level"] == "none") & (EPISODES["object_size"] == "mixed")
    rows = EPISODES.loc[chosen & (EPISODES["scene_num_objects"] == "1-7") & (EPISODES["planner"] == "Greedy")]
    for space, group in rows.groupby("action_space"):
        line = table.loc[("Greedy", str(space))]
        assert line["runs"] == len(group)
        assert float(line["success"].split("%")[0]) == pytest.approx(100.0 * group["success"].mean(), abs=0.05)
        assert float(line["actions per run"].split(" ")[0]) == pytest.approx(group["num_actions"].mean(), abs=0.05)
    assert len(table) == 8


def test_success_by_number_of_objects_is_of_requested_numbers() -> None:
    table = density_table(EPISODES, "continuous", "high").set_index("method")
    requested = EPISODES.loc[EPISODES["scene_num_objects"] != "1-7"]
    chosen = (requested["noise_level"] == "high") & (requested["planner"] == "Greedy")
    rows = requested.loc[chosen & (requested["action_space"] == "continuous")]
    for m, group in rows.groupby("num_objects"):
        assert float(table.loc["Greedy", str(m)].rstrip("%")) == pytest.approx(
            100.0 * group["success"].mean(), abs=0.05
        )
    assert density_table(EPISODES, "discrete", "low").empty


def test_failures_are_those_of_all_rows_of_mixed_size() -> None:
    table = failures_table(EPISODES)
    rows = EPISODES.loc[EPISODES["object_size"] == "mixed"]
    counted = int(table.drop(columns=["method", "actions", "episodes"]).to_numpy().sum())
    assert counted == len(rows) - np.count_nonzero(rows["success"]) > 0
    assert int(np.sum(table["episodes"])) == len(rows)


def test_methods_are_compared_with_those_that_search_again() -> None:
    rows = [
        {"planner": planner, "episode": number, "success": number < wins}
        for planner, wins in (("K.RRT closed loop", 6), ("Greedy", 9))
        for number in range(10)
    ]
    (line,) = pairs_table(sample_table(rows)).to_dict("records")
    assert (line["method"], line["against"], line["tasks"]) == ("Greedy", "K.RRT closed loop", 10)
    assert line["success, points"].startswith("+30.0 (") and line["p"] == "0.25"  # 3 of 3 in favour: 2 / 2^3
    assert pairs_table(sample_table([{**row, "noise_level": "low"} for row in rows])).empty


def test_the_commonest_failure_of_each_kind_is_its_first_episode_where_it_is_commonest() -> None:
    def rows(planner: str, failures: list[str], **more: str) -> list[dict[str, object]]:
        return [{"planner": planner, "success": f == "none", "failure": f, **more} for f in failures]

    table = sample_table(
        [
            *rows("Greedy", ["idle", "jam", "none"]),  # episodes 0 to 2
            *rows("Greedy", ["none", "idle", "idle"], noise_level="high"),  # 3 to 5
            *rows("VisualRHP in 5 ms", ["idle"] * 4),
        ]
    )
    found = {kind.value: (row["noise_level"], row["episode"]) for kind, row in commonest_failures(table).items()}
    assert found == {"idle": ("high", 4), "jam": ("none", 1)}


def test_a_race_is_on_a_task_that_the_first_completes_and_the_others_do_not() -> None:
    wins = {"VisualRHP+": [True, False, True, True], "Greedy": [True, False, False, True], "K.RRT": [False] * 4}
    setting = {"scene_num_objects": "7", "noise_level": "high"}
    size = {"VisualRHP+": {"num_rollouts": 3, "horizon": 3}}
    rows = [
        {"planner": planner, "episode": episode, "success": success, **setting, **size.get(planner, {})}
        for planner, successes in wins.items()
        for episode, success in enumerate(successes)
    ]
    assert [(row["method"], row["episode"]) for row in race(sample_table(rows))] == [(name, 2) for name in RACERS]
    assert race(sample_table(rows[:8])) == [] and race(sample_table([{**rows[0], "noise_level": "low"}])) == []
    assert race(sample_table([row for row in rows if row["episode"] != 2])) == []


def test_the_document_has_every_section_and_no_empty_table() -> None:
    document = results_document(EPISODES, [], {"Commit": "`abc`"}, ["python -m pipelines.evaluate"])
    titles = re.findall("^## (.*)$", document, re.MULTILINE)
    assert titles[0] == "Main comparison" and titles[-1] == "Why episodes fail"
    assert "Success by number of objects, continuous actions, noise high" in titles
    assert not [title for title in titles if "noise low" in title]
    assert "- Commit: `abc`" in document and "python -m pipelines.evaluate" in document
    assert "nan" not in document
