"""How a user names an object."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.embodiment.seen_bodies import CIRCLE
from visualrhp.embodiment.desired import DesiredObject
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.registration import Reference
from visualrhp.embodiment.track import Track
from visualrhp.errors import ConfigError, PerceptionError

BASE = (-0.5, 0.0)


def track(number: int, kind: Kind, x: float, y: float) -> Track:
    return Track(number, Reference(0.03 * CIRCLE), np.array([x, y, 0.0]), (0.0, 0.05), {kind: 1.0})


TRACKS = [track(0, Kind.APPLE, 0.0, 0.0), track(1, Kind.ORANGE, 0.1, 0.0), track(2, Kind.ORANGE, -0.1, 0.1)]


@pytest.mark.parametrize(
    ("desired", "expected"),
    [
        (DesiredObject(Kind.APPLE), 0),
        (DesiredObject(Kind.ORANGE), 2),  # the closest to the base
        (DesiredObject(Kind.ORANGE, 1), 1),
        (DesiredObject(Kind.ORANGE, place=(0.1, 0.01)), 1),
        (DesiredObject(Kind.ORANGE, place=(0.15, 0.0)), 1),  # 2 cm beside it
        (DesiredObject(Kind.APPLE, place=(0.0, 0.0)), 0),
    ],
)
def test_it_is_the_one_that_is_named(desired: DesiredObject, expected: int) -> None:
    assert desired.choose(TRACKS, BASE).id == expected


def test_another_one_of_its_kind_is_not_meant_by_a_place() -> None:
    with pytest.raises(PerceptionError, match=r"orange number 0 at \(0\.000, 0\.000\), is not seen; seen are: apple 0"):
        DesiredObject(Kind.ORANGE, place=(0.0, 0.0)).choose(TRACKS, BASE)
    with pytest.raises(PerceptionError, match="seen are: nothing"):
        DesiredObject(Kind.ORANGE).choose([], BASE)


@pytest.mark.parametrize("place", [(10.0, 5.0), (float("nan"), 0.0), (0.1,)])
def test_a_place_is_one_on_the_table_in_metres(place: Any) -> None:
    with pytest.raises(ConfigError, match="place"):
        DesiredObject(Kind.ORANGE, place=place)
