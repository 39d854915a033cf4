"""Summaries of training histories."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from visualrhp.documents import conform
from visualrhp.errors import DataError
from visualrhp.learning.history import (
    EpochHistory,
    ImitationProgress,
    IterationHistory,
    ReinforcementProgress,
    RoundHistory,
    expert_iteration_summary,
    imitation_summary,
    read_history,
    read_summary,
    reinforcement_summary,
)


def test_the_summary_leaves_times_out() -> None:
    history = [{"epoch": 2.0, "lr": 0.1, "samples_per_s": 5.0, "train/loss": 1.5, "greedy/success_rate": 0.5}]
    assert imitation_summary(history) == {"epochs": 2, "train": {"loss": 1.5}, "greedy": {"success_rate": 0.5}}


def test_summary_names_the_initial_the_best_and_the_last() -> None:
    history = [
        {"iteration": 0.0, "greedy/success_rate": 0.5},
        {"iteration": 1.0, "collection/transitions": 10.0},
        {"iteration": 2.0, "greedy/success_rate": 0.7, "greedy/evaluation_time_s": 3.0, "collection/transitions": 20.0},
        {"iteration": 3.0, "greedy/success_rate": 0.6, "collection/transitions": 30.0},
    ]
    assert reinforcement_summary(history, best_iteration=2) == {
        "iterations": 3,
        "transitions": 30,
        "best_iteration": 2,
        "initial": {"success_rate": 0.5},
        "best": {"success_rate": 0.7},
        "last": {"success_rate": 0.6},
    }


def test_expert_iteration_shows_the_initial_the_best_and_the_last() -> None:
    history = [
        {"round": 0.0, "validation/score": 0.5, "greedy/success_rate": 0.25},
        {"round": 1.0, "validation/score": 0.75, "greedy/success_rate": 0.5, "imitation/pairs": 4.0},
    ]
    assert expert_iteration_summary(history, 1) == {
        "rounds": 1,
        "best_round": 1,
        "initial": {"validation": {"score": 0.5}, "greedy": {"success_rate": 0.25}},
        "best": {"validation": {"score": 0.75}, "greedy": {"success_rate": 0.5}},
        "last": {"validation": {"score": 0.75}, "greedy": {"success_rate": 0.5}},
    }


EPOCHS = [{"epoch": 1.0, "loss": 0.5}, {"epoch": 2.0, "loss": 3}]


def test_a_history_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "history.json"
    path.write_text(json.dumps(EPOCHS))
    rows = read_history(path, EpochHistory)
    assert rows == EPOCHS and type(rows[1]["loss"]) is int
    path.write_text(json.dumps({"epochs": 3}))
    assert read_summary(path) == {"epochs": 3}


@pytest.mark.parametrize(
    ("schema", "content", "words"),
    [
        (EpochHistory, None, "a list"),
        (EpochHistory, {}, "a list"),
        (EpochHistory, [None], "wrong type"),
        (EpochHistory, [{"epoch": 0.0}], "row 0 of the history has epoch=0"),
        (EpochHistory, [{"epoch": 1.0}, {"epoch": 3.0}], "row 1 of the history has epoch=3"),
        (EpochHistory, [{"epoch": 1.0}, {"loss": 3.0}], "row 1 of the history lacks epoch"),
        (EpochHistory, [{"epoch": "1"}], "wrong type"),
        (EpochHistory, [{"epoch": 1.0, "loss": None}], "loss=null has the wrong type"),
        (EpochHistory, [{"epoch": 1.0, "loss": True}], "loss=True has the wrong type"),
        (IterationHistory, [{"iteration": 2.0}], "iteration=2"),
        (RoundHistory, [{"round": 0.0}], "lacks validation/kept"),
        (RoundHistory, [{"round": 1.0, "validation/kept": 1.0, "validation/score": 0.5}], "round=1"),
    ],
)
def test_what_is_no_history_is_refused(tmp_path: Path, schema: Any, content: Any, words: str) -> None:
    path = tmp_path / "history.json"
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match=words) as caught:
        read_history(path, schema)
    assert "history.json is damaged" in str(caught.value) and "delete the folder it is in" in str(caught.value)


@pytest.mark.parametrize("text", ["[]", "null", "3", '{"a": NaN}', "{", ""])
def test_what_is_no_summary_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "metrics.json"
    path.write_text(text)
    with pytest.raises(DataError, match=r"metrics\.json .*delete the folder it is in"):
        read_summary(path)


def test_progress_matches_its_history() -> None:
    assert conform(ImitationProgress, {"epoch": 2, "history": EPOCHS}).epoch == 2
    rows = [{"iteration": 0.0}, {"iteration": 1.0}]
    good = {"iteration": 1, "best_iteration": 0, "best_score": [0.5, 0.1], "history": rows}
    assert conform(ReinforcementProgress, good).best_score == (0.5, 0.1)
    assert conform(ReinforcementProgress, {**good, "iteration": 0, "best_score": None, "history": []}).iteration == 0
    for change in (
        {"iteration": 2},
        {"best_iteration": 2},
        {"best_iteration": -1},
        {"best_score": [0.5]},
        {"best_score": ["a", "b"]},
        {"history": rows[1:] * 2},
    ):
        with pytest.raises(ValueError, match=r"\w"):
            conform(ReinforcementProgress, good | change)
