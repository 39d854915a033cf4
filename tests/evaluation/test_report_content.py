"""The facts of the page."""

from __future__ import annotations

import json
from pathlib import Path

from tests.evaluation.samples import evaluation_card, report_table
from visualrhp.evaluation.report_content import page_content
from visualrhp.evaluation.report_page import Content


def content_of(card: dict, training: tuple[Path, ...] = (), commit: str | None = None) -> Content:
    return page_content("Title", report_table(), card, {}, [], training, commit)


def test_every_setting_has_its_success_rate() -> None:
    points = content_of(evaluation_card(report_table())).points
    assert len(points) == 18
    assert points[0] == {
        "action_space": "continuous",
        "object_size": "mixed",
        "layout": "uniform",
        "noise_level": "none",
        "method": "VisualRHP 3x3",
        "num_objects": "1 to 7",
        "episodes": 10,
        "skipped": 3,
        "success": "90%",
    }
    assert {(point["method"], point["success"]) for point in points} == {
        ("VisualRHP 3x3", "90%"),
        ("Greedy", "50%"),
        ("K.RRT", "100%"),
    }


def test_what_was_skipped_is_counted_by_method_and_action_space() -> None:
    warnings = content_of(evaluation_card(report_table())).warnings
    assert [warning.partition(" has ")[0] for warning in warnings] == [
        "VisualRHP 3x3 with continuous actions",
        "VisualRHP 3x3 with discrete actions",
    ]
    assert all("9 of 39 tasks were not run" in warning for warning in warnings)


def test_facts_about_the_run(tmp_path: Path) -> None:
    card = evaluation_card(report_table())
    (tmp_path / "train_il" / "discrete" / "image").mkdir(parents=True)
    (tmp_path / "train_il" / "discrete" / "image" / "heuristic.json").write_text("{}")
    content = content_of(card, (tmp_path / "train_il", tmp_path / "train_rl"))
    facts = dict(content.run_facts)
    assert facts["Episodes"] == "180 in 18 settings, seed 0"
    assert facts["Planning"] == "90 s in total; 1.8 s to execute"
    assert facts["Evaluation"] == "61 s on 2 workers"
    assert (facts["Networks"], facts["train_il"]) == ("0: none", "1 networks (discrete, image)")
    assert "train_rl" not in facts
    assert dict(content.facts)["commit"] == "0123456789"
    assert json.loads(dict(content.documents)["Configuration of the evaluation"]) == {"seed": 0}


def test_the_commit_is_that_of_the_evaluation_where_it_is_known() -> None:
    card = evaluation_card(report_table())
    assert dict(content_of(card | {"commit": "f" * 40 + "-dirty"}).facts)["commit"] == "ffffffffff with changes"
    assert dict(content_of(card | {"commit": None}, commit="e" * 40).facts)["commit"] == "eeeeeeeeee"
    assert dict(content_of(card | {"commit": None}).run_facts)["Commit"] == "unknown"
