"""Finished results survive a kill, each once."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from visualrhp.evaluation.journal import Journal


def test_results_are_read_again(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    journal = Journal(path)
    assert not journal and not path.exists()
    results = {"a": {"x": 1, "y": [0.1, 2.5e-300]}, "b/1": None, "ä\n": [True]}
    for key, result in results.items():
        journal.append(key, result)
    assert dict(journal) == results
    assert dict(Journal(path)) == results
    assert len(path.read_text().splitlines()) == 3


def test_numbers_that_are_missing_are_kept(tmp_path: Path) -> None:
    Journal(tmp_path / "results.jsonl").append("a", math.nan)
    assert math.isnan(Journal(tmp_path / "results.jsonl")["a"])


@pytest.mark.parametrize("cut", [1, 2, 9])
def test_a_line_that_was_cut_short_is_dropped_and_can_be_written_again(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "results.jsonl"
    for key in ("a", "b"):
        Journal(path).append(key, {"x": 12.5})
    path.write_text(path.read_text()[:-cut])
    journal = Journal(path)
    assert list(journal) == (["a", "b"] if cut == 1 else ["a"])  # only the line break is missing
    journal.append("c", 3)
    assert dict(Journal(path)) == dict(journal)
    assert all(json.loads(line) for line in path.read_text().splitlines())


def test_a_result_that_is_not_json_leaves_no_trace(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "results.jsonl")
    with pytest.raises(TypeError):
        journal.append("a", object())
    assert not journal and not journal.path.exists()
