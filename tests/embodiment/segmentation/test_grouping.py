"""Objects from maps that are painted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.embodiment.segmentation.classes import NUM_CLASSES
from visualrhp.embodiment.segmentation.grouping import GroupingConfig, find_peaks, group

SIDE = 60


def maps(discs: list[tuple[float, float, float, int]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a perfect network answers to discs (x, y, radius, class) [cells]; later ones lie below earlier ones."""
    v, u = np.mgrid[:SIDE, :SIDE].astype(np.float64)
    probabilities = np.zeros((NUM_CLASSES, SIDE, SIDE))
    centres, offsets = np.zeros((SIDE, SIDE)), np.zeros((2, SIDE, SIDE))
    free = np.ones((SIDE, SIDE))
    for x, y, radius, index in discs:
        coverage = np.minimum(free, np.clip(radius - np.hypot(u - x, v - y) + 0.5, 0.0, 1.0))
        mine = coverage > 0.5
        probabilities[index] += coverage
        free -= coverage
        centres = np.maximum(centres, np.exp(-((u - x) ** 2 + (v - y) ** 2) / 8.0))
        offsets[0][mine], offsets[1][mine] = x - u[mine], y - v[mine]
    probabilities[0] = free
    return probabilities, centres, offsets


def disc(x: float, y: float, radius: float, factor: int = 4) -> np.ndarray:
    """The same disc in pixels: the centre of cell 0 lies between pixels 1 and 2."""
    v, u = np.mgrid[: factor * SIDE, : factor * SIDE]
    middle = 0.5 * (factor - 1)
    return np.hypot(u - factor * x - middle, v - factor * y - middle) <= factor * radius


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    return float((one & other).sum() / (one | other).sum())


def test_outlines_are_finer_than_cells() -> None:
    discs = [(20.3, 30.7, 6.4, 4), (40.1, 15.2, 5.2, 2)]
    instances = group(*maps(discs), 4 * SIDE)
    assert sorted(instance.class_index for instance in instances) == [2, 4]
    for instance in instances:
        x, y, radius, _ = next(one for one in discs if one[3] == instance.class_index)
        assert overlap(instance.mask, disc(x, y, radius)) > 0.96
        v, u = np.nonzero(instance.mask)
        assert u.mean() == pytest.approx(4 * x + 1.5, abs=0.2) and v.mean() == pytest.approx(4 * y + 1.5, abs=0.2)
        assert instance.score > 0.9


def test_objects_that_touch_are_told_apart() -> None:
    discs = [(20.0, 30.0, 6.0, 4), (32.0, 30.0, 6.0, 4), (26.0, 40.4, 6.0, 4)]
    instances = group(*maps(discs), 4 * SIDE)
    assert len(instances) == 3
    assert not (instances[0].mask & instances[1].mask).any()
    for x, y, radius, _ in discs:
        assert max(overlap(instance.mask, disc(x, y, radius)) for instance in instances) > 0.93


def test_an_object_in_two_parts_is_one() -> None:
    """The arm lies across it."""
    probabilities, centres, offsets = maps([(30.0, 30.0, 9.0, 8)])
    probabilities[8, 28:32] = 0.0
    probabilities[1, 28:32] = 1.0
    (instance,) = group(probabilities, centres, offsets, 4 * SIDE)
    assert not instance.mask[4 * 29 : 4 * 31].any()
    assert instance.mask[: 4 * 28].any() and instance.mask[4 * 32 :].any()


def test_several_peaks_of_a_long_object_are_one() -> None:
    probabilities, centres, offsets = maps([(30.0, 30.0, 9.0, 3)])
    for x in (22, 38):
        centres[30, x] = 0.8
    (instance,) = group(probabilities, centres, offsets, 4 * SIDE)
    assert overlap(instance.mask, disc(30.0, 30.0, 9.0)) > 0.96


def test_nothing_is_found_in_nothing() -> None:
    assert group(*maps([]), 4 * SIDE) == []
    probabilities, centres, offsets = maps([(20.0, 20.0, 6.0, 4)])
    assert group(probabilities, 0.0 * centres, offsets, 4 * SIDE) == []


def test_what_is_too_small_is_no_object() -> None:
    assert group(*maps([(20.0, 20.0, 1.0, 4)]), 4 * SIDE) == []
    assert len(group(*maps([(20.0, 20.0, 1.0, 4)]), 4 * SIDE, GroupingConfig(least_area=1.0))) == 1


def test_peaks_come_highest_first() -> None:
    _, centres, _ = maps([(20.0, 20.0, 6.0, 4), (40.0, 20.0, 6.0, 4)])
    centres[:, 30:] *= 0.6
    assert find_peaks(centres, GroupingConfig()).tolist() == [[20, 20], [40, 20]]
    assert find_peaks(centres, GroupingConfig(least_peak=0.7)).tolist() == [[20, 20]]
