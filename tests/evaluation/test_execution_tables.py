"""Tables of the execution phase, by hand-computed numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pytest

from tests.evaluation.samples import sample_table
from visualrhp.errors import DataError
from visualrhp.evaluation.episodes import write_episodes
from visualrhp.evaluation.execution_tables import (
    EXECUTION_COLUMNS,
    STEPS,
    cause,
    causes_table,
    is_success,
    joined,
    pairs_table,
    rates_table,
    read_executions,
    read_rows,
    results_document,
    steps_table,
    write_rows,
)

OURS = "VisualRHP+ 3x3"


def rows_of(outcomes: Sequence[str], method: str = OURS, step: str = "network", objects: str = "6-7") -> pd.DataFrame:
    """An episode for each outcome; "false" is a success as seen only."""
    rows = [
        {
            "method": method,
            "step": step,
            "scene_num_objects": objects,
            "seed": 3,
            "episode": index,
            "num_objects": 6,
            "outcome": "success" if outcome == "false" else outcome,
            "num_actions": 4 + index,
            "true_success": outcome == "success",
            "true_distance": 0.01,
            "num_fallen": int(outcome == "dropped"),
            "fault": "vanished: box 3 at (0.1, 0.2)" if outcome == "stopped" else None,
            "mean_perception_s": 0.1,
            "mean_decision_s": 0.05,
            "max_decision_time_s": 0.06,
            "commit": "0123456789",
        }
        for index, outcome in enumerate(outcomes)
    ]
    return pd.DataFrame(rows, columns=list(EXECUTION_COLUMNS))


def test_a_success_is_one_in_truth() -> None:
    rows = rows_of(["success", "false", "dropped", "stopped"])
    assert is_success(rows).tolist() == [True, False, False, False]
    (line,) = rates_table(rows).to_dict("records")
    assert line["success"].startswith("25% (") and line["as seen"] == "50%" and line["runs"] == 4
    assert (line["dropped"], line["stopped"], line["gave up"], line["out of actions"]) == (1, 1, 0, 0)
    assert (line["actions"], line["perception"], line["decision"]) == ("4.0", "100 ms", "50 ms")


def test_methods_are_compared_on_the_same_cells() -> None:
    ours, greedy = rows_of(["success", "success", "success", "dropped"]), rows_of(["success", "dropped"], "Greedy")
    (line,) = pairs_table(pd.concat([ours, greedy], ignore_index=True), OURS).to_dict("records")
    assert line["cells"] == 2, "only two have both"
    assert line["difference"] == "+50 points" and line["p"] == "1", "one discordant pair: p = 2 * 0.5"
    assert (line["against"], line["world"], line["objects"]) == ("Greedy", "network", "6-7")
    assert pairs_table(ours, OURS).empty


def test_each_step_is_compared_with_the_one_before() -> None:
    rows = pd.concat(
        [
            rows_of(["success"] * 4, step="simulator"),
            rows_of(["success", "success", "success", "dropped"], step="true_state"),
            rows_of(["false", "success", "success", "dropped"], step="network"),
            rows_of(["success"] * 4, "Greedy", "arm"),
        ],
        ignore_index=True,
    )
    lines = steps_table(rows, OURS).to_dict("records")
    assert [line["world"] for line in lines] == ["simulator", "true_state", "network"]
    assert [line["difference"] for line in lines] == ["–", "-25 points", "-25 points"]
    assert lines[1]["what"] == STEPS["true_state"]


@pytest.mark.parametrize(
    ("outcome", "true_success", "num_fallen", "fault", "expected"),
    [
        ("success", True, 0, None, ""),
        ("success", False, 0, None, "seen as a success, but it was none"),
        ("dropped", False, 1, None, "an object fell"),
        ("dropped", False, 0, None, "an object was seen to fall, but did not"),
        ("out of actions", False, 0, None, "out of actions"),
        ("stopped", False, 0, "vanished: box 3", "stopped: an object was no longer seen"),
        (
            "stopped",
            False,
            0,
            "8 looks in succession give no clear view: vanished: x",
            "stopped: an object was no longer",
        ),
        ("stopped", False, 0, float("nan"), "stopped: another fault"),
    ],
)
def test_causes_of_failure(outcome: str, true_success: bool, num_fallen: int, fault: str | None, expected: str) -> None:
    assert cause(outcome, true_success, num_fallen, fault).startswith(expected)
    assert bool(cause(outcome, true_success, num_fallen, fault)) == bool(expected)


def test_causes_are_counted() -> None:
    rows = pd.concat([rows_of(["success", "dropped", "dropped", "stopped"]), rows_of(["false"], objects="2-3")])
    table = causes_table(rows.reset_index(drop=True), OURS).set_index("cause")
    assert table["6-7, network"].to_dict() == {
        "an object fell": 2,
        "seen as a success, but it was none": 0,
        "stopped: an object was no longer seen": 1,
    }
    assert table["2-3, network"].tolist().count(1) == 1


def test_rows_survive_a_file_in_an_order_of_their_own(tmp_path: Path) -> None:
    one, other = rows_of(["success", "stopped"]), rows_of(["dropped"], "Greedy", objects="2-3")
    rows = joined([one, other])
    pd.testing.assert_frame_equal(rows, joined([other, one]))
    write_rows(tmp_path / "rows.csv", rows)
    again = read_rows(tmp_path / "rows.csv")
    assert results_document(again, OURS) == results_document(rows, OURS)
    assert again["episode"].tolist() == rows["episode"].tolist()
    (tmp_path / "rows.csv").write_text("method\n1\n")
    with pytest.raises(DataError, match="its columns should be method, step"):
        read_rows(tmp_path / "rows.csv")


def test_the_document_has_every_table() -> None:
    rows = pd.concat([rows_of(["success", "dropped"]), rows_of(["success", "success"], "Greedy")], ignore_index=True)
    text = results_document(rows, OURS)
    assert "Seed 3, commit `0123456`" in text
    assert text.count("\n## ") == 4 and f"## {OURS} against other methods" in text


def evaluation(folder: Path, num_actions: int = 7) -> Path:
    row = {"experiment": "network", "planner": "VisualRHP+", "num_rollouts": 3, "horizon": 3, "seed": 3}
    row |= {"scene_num_objects": "6-7", "num_objects": 6, "num_actions": 7, "max_decision_time_s": 0.2}
    write_episodes(folder / "episodes.parquet", sample_table([row]))
    execution = {"episode": 0, "num_objects": 6, "outcome": "success", "num_actions": num_actions, "true_success": True}
    pd.DataFrame([execution]).to_csv(folder / "executions.csv", index=False)
    return folder


def test_the_tables_of_an_evaluation_are_joined(tmp_path: Path) -> None:
    rows = read_executions(evaluation(tmp_path), "abc")
    assert tuple(rows.columns) == EXECUTION_COLUMNS
    assert rows.loc[0, ["method", "step", "scene_num_objects", "seed", "commit", "max_decision_time_s"]].tolist() == [
        OURS,
        "network",
        "6-7",
        3,
        "abc",
        0.2,
    ]


def test_tables_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"executions.csv.*not those of episodes.parquet.*evaluate_execution"):
        read_executions(evaluation(tmp_path, num_actions=8), None)
    (tmp_path / "executions.csv").write_text("outcome\nsuccess\n")
    with pytest.raises(DataError, match="lacks the columns episode, num_objects, num_actions"):
        read_executions(tmp_path, None)
    (tmp_path / "executions.csv").unlink()
    with pytest.raises(DataError, match=r"executions.csv does not exist"):
        read_executions(tmp_path, None)
