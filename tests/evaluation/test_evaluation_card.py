"""Cards of evaluations that are not what they should be are named before anything is made of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.evaluation.samples import evaluation_card, report_table
from visualrhp.errors import DataError
from visualrhp.evaluation.episodes import read_evaluation, write_episodes

CARD = evaluation_card(report_table())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_episodes(tmp_path / "episodes.parquet", report_table())
    return tmp_path


def read(folder: Path, card: Any) -> Any:
    (folder / "evaluation.json").write_text(json.dumps(card))
    return read_evaluation(folder)[1]


def refused(folder: Path, card: Any, words: str | None = None) -> None:
    with pytest.raises(DataError, match=words) as caught:
        read(folder, card)
    message = str(caught.value)
    assert "evaluation.json is damaged: " in message and "python -m pipelines.evaluate" in message
    assert len(message) < 2000 and "\n" not in message


def test_a_card_is_read_as_it_was_written(folder: Path) -> None:
    for card in (CARD, CARD | {"num_workers": None, "commit": None, "more": {"a": 1}}):
        assert read(folder, card) == card


@pytest.mark.parametrize("content", [None, [], [CARD], "card", 3])
def test_what_is_no_card_is_refused(folder: Path, content: Any) -> None:
    refused(folder, content, "it should be a group of keys")


@pytest.mark.parametrize("key", sorted(CARD))
def test_every_key_is_required_and_has_its_type(folder: Path, key: str) -> None:
    refused(folder, {name: value for name, value in CARD.items() if name != key}, f"The key {key} is missing")
    refused(folder, CARD | {key: [[1]]}, key)


@pytest.mark.parametrize("key", sorted(CARD["points"][0]))
def test_every_key_of_a_setting_is_required_and_has_its_type(folder: Path, key: str) -> None:
    first, *others = CARD["points"]
    without = {name: value for name, value in first.items() if name != key}
    refused(folder, CARD | {"points": [without, *others]}, rf"The key points\[0\]\.{key} is missing")
    refused(folder, CARD | {"points": [*others, first | {key: {"a": 1}}]}, rf"points\[17\]\.{key}")


@pytest.mark.parametrize(
    "change",
    [
        {"num_episodes": 7},
        {"num_episodes": -1},
        {"wall_time_s": -1.0},
        {"wall_time_s": "fast"},
        {"num_workers": 0},
        {"versions": {"torch": 2}},
        {"networks": {"a": None}},
        {"seed": "0"},
    ],
)
def test_values_out_of_range_are_refused(folder: Path, change: dict[str, Any]) -> None:
    refused(folder, CARD | change, next(iter(change)))
