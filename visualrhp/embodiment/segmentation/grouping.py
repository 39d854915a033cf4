"""From the outputs of the segmentation network to objects: cells are grouped around centres, outlines interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.segmentation.classes import FIRST_OBJECT_CLASS
from visualrhp.parameters import Field, Fraction, NonNegative, Positive, parameters

_Floats = npt.NDArray[np.floating]

_COVERED: Final = 0.5
"""Coverage by objects from which a pixel belongs to one."""


@parameters
class GroupingConfig:
    """When cells are an object.

    Attributes:
        least_peak: value of the map of centres from which a peak is a centre.
        peak_distance: side of the window in which a peak is highest [cells].
        merge_distance: distance between the centres that the cells of two peaks vote for, below which they are one
            object [cells].
        most_distance: largest distance from the centre that a cell votes for to the centre that it is given to [cells].
        least_area: area below which an object is too small to be one [cells].
        least_score: score below which an object is dropped.
    """

    least_peak: Fraction = 0.35
    peak_distance: int = Field(default=7, ge=3, le=31)
    merge_distance: Positive = 4.0
    most_distance: Positive = 8.0
    least_area: NonNegative = 6.0
    least_score: Fraction = 0.3


@dataclass(frozen=True, eq=False)
class Instance:
    """An object in the region that the network saw.

    Attributes:
        class_index: its class (:mod:`visualrhp.embodiment.segmentation.classes`).
        mask: [R, R] bool, in pixels of the region.
        score: mean probability of its class, times the height of its centre's peak, to the power 1/2.
    """

    class_index: int
    mask: npt.NDArray[np.bool_]
    score: float


def find_peaks(centres: _Floats, config: GroupingConfig) -> npt.NDArray[np.int64]:
    """[K, 2] cells (x, y) of the peaks of the map of centres [G, G], highest first."""
    centres = _blurred(centres)
    highest = cv2.dilate(centres, np.ones((config.peak_distance, config.peak_distance), np.uint8))
    v, u = np.nonzero((centres >= highest) & (centres >= config.least_peak))
    order = np.argsort(-centres[v, u], kind="stable")
    return np.stack([u[order], v[order]], axis=1).astype(np.int64)


def group(
    probabilities: _Floats, centres: _Floats, offsets: _Floats, size: int, config: GroupingConfig | None = None
) -> list[Instance]:
    """The objects in a region of ``size`` x ``size`` pixels.

    Args:
        probabilities: [C, G, G] of the classes.
        centres: [G, G] map of centres, in [0, 1].
        offsets: [2, G, G] (x, y) from each cell to the centre of its object [cells].
        size: R.
        config: when cells are an object.
    """
    config = config or GroupingConfig()
    covered = probabilities[FIRST_OBJECT_CLASS:].sum(axis=0)
    v, u = np.nonzero(covered > 0.5 * _COVERED)
    peaks = find_peaks(centres, config)
    if len(u) == 0 or len(peaks) == 0:
        return []
    votes = np.stack([u + offsets[0, v, u], v + offsets[1, v, u]], axis=1)
    distances = np.linalg.norm(votes[:, None] - peaks[None], axis=2)
    owner = distances.argmin(axis=1)
    owner[distances.min(axis=1) > config.most_distance] = -1
    owner = _merged(owner, votes, len(peaks), config.merge_distance)
    surface = _enlarged(covered, size)
    best = np.zeros((size, size), np.float32)
    label = np.full((size, size), -1, np.int64)
    found: list[tuple[int, float]] = []
    for number, (x, y) in enumerate(peaks):
        mine = owner == number
        weights = covered[v[mine], u[mine]]
        if weights.sum() < config.least_area:
            continue
        votes_of_classes = (probabilities[FIRST_OBJECT_CLASS:, v[mine], u[mine]]).sum(axis=1)
        class_index = int(votes_of_classes.argmax())
        certainty = float(votes_of_classes[class_index] / votes_of_classes.sum() * min(1.0, weights.mean() + 0.1))
        score = float(np.sqrt(certainty * min(1.0, float(centres[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].max()))))
        if score < config.least_score:
            continue
        indicator = np.zeros(covered.shape, np.float32)
        indicator[v[mine], u[mine]] = 1.0
        claim = _enlarged(_blurred(indicator), size)
        is_mine = claim > best
        best[is_mine] = claim[is_mine]
        label[is_mine] = len(found)
        found.append((FIRST_OBJECT_CLASS + class_index, score))
    is_object = surface > _COVERED
    instances = [Instance(index, is_object & (label == number), score) for number, (index, score) in enumerate(found)]
    return [instance for instance in instances if instance.mask.any()]


def _merged(owner: npt.NDArray[np.int64], votes: _Floats, num_peaks: int, distance: float) -> npt.NDArray[np.int64]:
    """``owner`` without those whose cells vote, in the median, for the same centre as those of a higher peak.

    A long object may have several peaks along its axis, but its cells vote for one centre.
    """
    centre_of: dict[int, _Floats] = {}
    for number in range(num_peaks):
        mine = owner == number
        if not mine.any():
            continue
        centre = np.median(votes[mine], axis=0)
        same = [other for other, found in centre_of.items() if np.hypot(*(found - centre)) < distance]
        if same:
            owner = np.where(mine, same[0], owner)
        else:
            centre_of[number] = centre
    return owner


def _enlarged(cells: _Floats, size: int) -> npt.NDArray[np.float32]:
    enlarged = cv2.resize(np.asarray(cells, np.float32), (size, size), interpolation=cv2.INTER_LINEAR)
    return np.asarray(enlarged, np.float32)


def _blurred(cells: _Floats) -> npt.NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(np.asarray(cells, np.float32), (3, 3), 0.8), np.float32)
