"""The names of COCO, and the kinds that they stand for."""

from __future__ import annotations

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation.coco import COCO_NAMES, KINDS_BY_NAME, KINDS_OF_COCO


def test_every_kind_has_a_class() -> None:
    assert set(KINDS_OF_COCO.values()) == set(KINDS_BY_NAME.values()) == set(Kind)
    assert set(KINDS_BY_NAME) - {"box"} <= set(COCO_NAMES)


def test_the_order_of_the_names() -> None:
    assert len(COCO_NAMES) == len(set(COCO_NAMES)) == 80
    assert [COCO_NAMES[index] for index in (0, 39, 41, 47, 49, 73, 79)] == [
        "person",
        "bottle",
        "cup",
        "apple",
        "orange",
        "book",
        "toothbrush",
    ]
