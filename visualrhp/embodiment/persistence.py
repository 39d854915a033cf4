"""Objects that a segmenter misses, although the image has not changed where they are.

An object that is in sight does not vanish. Where a segmenter does not find it again, the pixels around it are compared
with those of the image in which it was found last: if they show the same, apart from how bright it is, the object
is still there. One that was taken away, or pushed, leaves other pixels behind.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.segmentation.detection import Detection, Mask
from visualrhp.types import FloatArray

_MARGIN: Final = 6
"""Around an object [pixels], where its border is compared, too."""

_SOFTENING: Final = 1.2
"""Of the compared images [pixels], against noise."""

_IN_SIGHT: Final = 0.5
"""Share of the pixels of an object that have to be in sight, not behind the arm."""

_TAKEN: Final = 0.2
"""Share of its pixels above which another detection is what is there now."""

_SAME_CONTRAST: Final = 0.6
"""Share of the difference of its colour from those around it that has to be left: of an object that is gone, the
border of the target region, say, may be left."""

_SAME_PATTERN: Final = 0.85
"""Correlation of the grey values from which on both images then show the same."""

_SAME_COLOUR: Final = 0.3
"""Mean difference of the colours, over that of the object from what is around it, up to which they do."""


@dataclass(frozen=True, eq=False)
class _Appearance:
    """How an object looked when it was found.

    Attributes:
        detection: of the object.
        window: rows and columns of the image around it.
        colours: [h, w, 3] of the window.
        in_sight: [h, w] what is not behind the arm.
    """

    detection: Detection
    window: tuple[slice, slice]
    colours: FloatArray
    in_sight: Mask


class Persistence:
    """Remembers how objects looked."""

    def __init__(self) -> None:
        self._appearances: dict[int, _Appearance] = {}

    def recall(self, image: npt.NDArray[np.uint8], detections: Iterable[Detection], arm: Mask) -> dict[int, Detection]:
        """The remembered objects that are still there and were not detected, by their ids.

        Args:
            image: [H, W, 3].
            detections: what was detected in it.
            arm: [H, W] the pixels of the arm.
        """
        taken = np.zeros(image.shape[:2], dtype=bool)
        for detection in detections:
            taken |= detection.mask
        recalled = {}
        for number, appearance in self._appearances.items():
            mask = appearance.detection.mask
            size, in_sight = np.count_nonzero(mask), mask & ~arm
            if np.count_nonzero(in_sight) < _IN_SIGHT * size or np.count_nonzero(mask & taken) > _TAKEN * size:
                continue
            if _is_unchanged(appearance, image, arm):
                recalled[number] = replace(appearance.detection, mask=in_sight)
        return recalled

    def remember(
        self, image: npt.NDArray[np.uint8], found: Mapping[int, Detection], arm: Mask, known: Iterable[int]
    ) -> None:
        """Take in how objects look.

        Args:
            image: [H, W, 3].
            found: the objects that were detected in it, by their ids.
            arm: [H, W] the pixels of the arm.
            known: ids of all objects; the others are forgotten.
        """
        kept = set(known)
        self._appearances = {number: each for number, each in self._appearances.items() if number in kept}
        for number, detection in found.items():
            window = _window(detection.mask)
            self._appearances[number] = _Appearance(detection, window, _softened(image[window]), ~arm[window])


def _window(mask: Mask) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(0, int(rows[0]) - _MARGIN), int(rows[-1]) + _MARGIN + 1),
        slice(max(0, int(columns[0]) - _MARGIN), int(columns[-1]) + _MARGIN + 1),
    )


def _softened(colours: npt.NDArray[np.uint8]) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(colours.astype(np.float32), (0, 0), _SOFTENING), np.float64)


def _is_unchanged(appearance: _Appearance, image: npt.NDArray[np.uint8], arm: Mask) -> bool:
    window = appearance.window
    compared = appearance.in_sight & ~arm[window]
    inside = appearance.detection.mask[window]
    within, around = compared & inside, compared & ~inside
    if not within.any() or not around.any():
        return False
    before, after = appearance.colours, _softened(image[window])
    contrast = before[within].mean(axis=0) - before[around].mean(axis=0)
    left = after[within].mean(axis=0) - after[around].mean(axis=0)
    if not float(left @ contrast) > _SAME_CONTRAST * float(contrast @ contrast):
        return False
    if _correlation(before[compared].mean(axis=1), after[compared].mean(axis=1)) >= _SAME_PATTERN:
        return True
    light = np.median(after[around] - before[around], axis=0)
    change = np.linalg.norm(after[within] - before[within] - light, axis=1).mean()
    return bool(change <= _SAME_COLOUR * np.linalg.norm(contrast))


def _correlation(one: FloatArray, other: FloatArray) -> float:
    one, other = one - one.mean(), other - other.mean()
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(one @ other) / size if size > 0.0 else 0.0
