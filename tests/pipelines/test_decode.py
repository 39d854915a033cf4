"""From plain content to typed dataclasses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest

from pipelines.decode import Range, decode
from visualrhp.errors import ConfigError


@dataclass(frozen=True)
class Cat:
    kind: Literal["cat"]
    lives: Annotated[int, Range(at_least=1, at_most=9)]


@dataclass(frozen=True)
class Dog:
    kind: Literal["dog"]
    names: tuple[str, ...]


@dataclass(frozen=True)
class Home:
    pet: Cat | Dog
    size: tuple[float, float]
    rooms: Annotated[int, Range(at_least=1)] | tuple[int, int]
    address: str | None
    heated: bool
    notes: dict[str, Any]


CONTENT: dict[str, Any] = {
    "pet": {"kind": "cat", "lives": 7},
    "size": [3, 4.5],
    "rooms": 2,
    "address": None,
    "heated": True,
    "notes": {"a": [1]},
}


def test_every_kind_of_field() -> None:
    expected = Home(Cat("cat", 7), (3.0, 4.5), 2, None, True, {"a": [1]})
    assert decode(Home, CONTENT) == expected
    other = CONTENT | {"pet": {"kind": "dog", "names": ["Rex"]}, "rooms": [1, 2]}
    decoded = decode(Home, other)
    assert decoded.pet == Dog("dog", ("Rex",))
    assert decoded.rooms == (1, 2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"pet": {"kind": "cat", "lives": 10}},
            "pet.lives=10 is out of range: it should be a whole number, at least 1 and",
        ),
        ({"pet": {"kind": "cow"}}, "pet.kind=cow is not known: it should be cat or dog."),
        ({"pet": {"kind": "cat"}}, "The key pet.lives is missing: it should be a whole number"),
        ({"pet": {"kind": "cat", "lives": 1, "live": 2}}, "There is no key pet.live. Did you mean lives?"),
        ({"pet": {"kind": "cat", "lives": "many"}}, "pet.lives=many has the wrong type: it should be a whole number"),
        ({"pet": {"kind": "cat", "lives": True}}, "pet.lives=True has the wrong type"),
        ({"pet": "cat"}, "pet should be a group with the key kind"),
        ({"size": [1.0]}, r"size=\[1.0\] has the wrong type: it should be a list of 2, each item a number"),
        ({"size": [1.0, float("nan")]}, r"size\[1\]=nan is out of range"),
        ({"rooms": 0}, "rooms=0 is out of range: it should be a whole number, at least 1."),
        ({"rooms": 1.5}, "rooms=1.5 has the wrong type: it should be a whole number, at least 1 or a list of 2"),
        ({"heated": 1}, "heated=1 has the wrong type: it should be true or false."),
        ({"notes": 1}, "notes=1 has the wrong type: it should be a group of keys."),
    ],
)
def test_a_message_names_the_key_and_what_would_be_right(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        decode(Home, CONTENT | changes)
