"""Tracks keep identities, shapes and poses, from silhouettes that are made by hand."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from tests.embodiment.seen_bodies import top_camera
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.occlusion import HiddenRegion
from visualrhp.embodiment.outlines import Silhouette
from visualrhp.embodiment.robot_model import CELL_GRIPPER
from visualrhp.embodiment.segmentation import Detection
from visualrhp.embodiment.tracking import GripperView, Tracker, TrackerParameters
from visualrhp.errors import ConfigError, PerceptionError
from visualrhp.scene.scene import square_edges

CAMERA = top_camera(focal_length=1000.0)
NOTHING = HiddenRegion(CAMERA, np.zeros((0, 0), dtype=bool))
EVERYTHING = HiddenRegion(CAMERA, np.ones((CAMERA.height, CAMERA.width), dtype=bool))
AWAY = GripperView(np.array([-0.3, 0.0, np.pi]), 0.085, False)
BOX = shapely.segmentize(shapely.box(-0.05, -0.03, 0.05, 0.03), 2e-3)
DISC = shapely.Point(0.0, 0.0).buffer(0.035, quad_segs=24)


def seen(outline, x: float, y: float, theta: float = 0.0, kind: Kind = Kind.BOX, is_lying: bool = False, score=1.0):
    turned = shapely.affinity.rotate(outline, theta, origin=(0, 0), use_radians=True)
    points = shapely.get_coordinates(shapely.orient_polygons(turned).exterior)[:-1] + (x, y)
    detection = Detection(kind, is_lying, np.ones((1, 1), dtype=bool), score)
    return Silhouette(detection, points, (0.03, 0.03), np.ones(len(points), dtype=bool), 1.0, shapely.Polygon())


def partly(silhouette: Silhouette, hidden: shapely.Polygon) -> Silhouette:
    """What is left of a silhouette behind something."""
    rest = shapely.difference(silhouette.polygon, hidden)
    points = shapely.get_coordinates(shapely.orient_polygons(shapely.segmentize(rest, 2e-3)).exterior)[:-1]
    is_seen = shapely.distance(hidden, shapely.points(points)) > 2e-3
    return Silhouette(
        silhouette.detection, points, silhouette.heights, is_seen, float(is_seen.mean()), hidden.buffer(2e-3)
    )


class Scenes:
    """A tracker that is given views."""

    def __init__(self, **settings) -> None:
        self.tracker = Tracker(square_edges(0.5), CELL_GRIPPER, TrackerParameters(**settings))
        self.time_s = 0.0

    def see(self, *silhouettes: Silhouette, hidden=NOTHING, gripper=AWAY, times: int = 1):
        for _ in range(times):
            self.time_s += 1.0
            self.tracker.update(silhouettes, hidden, gripper, self.time_s)
        return self.tracker.tracks


def test_objects_that_cross_keep_their_identity_by_kind_and_size() -> None:
    scenes = Scenes()
    before = scenes.see(seen(BOX, -0.1, 0.0), seen(DISC, 0.1, 0.0, kind=Kind.ORANGE), times=3)
    assert [(track.id, track.kind) for track in before] == [(0, Kind.BOX), (1, Kind.ORANGE)]
    after = scenes.see(seen(DISC, -0.02, 0.0, kind=Kind.ORANGE), seen(BOX, 0.0, 0.05))
    assert [(track.id, track.kind) for track in after] == [(0, Kind.BOX), (1, Kind.ORANGE)]
    assert after[0].pose[:2] == pytest.approx([0.0, 0.05], abs=1e-6)
    assert scenes.tracker.is_settled


def test_a_turn_is_followed_and_the_shape_stays() -> None:
    scenes = Scenes()
    (track,) = scenes.see(seen(BOX, 0.0, 0.0), times=3)
    shape = track.reference.shape
    for step in range(1, 8):
        scenes.see(seen(BOX, 0.01 * step, 0.0, 0.4 * step))
    assert track.reference.shape is shape
    assert np.angle(np.exp(1j * (track.pose[2] - 2.8))) == pytest.approx(0.0, abs=0.01)


def test_a_body_that_tips_over_gets_another_outline_at_the_second_view() -> None:
    scenes = Scenes()
    (track,) = scenes.see(seen(DISC, 0.0, 0.0, kind=Kind.BOTTLE), times=3)
    shape = track.reference.shape
    scenes.see(seen(BOX, 0.02, 0.0, kind=Kind.BOTTLE))
    assert track.reference.shape is shape and not scenes.tracker.is_settled
    scenes.see(seen(BOX, 0.02, 0.0, kind=Kind.BOTTLE))
    assert track.reference.shape is not shape and scenes.tracker.is_settled
    scenes.see(seen(DISC, 0.02, 0.0, kind=Kind.BOTTLE, is_lying=True))
    assert track.is_lying and track.reference.is_round  # told by the segmenter: at once


def test_a_wrong_kind_in_one_view_does_not_count() -> None:
    scenes = Scenes()
    scenes.see(seen(DISC, 0.0, 0.0, kind=Kind.ORANGE), times=3)
    (track,) = scenes.see(seen(DISC, 0.0, 0.0, kind=Kind.APPLE))
    assert track.kind is Kind.ORANGE
    (track,) = scenes.see(seen(DISC, 0.0, 0.0, kind=Kind.APPLE), times=5)
    assert track.kind is Kind.APPLE


def test_a_part_is_enough_for_the_pose() -> None:
    scenes = Scenes()
    (track,) = scenes.see(seen(BOX, 0.0, 0.0, 0.2), times=3)
    arm = shapely.box(0.03, -0.3, 0.3, 0.3)
    scenes.see(partly(seen(BOX, 0.02, 0.01, 0.35), arm))
    assert track.pose == pytest.approx([0.02, 0.01, 0.15], abs=0.02)
    assert scenes.tracker.is_settled


def test_a_better_view_completes_an_outline() -> None:
    scenes = Scenes()
    (track,) = scenes.see(partly(seen(BOX, 0.0, 0.0), shapely.box(0.01, -0.3, 0.3, 0.3)), times=3)
    assert track.reference.shape.area < 0.7 * BOX.area
    scenes.see(seen(BOX, 0.0, 0.0))
    assert track.reference.shape.area == pytest.approx(BOX.area, rel=0.02)
    assert track.quality == 1.0


def test_a_fruit_of_which_a_part_is_hidden_at_first_is_round() -> None:
    hidden = shapely.box(-0.005, -0.3, 0.3, 0.3)
    (track,) = Scenes().see(partly(seen(DISC, 0.0, 0.0, kind=Kind.ORANGE), hidden))
    assert track.pose[:2] == pytest.approx([0.0, 0.0], abs=2e-3)
    assert track.reference.shape.area == pytest.approx(DISC.area, rel=0.1)


def test_what_is_hidden_stays_where_it_was() -> None:
    scenes = Scenes()
    scenes.see(seen(BOX, 0.05, 0.0), times=3)
    (track,) = scenes.see(hidden=EVERYTHING, times=10)
    assert track.is_hidden and track.pose == pytest.approx([0.05, 0.0, 0.0])
    assert track.last_seen_s == 3.0 and scenes.tracker.is_settled


def test_what_is_held_and_hidden_moves_with_the_gripper() -> None:
    scenes = Scenes()
    hand = GripperView(np.array([0.0, 0.0, 0.0]), 0.07, True)
    (track,) = scenes.see(seen(DISC, 0.0, 0.0, kind=Kind.ORANGE), gripper=hand, times=3)
    assert track.is_held
    moved = GripperView(np.array([0.1, 0.05, 0.5]), 0.07, True)
    scenes.see(hidden=EVERYTHING, gripper=moved)
    assert track.pose == pytest.approx([0.1, 0.05, 0.5])
    opened = GripperView(np.array([0.0, 0.05, 0.5]), 0.085, False)
    scenes.see(seen(DISC, 0.1, 0.05, kind=Kind.ORANGE), gripper=opened)
    assert not track.is_held and track.pose[:2] == pytest.approx([0.1, 0.05], abs=1e-6)


def test_what_vanishes_close_to_the_edge_has_fallen() -> None:
    scenes = Scenes()
    scenes.see(seen(DISC, 0.2, 0.1), times=3)
    (track,) = scenes.see(times=2)
    assert not track.is_dropped and not scenes.tracker.is_settled
    (track,) = scenes.see()
    assert track.is_dropped and track.pose[0] > 0.25
    assert scenes.tracker.is_settled and scenes.see(times=5)[0].is_dropped


def test_what_is_seen_beside_the_surface_has_fallen() -> None:
    scenes = Scenes()
    scenes.see(seen(DISC, 0.2, 0.0), times=3)
    (track,) = scenes.see(seen(DISC, 0.3, 0.0))
    assert track.is_dropped
    assert not scenes.see(seen(DISC, 0.2, 0.0))[0].is_dropped


def test_what_vanishes_elsewhere_is_an_error() -> None:
    scenes = Scenes(forget=2)
    scenes.see(seen(DISC, 0.0, 0.1), times=3)
    scenes.see()
    with pytest.raises(PerceptionError, match=r"vanished: box 0 at \(0\.000, 0\.100\)"):
        scenes.see()


def test_a_ghost_leaves_no_trace() -> None:
    scenes = Scenes()
    box = seen(BOX, 0.0, 0.0)
    scenes.see(box, times=3)
    assert len(scenes.see(box, seen(DISC, 0.15, 0.15))) == 1
    assert not scenes.tracker.is_settled
    assert len(scenes.see(box)) == 1 and scenes.tracker.is_settled
    assert len(scenes.see(box, seen(DISC, 0.15, 0.15), times=3)) == 2


@pytest.mark.parametrize("times", [4, 10])
def test_what_appears_late_close_to_the_edge_and_is_soon_gone_was_none(times) -> None:
    """Such as a piece of the arm's shadow."""
    scenes = Scenes()
    scenes.see(seen(BOX, 0.0, 0.0), times=3)
    scenes.see(seen(BOX, 0.0, 0.0), seen(DISC, -0.21, 0.0), times=times)
    tracks = scenes.see(seen(BOX, 0.0, 0.0), times=3)
    if times < 10:
        assert [track.id for track in tracks] == [0] and scenes.tracker.is_settled
    else:
        assert [track.is_dropped for track in tracks] == [False, True]


