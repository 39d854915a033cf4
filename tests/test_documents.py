"""Documents have one schema, and a file that cannot be used is one sentence."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visualrhp.documents import (
    FileKind,
    Finite,
    brief,
    conform,
    document,
    files_named,
    parse_json,
    shown_path,
)
from visualrhp.errors import CheckpointError, DataError
from visualrhp.parameters import Count, Field


@document
class Inner:
    name: str
    rates: dict[str, Finite]


@document
class Card:
    num_objects: Count
    seed: int | None
    parts: tuple[Inner, ...]

    def __post_init__(self) -> None:
        if self.num_objects != len(self.parts):
            raise ValueError(f"num_objects={self.num_objects}, but there are {len(self.parts)} parts")


KIND = FileKind("a card (a JSON file)", "make it again with python -m make")
GOOD: dict[str, Any] = {"num_objects": 1, "seed": None, "parts": [{"name": "a", "rates": {"x": 1}}], "unknown": [3]}


def refused(path: Path, kind: FileKind = KIND, schema: Any = Card) -> str:
    with pytest.raises(kind.error) as caught:
        kind.read(path, schema)
    message = str(caught.value)
    assert path.name[:20] in message and "\n" not in message and len(message) < 2000
    assert message.endswith("; make it again with python -m make.")
    return message


def test_a_document_that_fits_is_read(tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    path.write_text(json.dumps(GOOD))
    card = KIND.read(path, Card)
    assert card == Card(1, None, (Inner("a", {"x": 1.0}),))
    with pytest.raises(AttributeError):
        card.seed = 3
    assert KIND.read_content(path) == GOOD


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"num_objects": "abc"}, "num_objects=abc has the wrong type: it should be an integer, at least 1"),
        ({"num_objects": True}, "num_objects=True has the wrong type"),
        ({"num_objects": 1.0}, "num_objects=1.0 has the wrong type"),
        ({"num_objects": 0}, "num_objects=0 is out of range"),
        ({"num_objects": 2}, "num_objects=2, but there are 1 parts"),
        ({"num_objects": None}, "num_objects=null has the wrong type"),
        ({"seed": "0"}, "seed=0 has the wrong type: it should be an integer or null"),
        ({"parts": {}}, "parts"),
        ({"parts": [3]}, r"parts\[0\]=3 should be a group of keys: name, rates"),
        ({"parts": [{"name": "a", "rates": {"x": "1"}}]}, r"parts\[0\].rates.x=1 has the wrong type"),
        ({"parts": [{"name": "a"}]}, r"The key parts\[0\].rates is missing"),
        ({"parts": "x" * 10_000}, "parts=xxx"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    path = tmp_path / "card.json"
    path.write_text(json.dumps(GOOD | change))
    with pytest.raises(DataError, match=words):
        KIND.read(path, Card)
    refused(path)


@pytest.mark.parametrize("key", ["num_objects", "seed", "parts"])
def test_every_key_is_required(tmp_path: Path, key: str) -> None:
    path = tmp_path / "card.json"
    path.write_text(json.dumps({name: value for name, value in GOOD.items() if name != key}))
    assert f"The key {key} is missing" in refused(path)


@pytest.mark.parametrize("content", [None, [], [GOOD], "text", 3, True, 1.5])
def test_another_container_is_named(tmp_path: Path, content: Any) -> None:
    path = tmp_path / "card.json"
    path.write_text(json.dumps(content))
    assert "it should be a group of keys (a JSON object), but is" in refused(path)
    path.write_text("{}")
    rows = Annotated[list[dict[str, Finite]], Field()]
    assert "it should be a list (a JSON array), but is a group of keys" in refused(path, schema=rows)


BROKEN = {
    "": "0 bytes",
    "{": "it should be JSON, but",
    "{} {}": "it should be JSON, but",
    '{"a": 1, "b": 2, "a": 1}': "the key 'a' occurs twice",
    '{"a": NaN}': "NaN is not a number in JSON",
    "[-Infinity]": "-Infinity is not a number in JSON",
    "[1e999]": "the number '1e999' is too large",
    "1" * 5000: "the integer '1111",
    "[" * 100_000: "nested in more than 100 levels",
    "[" * 101 + "]" * 101: "nested in more than 100 levels",
    '["\\ud800"]': "half of a surrogate pair",
    "\ufeff{}": "it should be JSON, but",
}


@pytest.mark.parametrize("text", BROKEN, ids=lambda text: repr(text)[:20])
def test_what_is_not_plain_json_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "card.json"
    path.write_text(text, encoding="utf-8")
    assert BROKEN[text] in refused(path)


def test_bytes_that_are_no_text_are_named(tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    path.write_bytes(b'{"a": "\xff"}')
    assert "byte 7 (0xff) is not UTF-8 text" in refused(path)


def test_what_cannot_be_opened_is_named_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    assert "does not exist; it should be a card (a JSON file)" in refused(path)
    path.mkdir()
    assert "is a folder" in refused(path)
    path.rmdir()
    path.symlink_to(tmp_path / "nowhere")
    assert "nowhere, which does not exist" in refused(path)
    path.unlink()
    path.symlink_to(path)
    assert "loop of links" in refused(path)
    path.unlink()
    os.mkfifo(path)
    assert "is not a regular file" in refused(path)  # instead of waiting for a writer
    path.unlink()
    path.write_text("{}")
    assert "a part of its path is a file" in refused(path / "card.json")
    assert "its name is too long" in refused(tmp_path / ("x" * 300))
    with pytest.raises(DataError, match=r"card\\x00\.json is not a path"):
        KIND.require("card\0.json")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission_is_named(tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    path.write_text("{}")
    path.chmod(0)
    assert "no permission" in refused(path)
    path.chmod(0o600)
    tmp_path.chmod(0)
    try:
        assert "no permission" in refused(path)
    finally:
        tmp_path.chmod(0o700)


def test_the_class_of_the_error_and_the_word_for_a_missing_file_are_those_of_the_kind(tmp_path: Path) -> None:
    kind = FileKind("a card", "make it again with python -m make", CheckpointError, missing="is missing")
    assert "card.json is missing" in refused(tmp_path / "card.json", kind)


def test_messages_are_bounded_and_printable(tmp_path: Path) -> None:
    deep = tmp_path.joinpath(*["folder" * 30] * 10, "card.json")
    with pytest.raises(DataError) as caught:
        KIND.require(deep)
    assert len(str(caught.value)) < 1000 and "card.json" in str(caught.value)
    assert shown_path("a\nb\x1b[31m") == "a\\nb\\x1b[31m"
    assert brief("a\n  b\tc.") == "a b c" and len(brief("x" * 5000)) < 1000
    path = tmp_path / "card.json"
    path.write_text(json.dumps({"x" * 5000: 1, "num_objects": {"y" * 5000: [0]}}))
    refused(path)


def test_files_that_lead_nowhere_are_found(tmp_path: Path) -> None:
    for name in ("b", "a", "c"):
        (tmp_path / name).mkdir()
    (tmp_path / "a" / "x.csv").write_text("")
    (tmp_path / "b" / "x.csv").symlink_to(tmp_path / "nowhere")
    assert list(files_named(tmp_path, "*", "x.csv")) == [tmp_path / "a" / "x.csv", tmp_path / "b" / "x.csv"]
    assert not list(files_named(tmp_path / "none", "*", "x.csv"))


def test_nan_can_be_allowed() -> None:
    assert str(parse_json("[NaN, -Infinity, 1.5]", allow_nan=True)) == "[nan, -inf, 1.5]"


PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**100), 2**100)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs"])),
    lambda items: st.lists(items) | st.dictionaries(st.text(st.characters(exclude_categories=["Cs"])), items),
)


@given(PLAIN)
def test_what_json_writes_is_read(content: Any) -> None:
    assert parse_json(json.dumps(content)) == content


@given(PLAIN)
def test_any_content_fits_or_is_a_value_error(content: Any) -> None:
    with contextlib.suppress(ValueError):
        assert isinstance(conform(Card, content), Card)


@given(st.text() | st.binary().map(lambda data: data.decode("latin-1")))
def test_any_text_is_json_or_a_value_error(text: str) -> None:
    with contextlib.suppress(ValueError):
        parse_json(text)
