"""Labelled frames: what our segmentation network learns from, as plain arrays in npz files.

A frame is the part of an image that shows the table, a square, shrunk to the size of the network's input:

=========  ======  ============  =====================================================================
array      dtype   shape         content
=========  ======  ============  =====================================================================
images     uint8   [N, S, S, 3]  RGB
instances  uint8   [N, S, S]     0 background, 1 the robot, 2 + i object i
classes    uint8   [N, M]        class of object i (:mod:`visualrhp.embodiment.segmentation.classes`);
                                 0: there is no such object, or it is not on the table
=========  ======  ============  =====================================================================

The label of a pixel is that of a point in it that is drawn at random, so that the mean of labels is the coverage.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.documents import FileKind
from visualrhp.embodiment.segmentation.classes import BACKGROUND, NUM_CLASSES, ROBOT
from visualrhp.errors import DataError
from visualrhp.files import atomic_path

ByteArray = npt.NDArray[np.uint8]

INPUT_SIZE: Final = 240
"""Side of the network's input [pixels]: half of the height of a VGA image, whose 2 x 2 pixels are averaged exactly."""

MAX_OBJECTS: Final = 16
"""M: the most objects of a frame."""

FIRST_INSTANCE: Final = 2
"""The label of object 0 in ``instances``."""

FRAMES: Final = FileKind("labelled frames (an npz file)", "generate them again: python -m pipelines.generate_frames")


@dataclass(frozen=True)
class Region:
    """A square part of an image.

    Attributes:
        x, y: its first column and row [pixels].
        size: its side [pixels].
    """

    x: int
    y: int
    size: int

    @classmethod
    def centred(cls, height: int, width: int) -> Region:
        """The largest square in the middle of an image."""
        size = min(height, width)
        return cls((width - size) // 2, (height - size) // 2, size)

    def of(self, image: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        """The part of ``image``, [H, W] or [H, W, C]."""
        return image[self.y : self.y + self.size, self.x : self.x + self.size]


def network_input(image: ByteArray, region: Region, size: int = INPUT_SIZE) -> ByteArray:
    """[size, size, 3] the part ``region`` of ``image`` [H, W, 3], averaged over areas."""
    part = np.ascontiguousarray(region.of(image), dtype=np.uint8)
    return np.asarray(cv2.resize(part, (size, size), interpolation=cv2.INTER_AREA), np.uint8)


@dataclass(frozen=True)
class LabelledFrames:
    """N frames; the arrays are described in the module.

    Raises:
        ValueError: shapes, types or labels do not match.
    """

    images: ByteArray
    instances: ByteArray
    classes: ByteArray

    def __post_init__(self) -> None:
        count, side = self.images.shape[0], self.images.shape[1] if self.images.ndim == 4 else 0
        expected = {
            "images": (count, side, side, 3),
            "instances": (count, side, side),
            "classes": (count, MAX_OBJECTS),
        }
        for name, shape in expected.items():
            array = getattr(self, name)
            if array.dtype != np.uint8 or array.shape != shape:
                raise ValueError(f"{name} is {array.dtype} of shape {list(array.shape)}, not uint8 of {list(shape)}")
        if (self.classes >= NUM_CLASSES).any() or (self.classes == ROBOT).any():
            raise ValueError(f"classes should be 0, or classes of objects, 2 to {NUM_CLASSES - 1}")
        if count and int(self.instances.max()) >= FIRST_INSTANCE + MAX_OBJECTS:
            raise ValueError(f"instances should be below {FIRST_INSTANCE + MAX_OBJECTS}")

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, rows: slice | npt.NDArray[np.integer]) -> LabelledFrames:
        return LabelledFrames(self.images[rows], self.instances[rows], self.classes[rows])

    def labels(self) -> ByteArray:
        """[N, S, S] class of each pixel."""
        first = np.broadcast_to(np.array([BACKGROUND, ROBOT], np.uint8), (len(self), FIRST_INSTANCE))
        table = np.concatenate([first, self.classes], axis=1)
        return np.stack([row[frame] for row, frame in zip(table, self.instances, strict=True)])


def labelled_frame(
    image: ByteArray,
    instances: ByteArray,
    classes: Sequence[int],
    region: Region,
    generator: np.random.Generator,
    size: int = INPUT_SIZE,
) -> LabelledFrames:
    """One frame from an image and the label of each of its pixels.

    Args:
        image: [H, W, 3] uint8, RGB.
        instances: [H, W] labels as in the module.
        classes: of objects 0, 1, ...; 0 for one that is not on the table, which becomes background.
        region: the part that shows the table; its side is a multiple of ``size`` or not: labels are sampled.
        generator: draws the point of each pixel.
        size: S.

    Raises:
        ValueError: there are more than :data:`MAX_OBJECTS` objects.
    """
    if len(classes) > MAX_OBJECTS:
        raise ValueError(f"a frame has {len(classes)} objects; at most {MAX_OBJECTS} are labelled")
    row = np.zeros(MAX_OBJECTS, np.uint8)
    row[: len(classes)] = classes
    points = generator.random((2, size, size)) + np.mgrid[:size, :size]
    v, u = np.minimum((points * (region.size / size)).astype(np.int64), region.size - 1)
    sampled = region.of(instances)[v, u].astype(np.uint8)
    table = np.concatenate([[0, 1], np.where(row > 0, np.arange(MAX_OBJECTS) + FIRST_INSTANCE, 0)]).astype(np.uint8)
    return LabelledFrames(network_input(image, region, size)[None], table[sampled][None], row[None])


def join(parts: Iterable[LabelledFrames]) -> LabelledFrames:
    """All frames of ``parts``, in order."""
    parts = list(parts)
    return LabelledFrames(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("images", "instances", "classes"))
    )


def write_frames(path: Path, frames: LabelledFrames) -> None:
    """Write frames to a compressed npz file, atomically; equal frames give equal bytes."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file, allow_pickle=False, images=frames.images, instances=frames.instances, classes=frames.classes
        )


def read_frames(path: Path) -> LabelledFrames:
    """Read frames.

    Raises:
        DataError: the file is missing or damaged, or does not hold frames.
    """
    FRAMES.require(path)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return LabelledFrames(arrays["images"], arrays["instances"], arrays["classes"])
    except DataError:
        raise
    except Exception as error:  # zipfile and NumPy raise almost anything for bytes that they did not write
        raise FRAMES.damaged(path, f"it cannot be read as labelled frames ({error})") from error
