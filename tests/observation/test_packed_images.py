"""Packed label images: every pixel comes back, in little memory."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.observation import packed_images
from visualrhp.observation.label_image import IMAGE_SIZE, label_image
from visualrhp.observation.packed_images import PackedImages
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.streams import Split

SHAPE = (IMAGE_SIZE, IMAGE_SIZE)


@pytest.mark.parametrize("chunk", [1, 3, 4096])
def test_every_pixel_comes_back_in_any_order(monkeypatch: pytest.MonkeyPatch, chunk: int) -> None:
    monkeypatch.setattr(packed_images, "CHUNK", chunk)
    rng = np.random.default_rng(0)
    checkered = np.indices(SHAPE).sum(axis=0).astype(np.uint8) % 2
    plain = [np.full(SHAPE, label, np.uint8) for label in (0, 0, 5)]  # equal labels on both sides of a border
    images = [*plain, rng.integers(0, 6, SHAPE, dtype=np.uint8), checkered]
    runs = PackedImages.pack(iter(images))
    assert len(runs) == 5
    for rows in ([0, 1, 2, 3, 4], [4, 4, 0], [3], [-1, 1], []):
        expected = np.array([images[row] for row in rows], dtype=np.uint8).reshape(-1, *SHAPE)
        unpacked = runs[rows]
        assert unpacked.dtype == np.uint8
        np.testing.assert_array_equal(unpacked, expected)
    with pytest.raises(IndexError):
        runs[[5]]


def test_an_empty_stack_is_empty() -> None:
    runs = PackedImages.pack([])
    assert len(runs) == 0
    assert runs[[]].shape == (0, *SHAPE)


def test_images_of_scenes_are_small() -> None:
    """A million images, even of the densest scenes, leave room for a training within 2 GB."""
    tasks = [sample_task_instance(SceneDistribution(num_objects=(7, 7)), 0, Split.EVALUATION, i) for i in range(40)]
    runs = PackedImages.pack(label_image(task.scene, task.state) for task in tasks)
    assert runs.nbytes / len(runs) < 1000
