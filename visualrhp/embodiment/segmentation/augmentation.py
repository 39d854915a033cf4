"""Random changes of frames in a training: mirror images, turns, light, colour, blur and noise."""

from __future__ import annotations

import cv2
import numpy as np

from visualrhp.embodiment.segmentation.configs import Augmentation
from visualrhp.embodiment.segmentation.frames import ByteArray, LabelledFrames


def augmented(frames: LabelledFrames, augmentation: Augmentation, generator: np.random.Generator) -> LabelledFrames:
    """Changed copies of ``frames``."""
    images, instances = [], []
    for image, labels in zip(frames.images, frames.instances, strict=True):
        if augmentation.turn:
            turns, is_mirrored = int(generator.integers(4)), bool(generator.integers(2))
            image, labels = np.rot90(image, turns), np.rot90(labels, turns)
            if is_mirrored:
                image, labels = image[:, ::-1], labels[:, ::-1]
        images.append(_recoloured(np.ascontiguousarray(image), augmentation, generator))
        instances.append(labels)
    return LabelledFrames(np.stack(images), np.stack(instances), frames.classes)


def _recoloured(image: ByteArray, augmentation: Augmentation, generator: np.random.Generator) -> ByteArray:
    factor = _factor(augmentation.brightness, generator)
    exponent = _factor(augmentation.contrast, generator)
    colours = [factor * _factor(augmentation.colour, generator) for _ in range(3)]
    grey = (np.arange(256, dtype=np.float32) / 255.0) ** exponent * 255.0
    # One table a channel: a value of a byte has one result.
    table = np.stack([np.clip(grey * colour, 0.0, 255.0) for colour in colours], axis=-1).astype(np.uint8)
    image = np.asarray(cv2.LUT(image, table[None]), np.uint8)
    if generator.random() < augmentation.blur:
        image = np.asarray(cv2.GaussianBlur(image, (5, 5), float(generator.uniform(0.3, 1.0))), np.uint8)
    spread = float(generator.uniform(0.0, augmentation.noise))
    # Integers are enough for noise, and several times as fast to draw as floats.
    noise = (generator.standard_normal(image.shape, dtype=np.float32) * spread).astype(np.int16)
    return np.clip(image.astype(np.int16) + noise, 0, 255).astype(np.uint8)


def _factor(size: float, generator: np.random.Generator) -> float:
    """A factor in [1 / (1 + size), 1 + size]; its logarithm is uniform."""
    return float(np.exp(generator.uniform(-1.0, 1.0) * np.log1p(size)))
