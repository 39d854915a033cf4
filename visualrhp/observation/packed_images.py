"""Run-length encoding of label images.

A label image (Sec. 5.1) is mostly empty surface. Encoded row by row, it takes about an eighth of its 4096 bytes, and
decoding takes 3 us: a million images fit in well under a gigabyte, and a batch is decoded when it is used.
"""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from visualrhp.observation.label_image import IMAGE_SIZE
from visualrhp.types import IntArray, LabelImage

_PIXELS = IMAGE_SIZE * IMAGE_SIZE
CHUNK = 4096
"""Number of images that are packed at once."""


class PackedImages:
    """T run-length encoded label images.

    Attributes:
        ends: [R] uint16, last pixel of each run of equal labels within its image; an image's last run ends with 4095.
        labels: [R] uint8, label of each run.
        offsets: [T + 1] int64, index of the first run of each image.
    """

    def __init__(self, ends: npt.NDArray[np.uint16], labels: npt.NDArray[np.uint8], offsets: IntArray) -> None:
        self.ends = ends
        self.labels = labels
        self.offsets = offsets

    @classmethod
    def pack(cls, images: Iterable[LabelImage]) -> PackedImages:
        """Pack ``images``, each [64, 64] uint8; only a few of them are in memory at a time."""
        # These grow in place; joining a list of pieces would take twice the memory.
        ends, labels, counts = array("H"), array("B"), array("q", [0])
        images = iter(images)
        while chunk := list(itertools.islice(images, CHUNK)):
            _pack(np.stack(chunk), ends, labels, counts)
        return cls(np.frombuffer(ends, np.uint16), np.frombuffer(labels, np.uint8), np.cumsum(counts))

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @property
    def nbytes(self) -> int:
        """Memory of the images [bytes]."""
        return self.ends.nbytes + self.labels.nbytes + self.offsets.nbytes

    def __getitem__(self, rows: npt.ArrayLike) -> npt.NDArray[np.uint8]:
        """Unpack the images with these indices: [B] -> [B, 64, 64] uint8.

        Raises:
            IndexError: an index is out of range.
        """
        rows = np.asarray(rows, dtype=np.int64)
        starts, stops = self.offsets[:-1][rows], self.offsets[1:][rows]
        counts = stops - starts
        first = np.cumsum(counts) - counts
        runs = np.repeat(starts - first, counts) + np.arange(counts.sum())
        # Pixels are numbered consecutively over the batch, so that each run begins at the end of the previous one.
        image = np.repeat(np.arange(len(rows), dtype=np.int64), counts)
        lengths = np.diff(self.ends[runs] + _PIXELS * image, prepend=-1)
        return np.repeat(self.labels[runs], lengths).reshape(len(rows), IMAGE_SIZE, IMAGE_SIZE)


def _pack(images: npt.NDArray[np.uint8], ends: array[int], labels: array[int], counts: array[int]) -> None:
    pixels = images.reshape(len(images), _PIXELS)
    is_end = np.ones(pixels.shape, dtype=np.bool_)
    is_end[:, :-1] = pixels[:, :-1] != pixels[:, 1:]
    ends.frombytes(np.nonzero(is_end)[1].astype(np.uint16).tobytes())
    labels.frombytes(pixels[is_end].tobytes())
    counts.frombytes(is_end.sum(axis=1, dtype=np.int64).tobytes())
