"""Parameters that check themselves, from keyword arguments and from plain content."""

from __future__ import annotations

import pickle
from dataclasses import FrozenInstanceError, asdict, replace
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visualrhp.errors import ConfigError
from visualrhp.parameters import AsRange, AsTuple, Count, Field, Fraction, Positive, parameters, validated

Lives = Annotated[int, Field(ge=1, le=9)]


@parameters
class Cat:
    kind: Literal["cat"]
    lives: Lives = 9


@parameters(kw_only=True)
class Kitten(Cat):
    weeks: Count


@parameters
class Dog:
    kind: Literal["dog"]
    names: tuple[str, ...] = ()


@parameters
class Home:
    pet: Annotated[Cat | Dog, Field(discriminator="kind")]
    size: Annotated[tuple[float, float], AsTuple]
    rooms: Annotated[tuple[Count, Count], AsRange, AsTuple]
    rent: Positive | None
    share: Fraction
    heated: bool
    notes: dict[str, Any]
    garden: Literal["none", "front", True]

    def __post_init__(self) -> None:
        if self.rooms[0] > self.rooms[1]:
            raise ValueError(f"rooms={list(self.rooms)}: the smaller bound comes first.")


@parameters
class Street:
    home: Home


CONTENT: dict[str, Any] = {
    "pet": {"kind": "cat", "lives": 7},
    "size": [3, 4.5],
    "rooms": 2,
    "rent": None,
    "share": 1,
    "heated": True,
    "notes": {"a": [1]},
    "garden": True,
}


