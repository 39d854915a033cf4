"""Mirror images of a frame are looked at, too: the mean of the answers is closer to the truth than one of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

Maps = tuple[npt.NDArray[np.floating], npt.NDArray[np.floating], npt.NDArray[np.floating]]
"""[C, G, G] probabilities of the classes; [G, G] map of centres; [2, G, G] offsets (x, y) to the centres [cells]."""

_ROWS, _COLUMNS = -2, -1
_MIRRORS: Final[tuple[tuple[int, ...], ...]] = ((), (_COLUMNS,), (_ROWS,), (_ROWS, _COLUMNS))
"""Axes of the maps along which they are mirrored."""


def mean_over_mirrors(answer: Callable[[npt.NDArray[np.uint8]], Maps], image: npt.NDArray[np.uint8]) -> Maps:
    """The mean of a network's answers to an image and its mirror images, each mirrored back.

    Args:
        answer: the network, from [S, S, 3] to its maps.
        image: [S, S, 3].
    """
    answers = [_mirrored(answer(np.ascontiguousarray(np.flip(image, _of_image(axes)))), axes) for axes in _MIRRORS]
    probabilities, centres, offsets = (np.mean(maps, axis=0) for maps in zip(*answers, strict=True))
    return probabilities, centres, offsets


def _of_image(axes: tuple[int, ...]) -> tuple[int, ...]:
    """The axes of an image, whose last one is its colours."""
    return tuple(axis - 1 for axis in axes)


def _mirrored(maps: Maps, axes: tuple[int, ...]) -> Maps:
    probabilities, centres, offsets = (np.flip(each, axes) for each in maps)
    signs = np.array([-1.0 if axis in axes else 1.0 for axis in (_COLUMNS, _ROWS)], offsets.dtype)
    return probabilities, centres, offsets * signs[:, None, None]