def test_a_second_detection_of_an_object_and_things_beside_the_surface_are_none() -> None:
    scenes = Scenes()
    tracks = scenes.see(seen(BOX, 0.0, 0.0), seen(BOX, 0.004, 0.0), seen(DISC, 0.4, 0.0), times=4)
    assert len(tracks) == 1


def test_an_unsure_detection_is_a_known_object_or_nothing() -> None:
    scenes = Scenes()
    scenes.see(seen(BOX, 0.0, 0.0), seen(DISC, 0.15, 0.1), times=3)
    unsure, ghost = seen(BOX, 0.01, 0.0, score=0.4), seen(DISC, -0.15, 0.1, score=0.4)
    box = scenes.see(unsure, ghost, seen(DISC, 0.15, 0.1), times=4)[0]
    assert scenes.tracker.is_settled
    assert box.pose[:2] == pytest.approx([0.01, 0.0], abs=1e-3)
    # One that is sure comes first, even if it is further away.
    box = scenes.see(unsure, seen(BOX, 0.06, 0.0), seen(DISC, 0.15, 0.1))[0]
    assert box.pose[:2] == pytest.approx([0.06, 0.0], abs=1e-3)
    scenes.see(ghost, seen(DISC, 0.15, 0.1), times=2)
    with pytest.raises(PerceptionError, match="vanished: box 0"):
        scenes.see(ghost, seen(DISC, 0.15, 0.1))


