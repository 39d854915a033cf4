"""What a segmentation of an image is, and the protocol of whatever makes one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.kinds import Kind

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Detection:
    """An object in an image.

    Attributes:
        kind: what it is.
        is_lying: whether it lies on its side; False for kinds that have none.
        mask: [H, W] the pixels in which it is seen.
        score: confidence, in [0, 1].
    """

    kind: Kind
    is_lying: bool
    mask: Mask
    score: float = 1.0


class Segmenter(Protocol):
    """Finds the objects in an image."""

    def segment(self, image: npt.NDArray[np.uint8]) -> list[Detection]:
        """The objects in ``image``, [H, W, 3] uint8, RGB; masks have its size, and may overlap a little."""
        ...


LONG: Final = 2.2
"""Elongation of a silhouette above which a bottle or a cup lies on its side, whatever its direction. A standing bottle
of 7 x 20 cm, 25 cm from the point below a camera at 1.4 m, has 1.6; a lying one about 3."""

SLIGHTLY_LONG: Final = 1.35
"""Elongation above which it lies on its side if it does not point to the point below the camera."""

_MOST_ANGLE: Final = math.radians(25.0)


def seems_lying(kind: Kind, mask: Mask, nadir: tuple[float, float] | None = None) -> bool:
    """Whether a bottle or a cup lies on its side, for segmenters whose classes do not tell.

    A standing one is seen as a round silhouette that perspective lengthens away from the point below the camera; a
    lying one is long in any direction.

    Args:
        kind: what it is; apples, oranges and boxes do not lie.
        mask: [H, W] its pixels.
        nadir: pixel (column, row) that shows the point below the camera; None for the centre of the image.
    """
    if kind not in (Kind.BOTTLE, Kind.CUP):
        return False
    moments = cv2.moments(mask.astype(np.uint8), binaryImage=True)
    if moments["m00"] <= 0.0:
        return False
    covariance = np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]) / moments["m00"]
    variances, axes = np.linalg.eigh(covariance)
    elongation = math.sqrt(variances[1] / max(variances[0], 1e-9))
    if elongation < SLIGHTLY_LONG or elongation > LONG:
        return elongation > LONG
    height, width = mask.shape
    centre = nadir or (0.5 * (width - 1), 0.5 * (height - 1))
    outwards = np.array([moments["m10"], moments["m01"]]) / moments["m00"] - centre
    distance = float(np.hypot(*outwards))
    return distance < 1.0 or abs(float(axes[:, 1] @ outwards)) < math.cos(_MOST_ANGLE) * distance