def test_every_kind_of_field() -> None:
    expected = Home(Cat("cat", 7), (3.0, 4.5), (2, 2), None, 1.0, True, {"a": [1]}, True)
    assert validated(Home, CONTENT) == expected
    assert validated(Home, CONTENT | {"rooms": [1, 2]}).rooms == (1, 2)
    other = validated(Home, CONTENT | {"pet": {"kind": "dog", "names": ["Rex"]}})
    assert other.pet == Dog("dog", ("Rex",))
    assert asdict(expected)["pet"] == {"kind": "cat", "lives": 7}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"pet": {"kind": "cat", "lives": 10}},
            "pet.lives=10 is out of range: it should be an integer, at least 1 and at most 9.",
        ),
        ({"pet": {"kind": "cow"}}, "pet.kind=cow is not known: it should be cat or dog."),
        ({"pet": {"kind": "cat"}}, "The key home.pet.lives is missing: it should be an integer"),
        ({"pet": {"kind": "cat", "lives": 1, "live": 2}}, "There is no key home.pet.live. Did you mean lives?"),
        ({"pet": {"kind": "cat", "lives": "many"}}, "pet.lives=many has the wrong type: it should be an integer"),
        ({"pet": {"kind": "cat", "lives": True}}, "pet.lives=True has the wrong type"),
        ({"pet": {"lives": 1}}, r"pet should be a group with the key kind \(cat or dog\)."),
        ({"pet": {"kind": "dog", "lives": 1, "names": []}}, "There is no key home.pet.lives. Choose from kind, names."),
        ({"pet": "cat"}, "pet=cat should be a group with a key"),
        ({"size": [1.0]}, r"size=\[1.0\] has the wrong type: it should be a list of 2, each item a number"),
        ({"size": 1.0}, r"size=1.0 has the wrong type: it should be a list of 2, each item a number"),
        ({"rent": float("nan")}, "rent=nan is out of range: it should be a finite number."),
        ({"rent": 0}, "rent=0 is out of range: it should be a number, above 0 or null."),
        ({"rent": "much"}, "rent=much has the wrong type: it should be a number, above 0 or null."),
        ({"share": 1.5}, "share=1.5 is out of range: it should be a number, at least 0 and at most 1."),
        ({"rooms": 0}, "rooms=0 is out of range: it should be a list of 2, each item an integer, at least 1."),
        ({"rooms": 1.5}, "rooms=1.5 has the wrong type: it should be a list of 2, each item an integer, at least 1."),
        ({"rooms": [1, 0]}, r"rooms\[1\]=0 is out of range: it should be an integer, at least 1."),
        ({"rooms": [3, 1]}, r"^home.rooms=\[3, 1\]: the smaller bound comes first."),
        ({"heated": 1}, "heated=1 has the wrong type: it should be true or false."),
        ({"notes": 1}, "notes=1 has the wrong type: it should be a group of keys."),
        ({"garden": "back"}, "garden=back is not known: it should be none, front or true."),
        ({"gardn": 1}, "There is no key home.gardn. Did you mean garden?"),
    ],
)
def test_a_message_names_the_key_and_what_would_be_right(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        validated(Street, {"home": CONTENT | changes})


@pytest.mark.parametrize("key", list(CONTENT))
def test_every_key_is_required_of_a_configuration(key: str) -> None:
    with pytest.raises(ConfigError, match=f"The key {key} is missing: it should be"):
        validated(Home, {name: value for name, value in CONTENT.items() if name != key})


def test_constructors_check_and_name_their_arguments() -> None:
    assert Cat("cat").lives == 9
    with pytest.raises(
        ConfigError, match=r"^lives=0 is out of range: it should be an integer, at least 1 and at most 9"
    ):
        Cat("cat", 0)
    with pytest.raises(ConfigError, match=r"^lives=0 is out of range"):
        Cat("cat", lives=0)
    with pytest.raises(ConfigError, match=r"There is no key live. Did you mean lives?"):
        Cat(**{"kind": "cat", "live": 1})
    with pytest.raises(ConfigError, match=r"The key kind is missing: it should be cat."):
        Cat(**{})
    with pytest.raises(ConfigError, match=r"^lives=12 is out of range"):
        replace(Cat("cat"), lives=12)


def test_an_extension_is_the_original_with_more_fields() -> None:
    kitten = Kitten("cat", weeks=3)
    assert isinstance(kitten, Cat)
    assert asdict(kitten) == {"kind": "cat", "lives": 9, "weeks": 3}
    with pytest.raises(ConfigError, match="weeks=0 is out of range"):
        Kitten("cat", weeks=0)


def test_parameters_are_values() -> None:
    cat = Cat("cat", 3)
    assert pickle.loads(pickle.dumps(cat)) == cat
    assert hash(cat) == hash(Cat("cat", 3))
    with pytest.raises(FrozenInstanceError):
        cat.lives = 4


def test_a_long_value_is_shortened() -> None:
    with pytest.raises(ConfigError) as caught:
        validated(Home, CONTENT | {"heated": "x" * 100_000})
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "content",
    [
        CONTENT | {f"key{number}": 1 for number in range(10_000)},
        CONTENT | {"k" * 100_000: 1},
        CONTENT | {"garden": "x" * 100_000},
        CONTENT | {"rent": 10**5000},
        CONTENT | {"rent": -(10**400)},
        CONTENT | {"size": list(range(100_000))},
        CONTENT | {"notes": {1, 2}},
        CONTENT | {"notes": {(1, 2): 3}},
        CONTENT | {"pet": {"kind": ["x" * 5000]}},
        CONTENT | {"heated": "\ud800"},
        [CONTENT],
        None,
        "text" * 1000,
    ],
    ids=range(13),
)
def test_any_content_is_refused_in_a_short_sentence(content: Any) -> None:
    with pytest.raises(ConfigError) as caught:
        validated(Home, content)
    assert 10 < len(str(caught.value)) < 2000


def test_content_that_contains_itself_is_refused() -> None:
    content = dict(CONTENT)
    content["notes"] = content
    with pytest.raises(ConfigError, match="no plain value"):
        validated(Home, content)


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just("cat"),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["pet", "kind", "lives", "names", "rooms", "notes", "a"]), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from([*CONTENT, "home", "x"]), plain, max_size=4))
def test_any_change_is_accepted_or_refused(changes: dict[str, Any]) -> None:
    for attempt in (
        lambda: validated(Home, CONTENT | changes),
        lambda: validated(Street, {"home": CONTENT | changes}),
        lambda: validated(Home, changes),
        lambda: Cat(**changes),
        lambda: Dog(**changes),
        lambda: Home(**changes),
    ):
        message = "no fault was found"
        try:
            attempt()
        except ConfigError as error:
            message = str(error)
        assert 10 < len(message) < 2000
