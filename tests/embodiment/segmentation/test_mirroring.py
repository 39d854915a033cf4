"""What a network sees in mirror images, mirrored back."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.embodiment.segmentation.mirroring import Maps, mean_over_mirrors

SIDE = 6


def seen(image: np.ndarray) -> Maps:
    """The probability is the red channel; the centre is the brightest pixel; offsets point to it."""
    red = image[..., 0].astype(np.float32)
    row, column = np.unravel_index(red.argmax(), red.shape)
    v, u = np.mgrid[:SIDE, :SIDE].astype(np.float32)
    return red[None] / 255.0, (red == red.max()).astype(np.float32), np.stack([column - u, row - v])


def biased(image: np.ndarray) -> Maps:
    """It finds everything a cell too far to the right, and answers more to what is above."""
    probabilities, centres, offsets = seen(image)
    return probabilities * np.linspace(1.0, 0.5, SIDE)[:, None], centres, offsets + np.array([1.0, 0.0])[:, None, None]


@pytest.fixture
def image() -> np.ndarray:
    return np.random.default_rng(0).permutation(SIDE * SIDE * 3).reshape(SIDE, SIDE, 3).astype(np.uint8)


def test_a_network_that_knows_no_direction_answers_as_before(image: np.ndarray) -> None:
    for mean, maps in zip(mean_over_mirrors(seen, image), seen(image), strict=True):
        np.testing.assert_allclose(mean, maps, atol=1e-6)


def test_a_preference_for_a_side_averages_out(image: np.ndarray) -> None:
    probabilities, centres, offsets = mean_over_mirrors(biased, image)
    np.testing.assert_allclose(probabilities, 0.75 * seen(image)[0], atol=1e-6)
    np.testing.assert_allclose(centres, seen(image)[1])
    np.testing.assert_allclose(offsets, seen(image)[2], atol=1e-6)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_mirror_image_has_mirrored_maps(image: np.ndarray, axis: int) -> None:
    probabilities, centres, offsets = mean_over_mirrors(biased, image)
    mirrored = mean_over_mirrors(biased, np.ascontiguousarray(np.flip(image, axis)))
    np.testing.assert_allclose(mirrored[0], np.flip(probabilities, axis + 1), atol=1e-6)
    np.testing.assert_allclose(mirrored[1], np.flip(centres, axis), atol=1e-6)
    signs = np.array([-1.0, 1.0] if axis == 1 else [1.0, -1.0])[:, None, None]
    np.testing.assert_allclose(mirrored[2], np.flip(offsets, axis + 1) * signs, atol=1e-6)
