"""Bodies that touch may be detected as one: what is known of them tells them apart.

A network that groups pixels around centres finds one centre for two bottles that lie side by side. Where the tracks of
both are expected, the outline of the one detection is cut along the expected outlines. The cut is not a border that was
seen, so that each track is registered with its share of the true border only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import shapely

from visualrhp.embodiment.outlines import Silhouette, largest_piece
from visualrhp.embodiment.track import Track
from visualrhp.types import FloatArray

_WITHIN: Final = 0.6
"""Share of a track's outline within a detection from which on it may be a part of it."""

_FILLED: Final = 0.75
"""Share of the area of several tracks from which on a detection may be all of them."""

_LARGER: Final = 1.3
"""By how much a detection is larger than the largest track if it is more than this one."""

_STEP: Final = 2e-3
"""Between points of the border of a part [m]."""

_ON_BORDER: Final = 5e-4
"""Distance from the border that was seen, up to which a point of a part is on it [m]."""


def split(
    silhouettes: Sequence[Silhouette], tracks: Sequence[Track], expected: Sequence[Sequence[FloatArray]]
) -> list[Silhouette]:
    """The silhouettes, of which those of several tracks are cut into one for each.

    Args:
        silhouettes: the objects that are detected.
        tracks: the objects that are known.
        expected: of each track, poses [3] where it may be, the likeliest last.
    """
    places = [track.reference.at(poses[-1]) for track, poses in zip(tracks, expected, strict=True)]
    kept: list[Silhouette] = []
    for number, silhouette in enumerate(silhouettes):
        others = [other.polygon for index, other in enumerate(silhouettes) if index != number]
        inside = [
            place
            for track, place in zip(tracks, places, strict=True)
            if not track.is_dropped
            and _share(place, silhouette.polygon) >= _WITHIN
            and not any(_share(place, other) >= _WITHIN for other in others)
        ]
        kept += _parts(silhouette, inside) if _is_several(silhouette, inside) else [silhouette]
    return kept


def _is_several(silhouette: Silhouette, places: Sequence[shapely.Polygon]) -> bool:
    areas = [place.area for place in places]
    return len(areas) > 1 and silhouette.area >= _FILLED * sum(areas) and silhouette.area >= _LARGER * max(areas)


def _share(place: shapely.Polygon, polygon: shapely.Polygon) -> float:
    """Of ``place``, within ``polygon``."""
    return shapely.intersection(place, polygon).area / place.area


def _parts(silhouette: Silhouette, places: Sequence[shapely.Polygon]) -> list[Silhouette]:
    border = shapely.get_exterior_ring(silhouette.polygon)
    parts = []
    for number, place in enumerate(places):
        others = shapely.union_all([other for index, other in enumerate(places) if index != number])
        # What both are expected to cover, or none, may belong to either.
        piece = largest_piece(shapely.difference(silhouette.polygon, shapely.difference(others, place)))
        ring = shapely.get_exterior_ring(shapely.orient_polygons(piece))
        points = shapely.get_coordinates(shapely.line_interpolate_point(ring, np.arange(0.0, ring.length, _STEP)))
        is_seen = shapely.distance(border, shapely.points(points)) <= _ON_BORDER
        is_own = shapely.distance(place, shapely.points(points)) <= shapely.distance(others, shapely.points(points))
        seen = is_seen & is_own
        parts.append(
            replace(
                silhouette,
                points=points,
                is_seen=seen,
                share_seen=float(np.mean(seen)),
                hidden=shapely.union(silhouette.hidden, shapely.difference(silhouette.polygon, piece)),
            )
        )
    return parts
