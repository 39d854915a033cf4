"""Bodies that touch and are detected as one."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from tests.embodiment.test_tracking import BOX, DISC, Scenes, partly, seen
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.merging import split
from visualrhp.embodiment.outlines import Silhouette
from visualrhp.embodiment.registration import Reference
from visualrhp.embodiment.track import Track


def merged(*silhouettes: Silhouette) -> Silhouette:
    """One detection of all."""
    union = shapely.union_all([each.polygon.buffer(1e-3) for each in silhouettes]).buffer(-1e-3)
    points = shapely.get_coordinates(shapely.segmentize(shapely.orient_polygons(union), 2e-3).exterior)[:-1]
    first = silhouettes[0]
    seen_all = np.ones(len(points), dtype=bool)
    return Silhouette(first.detection, points, first.heights, seen_all, 1.0, shapely.Polygon())


@pytest.mark.parametrize("error", [(0.0, 0.0), (0.006, -0.005), (-0.004, 0.008)])
def test_two_boxes_side_by_side_are_found_in_one_detection(error: tuple[float, float]) -> None:
    scenes = Scenes()
    scenes.see(seen(BOX, 0.0, -0.08), seen(BOX, 0.0, 0.08), times=3)
    for y in (0.05, 0.0305):
        first, second = seen(BOX, 0.02, -y, 0.1), seen(BOX, 0.01, y, 0.0)
        scenes.tracker.expect({0: np.array([0.02 + error[0], -y + error[1], 0.1]), 1: np.array([0.01, y, 0.0])})
        tracks = scenes.see(*((first, second) if y > 0.04 else (merged(first, second),)))
    for track, truth in zip(tracks, ((0.02, -0.0305), (0.01, 0.0305)), strict=True):
        assert not track.is_hidden and track.num_missed == 0
        assert np.hypot(*(track.pose[:2] - truth)) < 4e-3


def track_of(silhouette: Silhouette, number: int = 0) -> tuple[Track, list[np.ndarray]]:
    reference, pose = Reference.located(silhouette.polygon, 0.0)
    return Track(number, reference, pose, silhouette.heights, votes={Kind.BOX: 1.0}), [pose]


def test_what_is_one_object_stays_whole() -> None:
    box, disc, far = seen(BOX, 0.0, 0.0), seen(DISC, 0.1, 0.0), seen(DISC, 0.0, 0.15)
    tracks, expected = zip(*(track_of(each, n) for n, each in enumerate((box, disc, far))), strict=True)
    assert split([box, disc, far], tracks, expected) == [box, disc, far]
    assert split([box, disc], tracks, expected) == [box, disc], "a missing one does not change the others"
    half = partly(box, shapely.box(0.0, -0.1, 0.1, 0.1))
    assert split([half], tracks[:1], expected[:1]) == [half]
    # A track that is expected within another one's outline, which is all that is seen, is not there.
    small, inside = track_of(seen(DISC, 0.01, 0.0), 3)
    assert split([box], [tracks[0], small], [expected[0], inside]) == [box]


def test_each_part_has_its_share_of_the_border_that_was_seen() -> None:
    first, second = seen(BOX, 0.0, -0.0305), seen(BOX, 0.0, 0.0305)
    both = merged(first, second)
    tracks, expected = zip(track_of(first), track_of(second, 1), strict=True)
    parts = split([both], tracks, expected)
    assert len(parts) == 2
    for part, sign in zip(parts, (-1.0, 1.0), strict=True):
        own = part.points[part.is_seen]
        assert (sign * own[:, 1] > -2e-3).all() and len(own) > 50
        assert part.share_seen == pytest.approx(0.69, abs=0.06)  # 26 of 32 cm, and the side in the middle is not seen
        assert part.detection is both.detection and part.centroid[1] == pytest.approx(sign * 0.0305, abs=2e-3)