def test_before_any_object_is_confirmed_all_are_told() -> None:
    scenes = Scenes()
    assert len(scenes.see(seen(BOX, 0.0, 0.0), seen(DISC, 0.1, 0.1))) == 2
    assert not scenes.tracker.is_settled


def test_a_share_is_at_most_one() -> None:
    with pytest.raises(ConfigError, match="agreement"):
        TrackerParameters(agreement=1.5)


def test_what_is_hidden_is_where_a_model_expects_it() -> None:
    scenes = Scenes()
    scenes.see(seen(BOX, 0.05, 0.0), times=3)
    scenes.tracker.expect({0: np.array([0.1, 0.02, 0.3])})
    (track,) = scenes.see(hidden=EVERYTHING, times=3)
    assert track.is_hidden and track.pose == pytest.approx([0.1, 0.02, 0.3])
    scenes.tracker.expect({0: np.array([0.4, 0.02, 0.3])})
    (track,) = scenes.see(hidden=EVERYTHING)
    assert not track.is_dropped and 0.24 < track.pose[0] < 0.25  # a drop has to be seen


def test_of_two_of_a_kind_the_one_that_should_be_in_sight_is_seen() -> None:
    scenes = Scenes()
    scenes.see(seen(DISC, -0.1, 0.0, kind=Kind.ORANGE), seen(DISC, 0.0, 0.0, kind=Kind.ORANGE), times=3)
    # The first one is pushed below the arm, and pushes the second one to where the first one was.
    scenes.tracker.expect({0: np.array([0.0, 0.0, 0.0]), 1: np.array([-0.08, 0.06, 0.0])})
    first, second = scenes.see(seen(DISC, -0.08, 0.05, kind=Kind.ORANGE), hidden=EVERYTHING)
    assert first.is_hidden and first.pose[:2] == pytest.approx([0.0, 0.0])
    assert not second.is_hidden and second.pose[:2] == pytest.approx([-0.08, 0.05], abs=1e-6)


