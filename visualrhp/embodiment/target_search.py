"""Find the printed target disc by template matching (paper, Sec. 5.1).

The image is rectified to the plane of the table, and a template of the disc is compared with every place. The template
has regions of one colour each: the parts of the print, and the surface around it. The score is the share of the
variance in a window, over all channels, that is between the regions (the coefficient of determination): neither
brightness nor which region is darker have to be known. If the colour of the print is, places of another colour count
less. Pixels of objects and of the arm, which cover parts of the disc, are left out, and places of which more is seen
are preferred.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Annotated, Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.segmentation.detection import Mask
from visualrhp.errors import PerceptionError
from visualrhp.parameters import AsTuple, Fraction, Positive, parameters
from visualrhp.types import FloatArray

NEAR: Final = 0.01
"""Distance [m] within which a disc that was found is looked for again."""

_MARGIN: Final = 0.3
"""Width of the surroundings in the template, relative to the radius of the disc."""

_LEAST_CONTRAST: Final = 3.0
"""Difference between disc and surface [grey values] below which nothing is a disc: less is noise."""

_PREFERENCE: Final = 0.25
"""Exponent of the visible share in the order of places: a small part of a disc is often like something else."""

_LEAST_HUE: Final = 0.1

_SATURATION: Final = 0.3
"""Colour over grey, relative to that of the print, below which a place counts less: a grey may have a tinge of its hue.
"""

_LEAST_PART: Final = 0.15
"""Share of the print and of its surroundings that has to be seen."""

_COVER_MARGIN: Final = 7  # [px], odd: borders of masks are inexact, and objects cast shadows


@parameters
class TargetSearch:
    """How the disc is found.

    Attributes:
        radius: of the disc [m] (Sec. 9: 7 cm).
        inner: radii within it at which its colour changes [m], such as the inner border of a ring; none for a disc of
            one colour.
        colour: of the innermost part, red, green and blue in [0, 1]; null if it is not known. Only its hue counts.
        resolution: of the rectified image [m/px].
        least_score: share of the variance that the disc has to explain.
        least_visible: share of the template that has to be seen.
    """

    radius: Positive = 0.07
    inner: Annotated[tuple[Positive, ...], AsTuple] = (0.058,)
    colour: Annotated[tuple[Fraction, Fraction, Fraction], AsTuple] | None = (0.10, 0.62, 0.38)
    resolution: Positive = 2.5e-3
    least_score: Fraction = 0.4
    least_visible: Fraction = 0.2

    def __post_init__(self) -> None:
        if any(radius >= self.radius for radius in self.inner):
            raise ValueError(f"inner={list(self.inner)} should be smaller than radius={self.radius}.")
        if self.colour is not None and max(self.colour) - min(self.colour) < _LEAST_HUE:
            raise ValueError(f"colour={list(self.colour)} is grey, without a hue: use null.")


@dataclass(frozen=True)
class FoundTarget:
    """Where the disc is.

    Attributes:
        position: [2] of its centre [m], world frame.
        score: share of the variance that it explains.
        visible: share of the template that is seen.
    """

    position: FloatArray
    score: float
    visible: float


def find_target(
    image: npt.NDArray[np.uint8],
    camera: Camera,
    edges: FloatArray,
    covered: Mask | None = None,
    search: TargetSearch | None = None,
    near: FloatArray | None = None,
) -> FoundTarget:
    """Find the disc in an image.

    Args:
        image: [H, W, 3] of the camera.
        camera: that took it.
        edges: [E, 2] of the surface [m], world frame; the centre of the disc lies within.
        covered: [H, W] pixels of objects and of the arm; None for none.
        search: how it is found.
        near: [2] where it was found before [m]: only places within :data:`NEAR` are compared, which is fast.

    Raises:
        PerceptionError: nothing in the image is like the disc.
    """
    search = search or TargetSearch()
    scale = 1.0 / search.resolution
    pad = search.radius * (1.0 + _MARGIN)
    start, end = (edges.min(axis=0), edges.max(axis=0)) if near is None else (near - NEAR, near + NEAR)
    low = start - pad
    size = np.ceil((end + pad - low) * scale).astype(int) + 1
    rectified, weights = _rectified(image, covered, camera, low, search.resolution, size)
    # Surface and surroundings differ; beyond the edges, nothing is known.
    inside = np.zeros(weights.shape, dtype=np.uint8)
    cv2.fillPoly(inside, [np.round((edges - low) * scale * 16).astype(np.int32)], 1, shift=4)
    weights *= inside
    score, visible, is_seen = _scores(rectified, weights, search)
    if not np.isfinite(score).any():
        why = "nothing in the image differs from the surface" if is_seen else "objects and arm cover the surface"
        raise PerceptionError(f"the target disc is not found: {why}")
    best = int(np.argmax(np.where(np.isfinite(score), score * visible**_PREFERENCE, -np.inf)))
    row, column = divmod(best, score.shape[1])
    found = float(score[row, column])
    if found < search.least_score:
        raise PerceptionError(
            f"the target disc is not found: the best place explains {100 * found:.0f}% of the image's variance, and "
            f"{100 * search.least_score:.0f}% are needed; a disc of {search.radius} m should be printed on the surface"
        )
    half = (_regions(search)[0].shape[0] - 1) / 2.0
    centre = np.array([column + _vertex(score[row], column), row + _vertex(score[:, column], row)]) + half
    return FoundTarget(low + centre * search.resolution, found, float(visible[row, column]))


def _rectified(
    image: npt.NDArray[np.uint8],
    covered: Mask | None,
    camera: Camera,
    low: FloatArray,
    resolution: float,
    size: npt.NDArray[np.int_],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """The image [R, C, 3] in the plane of the table, rows in the direction of y, and the weights [R, C] of its pixels:
    0 where it is covered or was not seen."""
    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    places = low + resolution * np.stack([columns, rows], axis=-1).reshape(-1, 2)
    pixels = camera.project(np.column_stack([places, np.zeros(len(places))])).astype(np.float32)
    map_x, map_y = pixels.T.reshape(2, size[1], size[0])
    # A pixel of the camera may be finer than one of the result: without smoothing, it would be noisier.
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    straight = cv2.remap(smooth, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    is_known = np.ones(image.shape[:2], dtype=np.uint8)
    if covered is not None:
        grown = cv2.dilate(covered.astype(np.uint8), np.ones((_COVER_MARGIN, _COVER_MARGIN), np.uint8))
        is_known = (1 - grown).astype(np.uint8)
    seen = cv2.remap(is_known, map_x, map_y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=(0.0,))
    return straight.astype(np.float32), seen.astype(np.float32)


def _regions(search: TargetSearch) -> list[npt.NDArray[np.float32]]:
    """[T, T] the pixels of each region of the template: the parts of the print from the inside on, then its
    surroundings."""
    half = math.ceil(search.radius * (1.0 + _MARGIN) / search.resolution)
    axis = np.arange(-half, half + 1) * search.resolution
    distance = np.hypot(axis[:, None], axis[None, :])
    borders = [0.0, *sorted(search.inner), search.radius, search.radius * (1.0 + _MARGIN)]
    return [((distance >= low) & (distance < high)).astype(np.float32) for low, high in itertools.pairwise(borders)]


def _scores(
    image: npt.NDArray[np.float32], weights: npt.NDArray[np.float32], search: TargetSearch
) -> tuple[FloatArray, FloatArray, bool]:
    """The coefficient of determination at every place of the template (NaN where too little is seen or nothing
    differs), the share of the template that is seen, and whether enough is seen anywhere."""
    regions = _regions(search)

    def total(values: npt.NDArray[np.float32], kernel: npt.NDArray[np.float32]) -> FloatArray:
        return cv2.matchTemplate(values, kernel, cv2.TM_CCORR).astype(np.float64)

    counts = [np.maximum(total(weights, region), 1e-3) for region in regions]
    count = sum(counts[1:], start=counts[0])
    between, overall = np.zeros_like(count), np.zeros_like(count)
    window = np.asarray(sum(regions), dtype=np.float32)
    means: list[FloatArray] = []
    for channel in range(image.shape[2]):
        middle = image[..., channel].mean()
        values = np.asarray(image[..., channel] - middle, dtype=np.float32)
        weighted = values * weights
        sums = [total(weighted, region) for region in regions]
        mean = sum(sums[1:], start=sums[0]) / count
        for part, number in zip(sums, counts, strict=True):
            between += number * (part / number - mean) ** 2
        overall += total(weighted * values, window) - count * mean**2
        means.append(float(middle) + sums[0] / counts[0])
    visible = count / float(window.sum())
    # Print and surroundings have to be seen: one of them alone shows no contrast.
    printed = (count - counts[-1]) / float(sum(region.sum() for region in regions[:-1]))
    around = counts[-1] / float(regions[-1].sum())
    is_seen = np.minimum(printed, around) >= _LEAST_PART
    is_seen &= visible >= search.least_visible
    is_candidate = is_seen & (np.sqrt(between / count) > _LEAST_CONTRAST)
    score = between / np.maximum(overall, 1e-6 * count)
    if search.colour is not None:
        score *= _likeness(means, search.colour)
    return np.where(is_candidate, score, np.nan), visible, bool(is_seen.any())


def _likeness(means: list[FloatArray], colour: tuple[float, float, float]) -> FloatArray:
    """How much the colour of the innermost part is that of the print, in [0, 1]: the cosine of the angle between the
    colours without their grey; less for one that is much closer to grey than the print."""
    grey = (means[0] + means[1] + means[2]) / 3.0
    wanted = np.array(colour) - np.mean(colour)
    least = _SATURATION * np.linalg.norm(wanted) / np.mean(colour)
    wanted /= np.linalg.norm(wanted)
    along = sum((mean - grey) * part for mean, part in zip(means, wanted.tolist(), strict=True))
    length = np.sqrt(sum((mean - grey) ** 2 for mean in means))
    # A square root, since a light with a colour of its own turns the hue.
    hue = np.sqrt(np.clip(along / np.maximum(length, 1.0), 0.0, 1.0))
    return hue * np.clip(length / np.maximum(least * grey, 1.0), 0.0, 1.0)


def _vertex(values: FloatArray, index: int) -> float:
    """Where, relative to ``index``, the parabola through three values is largest; within half a pixel."""
    if not 0 < index < len(values) - 1:
        return 0.0
    before, at, after = values[index - 1 : index + 2].tolist()
    bend = before - 2.0 * at + after
    if not (math.isfinite(bend) and bend < 0.0):
        return 0.0
    return min(max(0.5 * (before - after) / bend, -0.5), 0.5)
