"""Where the kinds of objects are widest."""

from __future__ import annotations

import pytest

from visualrhp.embodiment.kinds import Kind, widest_section


@pytest.mark.parametrize("kind", [Kind.APPLE, Kind.ORANGE])
def test_fruit_is_widest_at_its_centre(kind: Kind) -> None:
    section = widest_section(kind, False, 0.08)
    assert section.low == section.high == 0.04


def test_a_lying_bottle_is_as_high_as_wide_and_a_standing_one_has_vertical_sides() -> None:
    lying, standing = (widest_section(Kind.BOTTLE, is_lying, 0.07) for is_lying in (True, False))
    assert lying.low == lying.high == 0.035
    assert standing.low == 0.0 < standing.high


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("is_lying", [False, True])
def test_every_kind_has_a_section(kind: Kind, is_lying: bool) -> None:
    section = widest_section(kind, is_lying, 0.06)
    assert 0.0 <= section.low <= section.high <= 0.2
