"""Finished results survive a kill, each once."""

from __future__ import annotations

import json
import math
import os
import zlib
from pathlib import Path
from typing import Any

import pytest

from tests.evaluation.samples import sample_result
from visualrhp.errors import DataError
from visualrhp.evaluation.episodes import EpisodeRow, episode_row
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


def written(path: Path) -> bytes:
    journal = Journal(path)
    for key in ("a", "b", "c"):
        journal.append(key, {"x": 12.5})
    return path.read_bytes()


def refused(path: Path, words: str, schema: Any = Any) -> None:
    before = path.read_bytes() if path.is_file() else None
    with pytest.raises(DataError, match=words) as caught:
        Journal(path, schema)
    message = str(caught.value)
    assert path.name in message and "delete this" in message and len(message) < 2000 and "\n" not in message
    assert before is None or path.read_bytes() == before


@pytest.mark.parametrize(
    "line",
    [
        b"null",
        b"[]",
        b"[1, 2]",
        b'{"a": 1, "b": 2}',
        b'["a"',
        b'["a", {"x": 12.5}]',
        b"\xff\xfe",
        b"\0" * 40,
        b"[" * 9999,
    ],
)
def test_a_line_that_was_not_written_here_is_named(tmp_path: Path, line: bytes) -> None:
    path = tmp_path / "episodes.jsonl"
    lines = written(path).splitlines(keepends=True)
    path.write_bytes(b"".join([lines[0], line + b"\n", *lines[1:]]))
    refused(path, r"episodes\.jsonl is damaged: line 2 is not as it was written")


def test_every_flipped_bit_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "episodes.jsonl"
    content = written(path)
    for position in range(len(content)):
        for bit in range(8):
            damaged = bytearray(content)
            damaged[position] ^= 1 << bit
            path.write_bytes(damaged)
            try:
                found = Journal(path)
            except DataError:
                continue
            assert position >= len(content) - 1, "only the last line break can be lost"
            assert set(found) <= {"a", "b", "c"} and all(result == {"x": 12.5} for result in found.values())


def test_a_line_that_was_deleted_is_missing_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "episodes.jsonl"
    lines = written(path).splitlines(keepends=True)
    path.write_bytes(lines[0] + b"\n" + lines[2])
    assert list(Journal(path)) == ["a", "c"]
    assert path.read_bytes() == lines[0] + lines[2]
    path.write_bytes(b"")
    assert not Journal(path)


def test_a_file_of_something_else_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "episodes.jsonl"
    path.write_text("my notes, without a line break")
    refused(path, "line 1 is not as it was written")


def test_results_have_a_schema(tmp_path: Path) -> None:
    path = tmp_path / "episodes.jsonl"
    row = episode_row(sample_result("dropped"))  # without an efficiency
    Journal(path, EpisodeRow).append("a", row)
    assert set(Journal(path, EpisodeRow)["a"]) == set(row)
    for number, other in enumerate((None, [], {}, row | {"success": 1}, row | {"more": 1}, row | {"outcome": "lost"})):
        broken = tmp_path / f"{number}.jsonl"
        Journal(broken).append("a", other)
        refused(broken, "line 1 is not as it was written", EpisodeRow)
    body = "[1, 2]"
    (tmp_path / "key.jsonl").write_text(f"[1, 2, {zlib.crc32(body.encode())}]\n")
    refused(tmp_path / "key.jsonl", "it is not a key and a result")


def test_what_cannot_be_read_says_what_to_delete(tmp_path: Path) -> None:
    path = tmp_path / "episodes.jsonl"
    path.mkdir()
    refused(path, "is a folder")
    path.rmdir()
    path.symlink_to(path)
    refused(path, "loop of links")
    path.unlink()
    path.symlink_to(tmp_path / "nowhere")
    refused(path, "which does not exist")
    path.unlink()
    os.mkfifo(path)
    refused(path, "not a regular file")
