import pytest

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation.classes import (
    FIRST_OBJECT_CLASS,
    NUM_CLASSES,
    OBJECT_CLASSES,
    class_of,
    object_of,
)


def test_classes_and_objects_are_one_to_one() -> None:
    assert [class_of(*object_of(index)) for index in range(FIRST_OBJECT_CLASS, NUM_CLASSES)] == list(
        range(FIRST_OBJECT_CLASS, NUM_CLASSES)
    )
    assert {kind for kind, _ in OBJECT_CLASSES} == set(Kind)


def test_only_bottles_and_cups_lie() -> None:
    for kind in Kind:
        assert (class_of(kind, True) != class_of(kind, False)) == (kind in (Kind.BOTTLE, Kind.CUP))


@pytest.mark.parametrize("index", [-1, 0, 1, NUM_CLASSES])
def test_background_and_robot_are_no_objects(index: int) -> None:
    with pytest.raises(ValueError, match="2 to 8"):
        object_of(index)
