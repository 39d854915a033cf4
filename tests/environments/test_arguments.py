"""Checks of arguments: what is an integer, a seed, a split, and short messages about anything else."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.environments.arguments import (
    checked_integer,
    checked_name,
    checked_seed,
    checked_split,
    is_integer,
    shown,
)
from visualrhp.errors import ConfigError
from visualrhp.streams import Split


class Silent:
    """Cannot be shown."""

    def __repr__(self) -> str:
        raise RuntimeError("no")


@pytest.mark.parametrize(
    "value",
    ["x" * 10_000, [1.5] * 10_000, np.zeros((50, 50)), 10**6000, {str(i): i for i in range(999)}, Silent(), "a\nb"],
    ids=["string", "list", "array", "integer", "dictionary", "no repr", "lines"],
)
def test_anything_is_shown_in_one_short_line(value: object) -> None:
    text = shown(value)
    assert 0 < len(text) <= 80 and "\n" not in text


def test_booleans_and_time_differences_are_no_integers() -> None:
    assert all(map(is_integer, (0, -3, 10**30, np.int8(3), np.uint64(3))))
    assert not any(map(is_integer, (True, np.True_, 1.0, "1", None, np.timedelta64(1, "s"), np.array(1), 1j)))


@pytest.mark.parametrize("value", [0, 5, 2.0, True, "3", None, [3], [10**6000]])
def test_integers_out_of_range_are_refused(value: object) -> None:
    with pytest.raises(ConfigError, match=r"^size is the size of it, an integer, from 1 to 4, not ") as caught:
        checked_integer("size", "the size of it", value, 1, 4)
    assert len(str(caught.value)) < 200


def test_integers_become_integers_of_python() -> None:
    number = checked_integer("size", "the size", np.int16(3), 1, 4)
    assert number == 3 and type(number) is int
    assert checked_seed(10**30) == 10**30 and type(checked_seed(np.uint8(7))) is int
    for seed in (-1, 1.5, True, "3", [1], np.timedelta64(3, "s")):
        with pytest.raises(ConfigError, match=r"^seed is the seed of the task instances, an integer, at least 0"):
            checked_seed(seed)


def test_names_are_strings() -> None:
    assert checked_name("observation", "image") == "image"
    for name in (None, 3, ["image"], b"image"):
        with pytest.raises(ConfigError, match="observation is a name in quotes"):
            checked_name("observation", name)


def test_splits_by_number_or_member() -> None:
    assert [checked_split(split) for split in Split] == [checked_split(int(split)) for split in Split] == list(Split)
    for split in (77, -1, "EVALUATION", True, 1.0, None, [1], np.zeros(3)):
        with pytest.raises(ConfigError, match=r"choose one of 0 \(demonstrations\)"):
            checked_split(split)
