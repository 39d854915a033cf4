"""Pictures of detections in a camera's image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation.detection import Detection
from visualrhp.embodiment.segmentation.scores import SeenObject, matches

COLOURS: Final = {
    Kind.BOTTLE: (0, 220, 255),
    Kind.APPLE: (90, 255, 90),
    Kind.ORANGE: (255, 170, 0),
    Kind.CUP: (255, 90, 255),
    Kind.BOX: (255, 255, 80),
}
"""RGB of the outlines."""


def overlay(
    image: npt.NDArray[np.uint8], detections: Sequence[Detection], objects: Sequence[SeenObject] = ()
) -> npt.NDArray[np.uint8]:
    """[H, W, 3] ``image`` with outlines and kinds of detections.

    Args:
        image: [H, W, 3] RGB.
        detections: in it.
        objects: that are there; those that must be found and are not are hatched in red.
    """
    picture = image.copy()
    found = matches(detections, objects)
    for number, seen in enumerate(objects):
        if seen.is_required and number not in found:
            rows, columns = np.nonzero(seen.mask)
            hatched = (rows + columns) % 4 == 0
            picture[rows[hatched], columns[hatched]] = (255, 0, 0)
    for detection in detections:
        colour = COLOURS[detection.kind]
        contours, _ = cv2.findContours(detection.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, contours, -1, colour, 1)
        rows, columns = np.nonzero(detection.mask)
        text = f"{detection.kind}{' lying' if detection.is_lying else ''} {detection.score:.2f}"
        place = (int(columns.min()), max(10, int(rows.min()) - 3))
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, 1, cv2.LINE_AA)
    return picture
