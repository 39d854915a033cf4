"""Frames painted from discs and boxes: what the tests of the segmentation network learn from, instead of a cell."""

from __future__ import annotations

import cv2
import numpy as np

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation.classes import class_of
from visualrhp.embodiment.segmentation.frames import LabelledFrames, Region, join, labelled_frame

PAINTED = {
    Kind.APPLE: (200, 30, 30),
    Kind.ORANGE: (240, 150, 20),
    Kind.BOX: (60, 90, 200),
}
HEIGHT, WIDTH = 240, 320


def painted_image(generator: np.random.Generator, num_objects: int) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """An image, the label of each pixel, and the classes: coloured discs and boxes that do not overlap, on grey."""
    image = np.full((HEIGHT, WIDTH, 3), generator.integers(90, 130), np.uint8)
    instances = np.zeros((HEIGHT, WIDTH), np.uint8)
    classes: list[int] = []
    while len(classes) < num_objects:
        kind = list(PAINTED)[generator.integers(len(PAINTED))]
        shape = np.zeros((HEIGHT, WIDTH), np.uint8)
        centre = (float(generator.uniform(70, 250)), float(generator.uniform(30, 210)))
        radius = float(generator.uniform(14, 22))
        if kind is Kind.BOX:
            corners = cv2.boxPoints((centre, (2 * radius, 1.5 * radius), float(generator.uniform(0, 180))))
            cv2.fillPoly(shape, [corners.round().astype(np.int32)], 1)
        else:
            cv2.circle(shape, (round(centre[0]), round(centre[1])), round(radius), 1, -1)
        if (instances[shape > 0] > 0).any():
            continue
        image[shape > 0] = PAINTED[kind]
        instances[shape > 0] = 2 + len(classes)
        classes.append(class_of(kind, False))
    image = np.clip(image + generator.normal(0.0, 4.0, image.shape), 0, 255).astype(np.uint8)
    return image, instances, classes


def painted_frames(seed: int, count: int, size: int = 120) -> LabelledFrames:
    """``count`` frames of 1 to 4 objects."""
    generator = np.random.default_rng(seed)
    parts = []
    for _ in range(count):
        image, instances, classes = painted_image(generator, int(generator.integers(1, 5)))
        region = Region.centred(HEIGHT, WIDTH)
        parts.append(labelled_frame(image, instances, classes, region, generator, size))
    return join(parts)
