"""How good a segmentation is, against the truth of the simulated cell: objects found and invented, kinds, outlines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import shapely
from scipy.optimize import linear_sum_assignment

from visualrhp.documents import conform, document
from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.outlines import silhouette
from visualrhp.embodiment.segmentation.detection import Detection, Mask
from visualrhp.types import Metrics

MATCH: Final = 0.5
"""Intersection over union of the masks from which a detection is of an object."""


@dataclass(frozen=True, eq=False)
class SeenObject:
    """An object of a cell, as it is.

    Attributes:
        kind: what it is.
        is_lying: whether it lies on its side.
        mask: [H, W] the pixels in which it is seen.
        outline: seen from above [m], world frame.
        is_required: whether it must be found: most of it is seen.
        is_whole: whether all of it is seen, so that its outline can be found.
    """

    kind: Kind
    is_lying: bool
    mask: Mask
    outline: shapely.Polygon
    is_required: bool = True
    is_whole: bool = True


@document
class FrameScore:
    """Scores of one frame.

    Attributes:
        num_required: objects that must be found.
        num_found: of them.
        num_detections: detections.
        num_invented: detections that are of no object.
        num_kinds: found objects whose kind is right.
        num_postures: found bottles and cups for which it is right whether they lie.
        num_with_posture: found bottles and cups.
        mask_overlaps: intersection over union of the masks of found objects.
        centre_errors: distances between the centroids of outlines of found whole objects [m].
        outline_overlaps: intersection over union of these outlines.
    """

    num_required: int
    num_found: int
    num_detections: int
    num_invented: int
    num_kinds: int
    num_postures: int
    num_with_posture: int
    mask_overlaps: tuple[float, ...]
    centre_errors: tuple[float, ...]
    outline_overlaps: tuple[float, ...]

    @classmethod
    def of(cls, content: Any) -> FrameScore:
        """From plain content (JSON).

        Raises:
            ValueError: it is no score.
        """
        return conform(cls, content)

    def row(self) -> dict[str, float]:
        """The numbers of a table: counts, and means."""
        counts = {name: float(value) for name, value in asdict(self).items() if isinstance(value, int)}
        means = {
            name: float(np.mean(value)) for name, value in asdict(self).items() if isinstance(value, tuple) and value
        }
        return counts | means

    @property
    def badness(self) -> float:
        """Mistakes, and the worst overlap of masks: large for frames to look at."""
        mistakes = self.num_required - self.num_found + self.num_invented + self.num_found - self.num_kinds
        return mistakes + 1.0 - min(self.mask_overlaps, default=1.0)


def matches(detections: Sequence[Detection], objects: Sequence[SeenObject]) -> dict[int, tuple[int, float]]:
    """Object -> (detection, intersection over union of the masks), the best assignment of at most one to one."""
    if not detections or not objects:
        return {}
    found = np.stack([detection.mask.ravel() for detection in detections]).astype(np.float32)
    right = np.stack([seen.mask.ravel() for seen in objects]).astype(np.float32)
    both = right @ found.T
    union = right.sum(axis=1)[:, None] + found.sum(axis=1)[None] - both
    overlap = both / np.maximum(union, 1.0)
    rows, columns = linear_sum_assignment(-overlap)
    return {
        int(row): (int(column), float(overlap[row, column]))
        for row, column in zip(rows, columns, strict=True)
        if overlap[row, column] >= MATCH
    }


def score_frame(detections: Sequence[Detection], objects: Sequence[SeenObject], camera: Camera) -> FrameScore:
    """Compare the detections in an image of ``camera`` with the objects in it."""
    pairs = matches(detections, objects)
    kinds = postures = with_posture = 0
    mask_overlaps: list[float] = []
    errors: list[float] = []
    overlaps: list[float] = []
    for row, (column, overlap) in pairs.items():
        seen, detection = objects[row], detections[column]
        if not seen.is_required:
            continue
        mask_overlaps.append(overlap)
        kinds += detection.kind is seen.kind
        if seen.kind in (Kind.BOTTLE, Kind.CUP):
            with_posture += 1
            postures += detection.kind is seen.kind and detection.is_lying == seen.is_lying
        found = silhouette(camera, detection) if seen.is_whole else None
        if found is not None:
            polygon = found.polygon
            errors.append(float(polygon.centroid.distance(seen.outline.centroid)))
            overlaps.append(float(polygon.intersection(seen.outline).area / polygon.union(seen.outline).area))
    matched = {column for column, _ in pairs.values()}
    hidden = [seen.mask for seen in objects if not seen.is_required]
    invented = [
        detection
        for number, detection in enumerate(detections)
        if number not in matched
        and not any((detection.mask & mask).sum() > 0.5 * detection.mask.sum() for mask in hidden)
    ]
    return FrameScore(
        sum(seen.is_required for seen in objects),
        len(mask_overlaps),
        len(detections),
        len(invented),
        kinds,
        postures,
        with_posture,
        tuple(mask_overlaps),
        tuple(errors),
        tuple(overlaps),
    )


def summary(scores: Iterable[FrameScore]) -> Metrics:
    """Rates and percentiles over all frames; distances in metres."""
    scores = list(scores)

    def total(name: str) -> int:
        return sum(getattr(score, name) for score in scores)

    def values(name: str) -> np.ndarray:
        return np.array([value for score in scores for value in getattr(score, name)] or [np.nan])

    found = max(1, total("num_found"))
    metrics = {
        "frames": float(len(scores)),
        "objects": float(total("num_required")),
        "found_rate": total("num_found") / max(1, total("num_required")),
        "invented_rate": total("num_invented") / max(1, total("num_detections")),
        "kind_rate": total("num_kinds") / found,
        "posture_rate": total("num_postures") / max(1, total("num_with_posture")),
        "mask_iou_mean": float(values("mask_overlaps").mean()),
        "centre_error_median": float(np.median(values("centre_errors"))),
        "centre_error_95": float(np.percentile(values("centre_errors"), 95.0)),
        "outline_iou_mean": float(values("outline_overlaps").mean()),
        "outline_iou_5": float(np.percentile(values("outline_overlaps"), 5.0)),
    }
    return {name: value for name, value in metrics.items() if np.isfinite(value)}
