"""A track as it is in one view."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.registration import Reference
from visualrhp.embodiment.track import Track
from visualrhp.embodiment.view import seen_object


def test_a_seen_object_has_the_outline_of_its_track_and_the_pose_of_the_state() -> None:
    reference, pose = Reference.located(shapely.box(0.0, 0.0, 0.1, 0.06))
    track = Track(3, reference, pose, (0.0, 0.05), {Kind.BOX: 1.0, Kind.CUP: 0.4}, last_seen_s=2.0, is_hidden=True)
    seen = seen_object(track, np.array([0.06, 0.03, 0.0]), 2.5)
    assert (seen.id, seen.kind, seen.is_hidden, seen.is_dropped) == (3, Kind.BOX, True, False)
    assert shapely.Polygon(seen.outline).bounds == pytest.approx((0.0, 0.0, 0.1, 0.06))
    assert seen.age_s == pytest.approx(0.5) and seen.pose[0] == 0.06
