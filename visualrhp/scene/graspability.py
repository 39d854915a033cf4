"""Whether an object fits between the fingers from any, some or no directions (paper, Sec. 7)."""

from __future__ import annotations

from typing import Literal

from visualrhp.scene import geometry
from visualrhp.scene.scene import ObjectShape

Graspability = Literal["always", "directional", "never"]


def graspability(shape: ObjectShape, stroke: float) -> Graspability:
    """Whether an object fits into a gripper opened to ``stroke`` [m] from any direction, from some, or from none.

    The fingers close across the width of the outline, which rotating calipers measure in every direction. Notches are
    ignored: an object that could only be held by one of its arms counts as ``never`` graspable.
    """
    narrowest, widest = geometry.width_range(shape.outline)
    if widest < stroke:
        return "always"
    return "directional" if narrowest < stroke else "never"
