"""Calipers by hand, and against widths in many directions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visualrhp.scene import ObjectShape, geometry, graspability


def bar(length: float, width: float) -> ObjectShape:
    return ObjectShape.centred([[0, 0], [length, 0], [length, width], [0, width]])


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (bar(0.05, 0.05), "always"),
        (bar(0.08, 0.08), "directional"),  # its diagonal is longer than the stroke
        (bar(0.2, 0.02), "directional"),
        (bar(0.2, 0.084), "directional"),
        (bar(0.2, 0.086), "never"),
        # an L whose arms are thin: what counts is the width across, notches included
        (ObjectShape.centred([[0, 0], [0.2, 0], [0.2, 0.02], [0.02, 0.02], [0.02, 0.2], [0, 0.2]]), "never"),
    ],
)
def test_by_hand(shape: ObjectShape, expected: str) -> None:
    assert graspability(shape, 0.085) == expected
    turned = ObjectShape.centred(shape.outline @ geometry.rotation_matrix(1.0).T)
    assert graspability(turned, 0.085) == expected


@given(st.integers(0, 2**32 - 1))
def test_calipers_bound_the_width_in_every_direction(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(8, 2))
    angles = np.linspace(0.0, np.pi, 3600)
    extents = points @ np.stack([np.cos(angles), np.sin(angles)])
    widths = extents.max(axis=0) - extents.min(axis=0)
    narrowest, widest = geometry.width_range(geometry.convex_hull(points))
    assert narrowest <= widths.min() + 1e-12 and widest >= widths.max() - 1e-12
    assert narrowest == pytest.approx(widths.min(), abs=widest * 1e-3)
    assert widest == pytest.approx(widths.max(), rel=1e-6)
