"""What a segmenter misses is still there if the image says so."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.persistence import Persistence
from visualrhp.embodiment.segmentation import Detection

SIZE = 120
BOX = (slice(40, 80), slice(30, 90))
NOTHING = np.zeros((SIZE, SIZE), dtype=bool)
TABLE = np.array([120.0, 90.0, 60.0])


def mask_of(place: tuple[slice, slice]) -> np.ndarray:
    mask = NOTHING.copy()
    mask[place] = True
    return mask


def picture(
    contrast: float = 40.0, place: tuple[slice, slice] | None = BOX, light: float = 1.0, seed: int = 0
) -> np.ndarray:
    """A plain box on a grained table, with the noise of a camera."""
    grain = cv2.GaussianBlur(np.random.default_rng(5).normal(0.0, 12.0, (SIZE, SIZE)), (0, 0), 3.0)
    image = TABLE + grain[..., None]
    if place is not None:
        image[place] = TABLE + contrast
    noise = np.random.default_rng(seed).normal(0.0, 4.0, image.shape)
    return np.clip(light * image + noise, 0.0, 255.0).astype(np.uint8)


@pytest.fixture(params=[12.0, 40.0, -30.0])
def contrast(request: pytest.FixtureRequest) -> float:
    return request.param


def remembered(contrast: float, arm: np.ndarray = NOTHING) -> Persistence:
    persistence = Persistence()
    found = Detection(Kind.BOX, False, mask_of(BOX) & ~arm, 0.9)
    persistence.remember(picture(contrast), {7: found}, arm, [7])
    return persistence


@pytest.mark.parametrize("light", [1.0, 0.75, 1.15])
def test_a_missed_object_that_looks_as_before_is_recalled(contrast: float, light: float) -> None:
    recalled = remembered(contrast).recall(picture(contrast, light=light, seed=1), [], NOTHING)
    assert list(recalled) == [7] and recalled[7].kind is Kind.BOX
    assert np.array_equal(recalled[7].mask, mask_of(BOX))


@pytest.mark.parametrize("place", [None, (slice(40, 80), slice(50, 110)), (slice(60, 100), slice(30, 90))])
@pytest.mark.parametrize("light", [1.0, 0.75])
def test_one_that_was_taken_or_pushed_away_is_not(
    contrast: float, place: tuple[slice, slice] | None, light: float
) -> None:
    assert not remembered(contrast).recall(picture(contrast, place, light, seed=1), [], NOTHING)


@pytest.mark.parametrize("light", [1.0, 0.8])
def test_the_pattern_of_the_table_under_it_is_not_taken_for_it(contrast: float, light: float) -> None:
    """The border of a dark disc runs through all that is compared, in both images."""

    def on_disc(image: np.ndarray) -> np.ndarray:
        return np.where((np.arange(SIZE) < 60)[:, None, None], image, image // 3).astype(np.uint8)

    persistence = Persistence()
    persistence.remember(on_disc(picture(contrast)), {7: Detection(Kind.BOX, False, mask_of(BOX))}, NOTHING, [7])
    assert not persistence.recall(on_disc(picture(contrast, None, light, seed=1)), [], NOTHING)


def test_what_is_detected_in_its_place_counts(contrast: float) -> None:
    other = Detection(Kind.CUP, False, mask_of((slice(40, 80), slice(30, 50))))
    assert not remembered(contrast).recall(picture(contrast, seed=1), [other], NOTHING)
    beside = Detection(Kind.CUP, False, mask_of((slice(40, 80), slice(88, 110))))
    assert list(remembered(contrast).recall(picture(contrast, seed=1), [beside], NOTHING)) == [7]


def test_what_the_arm_hides_is_not_compared(contrast: float) -> None:
    arm = mask_of((slice(0, SIZE), slice(0, 50)))
    covered = picture(contrast, seed=1)
    covered[arm] = 200
    recalled = remembered(contrast).recall(covered, [], arm)
    assert np.array_equal(recalled[7].mask, mask_of(BOX) & ~arm)
    assert list(remembered(contrast, arm).recall(picture(contrast, seed=1), [], NOTHING)) == [7]
    most = mask_of((slice(0, SIZE), slice(0, 70)))
    assert not remembered(contrast).recall(covered, [], most)


def test_an_object_that_is_no_longer_known_is_forgotten() -> None:
    persistence = remembered(40.0)
    persistence.remember(picture(), {}, NOTHING, [])
    assert not persistence.recall(picture(seed=1), [], NOTHING)


def test_an_object_that_looks_like_its_surroundings_cannot_be_told() -> None:
    assert not remembered(0.0).recall(picture(0.0, seed=1)[:, ::-1].copy(), [], NOTHING)
