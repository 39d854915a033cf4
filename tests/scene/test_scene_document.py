"""YAML and JSON as plain values with places, in bounded time and with bounded messages."""

from __future__ import annotations

import json
import math
import re
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from tests.calls import FEW_CALLS, counted_calls
from visualrhp.errors import SceneError
from visualrhp.scene.scene_document import (
    MAX_BYTES,
    MAX_MESSAGE,
    MAX_VALUES,
    MOST_FAULTS,
    Fault,
    SceneDocument,
    fault_lines,
    shortened,
    worded,
)

YAML_FILE, JSON_FILE = Path("scene.yaml"), Path("scene.json")


def error_of(text: str, source: Path = YAML_FILE) -> str:
    with pytest.raises(SceneError) as caught:
        SceneDocument(source, text)
    assert len(str(caught.value)) <= MAX_MESSAGE
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("1.", 1.0),
        (".5", 0.5),
        ("-0.0", -0.0),
        ("-0", 0),
        ("010", 10),
        ("0o17", 15),
        ("0x1F", 31),
        ("-0b101", -5),
        ("1_000", 1000),
        ("1_0.5", 10.5),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("~", None),
        ("null", None),
        ("", None),
        ("true", True),
        ("no", "no"),
        ("on", "on"),
        ("1:30", "1:30"),
        ("'1'", "1"),
        ("!!str 1", "1"),
        ("!!float 1", 1.0),
        ("<<", "<<"),
        ("_", "_"),
        ("1e", "1e"),
        ("e3", "e3"),
    ],
)
def test_plain_values_are_those_of_yaml_1_2(text: str, value: Any) -> None:
    found = SceneDocument(YAML_FILE, f"a: {text}\n").content["a"]
    assert found == value and type(found) is type(value) and str(found) == str(value)


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=12,
)


@given(plain)
def test_json_is_read_as_by_python_and_as_yaml_alike(content: Any) -> None:
    text = json.dumps({"a": content})
    assert SceneDocument(JSON_FILE, text).content == {"a": content}
    if "\\u" not in text and "Infinity" not in text:
        assert SceneDocument(YAML_FILE, text).content == {"a": content}


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False) | st.integers(), min_size=1, max_size=6))
def test_numbers_are_those_of_the_reference_reader(values: list[float]) -> None:
    text = "\n".join(f"- {value!r}" for value in values)
    expected = YAML(typ="safe", pure=True).load(text)
    assert [repr(value) for value in SceneDocument(YAML_FILE, text).content] == [repr(value) for value in expected]


@given(st.text(max_size=60) | st.text(alphabet="[]{}:,-?&*!|>#'\"%@` \n\ta1.", max_size=60))
def test_any_text_is_read_or_refused_in_a_short_sentence(text: str) -> None:
    for source in (YAML_FILE, JSON_FILE):
        with pytest.raises(SceneError) as caught:
            SceneDocument(source, text).refuse([Fault(("objects", 3, "a"), "is wrong")])
        assert str(caught.value).startswith("scene.") and len(str(caught.value)) <= MAX_MESSAGE


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("# nothing\n", "is empty"),
        ("a: 1\na: 2", "scene.yaml:2:1: a: occurs twice; remove one"),
        ("a: *b", "undefined alias 'b'"),
        ("a: &b [*b]", "is nested too deeply"),
        ("[" * 900_000, "nested too deeply"),
        ("- " * 400_000, "nested too deeply"),
        ("{a: " * 100_000, "nested too deeply"),
        ("a: 1\n---\nb: 2", "there is a second document"),
        ("a: !!python/name:os.system 1", "scene.yaml:1:4: .*stands for no plain value"),
        ("a: !!set {b}", "stands for no plain value"),
        ("a: !!int x", "is not of its type, int"),
        ("{? [1] : 2}", "a key that is not the name of a field"),
        ("a: \0", "is not a YAML file"),
        ("a: " + "9" * 5000, "4300 digits"),
        ("[" + "0, " * (MAX_VALUES + 1) + "]", f"more than {MAX_VALUES} values"),
        ("a" * (MAX_BYTES + 1), "more than 1000000 characters"),
    ],
    ids=range(17),
)
def test_what_is_no_document(text: str, message: str) -> None:
    started = time.perf_counter()
    found = error_of(text)
    assert time.perf_counter() - started < 5.0
    assert shortened(message, 500) == message
    assert re.search(message, found), found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not JSON"),
        ("a: 1", "scene.json:1:1: is not JSON"),
        ('{"a": 1, "b": {"c": 1, "c": 2}}', "scene.json:1:24: b.c: occurs twice"),
        ('{"\\ud800": 1, "\\ud800": 2}', "occurs twice|is not a YAML"),
        ("[" * 900_000, "is not JSON of a scene"),
        ("9" * 5000, "is not JSON of a scene"),
    ],
    ids=range(6),
)
def test_what_is_no_json(text: str, message: str) -> None:
    assert re.search(message, error_of(text, JSON_FILE))


def test_places_are_those_of_values_and_of_keys() -> None:
    for source, text in ((YAML_FILE, "a:\n  - x: 1\n    y: 2\n"), (JSON_FILE, '{"a":\n [{"x": 1,\n\t"y": 2}]}')):
        document = SceneDocument(source, text)
        for fault, place in (
            (Fault(("a", 0, "y"), "is wrong"), {YAML_FILE: "3:8", JSON_FILE: "3:7"}),
            (Fault(("a", 0, "y"), "is wrong", at_key=True), {YAML_FILE: "3:5", JSON_FILE: "3:2"}),
            (Fault(("a", 0, "z"), "is missing"), {YAML_FILE: "2:5", JSON_FILE: "2:3"}),
        ):
            with pytest.raises(SceneError, match=f"{source}:{place[source]}: a\\[0\\].[yz]: is"):
                document.refuse([fault])
        document.refuse([])


def test_json_that_yaml_cannot_read_has_no_place() -> None:
    document = SceneDocument(JSON_FILE, '{"a": "\\ud83d\\ude00"}')
    assert document.content == {"a": "😀"}
    with pytest.raises(SceneError, match=r"scene.json: a: is wrong"):
        document.refuse([Fault(("a",), "is wrong")])


def test_many_and_long_faults_make_a_short_message() -> None:
    lines = [f"fault {number} {'x' * 3000}" for number in range(10_000)]
    message = fault_lines(lines)
    assert (
        len(message) <= MAX_MESSAGE and "fault 0 " in message and "fault 9999" in message and "more faults" in message
    )
    short = fault_lines(["a", "b", "c"])
    assert short == "a\nb\nc"
    assert len(fault_lines(["x" * 5000])) <= MAX_MESSAGE
    assert [worded(number, 100) for number in (0, MOST_FAULTS - 1, MOST_FAULTS, 99)] == [True, True, False, True]
    assert shortened("x" * 5000, 100).count("x") < 100 and shortened("short") == "short"


def test_a_large_yaml_is_read_fast() -> None:
    text = "points: [" + ", ".join(f"[{n * 1.1!r}, {n * 0.7!r}]" for n in range(20_000)) + "]"
    with counted_calls() as calls:
        assert len(SceneDocument(YAML_FILE, text).content["points"]) == 20_000
    assert calls.count < FEW_CALLS
