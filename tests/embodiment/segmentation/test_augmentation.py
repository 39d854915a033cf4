"""Labels move with the image, and nothing else changes them."""

from __future__ import annotations

import numpy as np

from tests.embodiment.segmentation.painter import painted_frames
from visualrhp.embodiment.segmentation.augmentation import augmented
from visualrhp.embodiment.segmentation.configs import Augmentation

PLAIN = Augmentation(brightness=0.0, colour=0.0, contrast=0.0, blur=0.0, noise=0.0)


def test_without_changes_frames_stay_as_they_are() -> None:
    frames = painted_frames(0, 3, 40)
    same = augmented(frames, Augmentation(0.0, 0.0, 0.0, 0.0, 0.0, False), np.random.default_rng(0))
    np.testing.assert_array_equal(same.images, frames.images)
    np.testing.assert_array_equal(same.instances, frames.instances)


def test_labels_turn_with_the_image() -> None:
    """Painted objects have colours of their own: the colours below each label stay."""
    frames = painted_frames(1, 8, 40)
    turned = augmented(frames, PLAIN, np.random.default_rng(0))
    assert not np.array_equal(turned.instances, frames.instances)
    for before, after, label_before, label_after in zip(
        frames.images, turned.images, frames.instances, turned.instances, strict=True
    ):
        for label in np.unique(label_before):
            one, other = before[label_before == label], after[label_after == label]
            np.testing.assert_array_equal(np.sort(one, axis=0), np.sort(other, axis=0))


def test_changes_are_a_function_of_the_generator_and_leave_the_frames() -> None:
    frames = painted_frames(2, 4, 40)
    copy = frames.images.copy()
    one, same, other = (augmented(frames, Augmentation(), np.random.default_rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(one.images, same.images)
    assert not np.array_equal(one.images, other.images)
    np.testing.assert_array_equal(frames.images, copy)


def test_brightness_is_bounded() -> None:
    frames = painted_frames(3, 16, 40)
    changed = augmented(frames, Augmentation(0.5, 0.0, 0.0, 0.0, 0.0, False), np.random.default_rng(0))
    ratio = changed.images.astype(float).mean(axis=(1, 2, 3)) / frames.images.astype(float).mean(axis=(1, 2, 3))
    assert ratio.min() > 0.6 and ratio.max() < 1.55 and np.ptp(ratio) > 0.2
