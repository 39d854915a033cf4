"""Kinds of objects on the table: how their widest cross-section, which the planner's outline is, lies above the table.

A camera above the table sees the silhouette of a body, displaced and enlarged by perspective. Its outline on the table
is found at the height of the widest cross-section of its kind (docs/execution.md, Perception).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """What an object is. The names are those of COCO's categories, where it has one."""

    BOTTLE = "bottle"
    APPLE = "apple"
    ORANGE = "orange"
    CUP = "cup"
    BOX = "box"


@dataclass(frozen=True, slots=True)
class WidestSection:
    """Heights between which the cross-section of a body is widest [m]; equal for a round one."""

    low: float
    high: float


BOTTLE_BODY: WidestSection = WidestSection(0.0, 0.11)
"""Of a standing bottle: its body is a cylinder up to the shoulder."""
CUP_RIM: WidestSection = WidestSection(0.09, 0.09)
"""A cup is widest at its rim."""
BOX: WidestSection = WidestSection(0.0, 0.07)
"""The vertical sides of a box."""


def widest_section(kind: Kind, is_lying: bool, width: float) -> WidestSection:
    """Where a body of ``kind`` is widest.

    Args:
        kind: what it is.
        is_lying: whether it lies on its side (bottles and cups).
        width: the smaller extent of its silhouette [m], for kinds that are as high as they are wide.
    """
    if kind in (Kind.APPLE, Kind.ORANGE) or (is_lying and kind is not Kind.BOX):
        return WidestSection(0.5 * width, 0.5 * width)
    return {Kind.BOTTLE: BOTTLE_BODY, Kind.CUP: CUP_RIM, Kind.BOX: BOX}[kind]
