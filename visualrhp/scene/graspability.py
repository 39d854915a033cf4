"""From how many directions an object fits between the fingers (paper, Sec. 7)."""

from __future__ import annotations

from typing import Literal

from visualrhp.scene import geometry
from visualrhp.scene.scene import ObjectShape

Graspability = Literal["always", "directional", "never"]


def graspability(shape: ObjectShape, stroke: float) -> Graspability:
    """Whether an object fits into a gripper opened to ``stroke`` [m] from any direction, from some, or from none.

    The fingers close across the outline's width, which is measured in every direction by rotating calipers. A notch
    does not count: an object that could be held by one of its arms alone, but not across, is ``never`` graspable here.
    """
    narrowest, widest = geometry.width_range(shape.outline)
    if widest < stroke:
        return "always"
    return "directional" if narrowest < stroke else "never"