@pytest.mark.parametrize(("kind", "ids"), [(Kind.APPLE, [0]), (Kind.BOX, [0, 1])])
def test_what_rolled_away_behind_the_arm_is_no_new_object(kind, ids) -> None:
    scenes = Scenes()
    scenes.see(seen(DISC, -0.1, -0.1, kind=Kind.APPLE), times=3)
    scenes.see(hidden=EVERYTHING)
    tracks = scenes.see(seen(DISC, 0.1, 0.1, kind=kind), hidden=EVERYTHING, times=3)
    assert [track.id for track in tracks] == ids


def test_a_cup_that_tipped_over_is_no_apple() -> None:
    """Both are expected below the arm; what comes out, closer to where the apple was, looks like a bottle."""
    scenes = Scenes()
    scenes.see(seen(DISC, 0.0, 0.0, kind=Kind.CUP), seen(DISC, -0.05, 0.08, kind=Kind.APPLE), times=3)
    cup, apple = scenes.see(seen(BOX, -0.12, 0.09, kind=Kind.BOTTLE, is_lying=True), hidden=EVERYTHING)
    assert not cup.is_hidden and cup.pose[:2] == pytest.approx([-0.12, 0.09], abs=5e-3)
    assert apple.is_hidden and apple.pose[:2] == pytest.approx([-0.05, 0.08])


def test_what_is_seen_close_to_the_edge_is_on_it() -> None:
    scenes = Scenes()
    scenes.see(seen(DISC, 0.24, 0.0), times=3)
    (track,) = scenes.see(seen(DISC, 0.254, 0.0))
    assert not track.is_dropped and 0.24 < track.pose[0] < 0.25
    (track,) = scenes.see(seen(DISC, 0.27, 0.0))
    assert track.is_dropped


def test_an_outline_that_never_fits_does_not_unsettle_for_ever() -> None:
    scenes = Scenes(misfit=1e-5)
    scenes.see(seen(BOX, 0.0, 0.0), times=3)
    arm = shapely.box(-0.008, -0.3, 0.3, 0.3)
    scenes.see(partly(seen(BOX, 0.0, 0.0), arm))
    assert not scenes.tracker.is_settled
    scenes.see(partly(seen(BOX, 0.0, 0.0), arm), times=3)
    assert scenes.tracker.is_settled


def test_a_fragment_that_does_not_fit_tells_that_the_object_is_there() -> None:
    scenes = Scenes()
    scenes.see(seen(BOX, 0.0, 0.0), times=3)
    scenes.tracker.expect({0: np.array([0.06, 0.0, 0.0])})
    wedge = shapely.segmentize(shapely.Polygon([(0.02, 0.0), (0.06, 0.005), (0.02, 0.02)]), 2e-3)
    (track,) = scenes.see(partly(seen(wedge, 0.0, 0.0), shapely.box(0.05, -0.3, 0.3, 0.3)))
    assert track.pose[:2] == pytest.approx([0.06, 0.0], abs=0.01)
    assert not track.is_hidden and scenes.tracker.is_settled
