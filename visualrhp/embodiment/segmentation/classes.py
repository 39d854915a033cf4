"""What the pixels of an image can be, to our segmentation network: background, the robot, or a kind of object."""

from __future__ import annotations

from typing import Final

from visualrhp.embodiment.kinds import Kind

BACKGROUND: Final = 0
"""The table, the floor and all that lies on it, fallen objects included."""
ROBOT: Final = 1
FIRST_OBJECT_CLASS: Final = 2

OBJECT_CLASSES: Final[tuple[tuple[Kind, bool], ...]] = (
    (Kind.BOTTLE, False),
    (Kind.BOTTLE, True),
    (Kind.APPLE, False),
    (Kind.ORANGE, False),
    (Kind.CUP, False),
    (Kind.CUP, True),
    (Kind.BOX, False),
)
"""(kind, whether it lies on its side) of class :data:`FIRST_OBJECT_CLASS` and those after it."""

NUM_CLASSES: Final = FIRST_OBJECT_CLASS + len(OBJECT_CLASSES)
NUM_SURFACES: Final = FIRST_OBJECT_CLASS + 1
"""Background, robot, and any object."""


def class_of(kind: Kind, is_lying: bool) -> int:
    """The class of an object. A box and a round object look the same on every side."""
    if kind not in (Kind.BOTTLE, Kind.CUP):
        is_lying = False
    return FIRST_OBJECT_CLASS + OBJECT_CLASSES.index((kind, is_lying))


def object_of(index: int) -> tuple[Kind, bool]:
    """(kind, whether it lies on its side) of a class of objects.

    Raises:
        ValueError: the class is none of objects.
    """
    if not FIRST_OBJECT_CLASS <= index < NUM_CLASSES:
        raise ValueError(f"class {index} is none of objects: these are {FIRST_OBJECT_CLASS} to {NUM_CLASSES - 1}")
    return OBJECT_CLASSES[index - FIRST_OBJECT_CLASS]
