"""The map of the reach: what it says of poses, motions and positions."""

from __future__ import annotations

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visualrhp.embodiment import reach
from visualrhp.embodiment.reach import LEAVING_ANGLE, LEAVING_DISTANCE, NUM_HEADINGS, WORKSPACE, ReachMap
from visualrhp.embodiment.robot_model import FLANGE_BEHIND, Mounting
from visualrhp.errors import DataError, UnreachableError
from visualrhp.simulation.action_spaces import GripperMotion

REACH = ReachMap.load()


def ring(low: int, high: int, mounting: Mounting | None = None, **keywords: Any) -> ReachMap:
    """Free in the cells [low, high) of the radius."""
    free = np.zeros((200, NUM_HEADINGS), dtype=bool)
    free[low:high] = True
    return ReachMap(mounting or Mounting(), free, **keywords)


def flange_radius(pose: Any) -> Any:
    x = pose[..., 0] - FLANGE_BEHIND * np.cos(pose[..., 2]) - Mounting().x
    y = pose[..., 1] - FLANGE_BEHIND * np.sin(pose[..., 2]) - Mounting().y
    return np.hypot(x, y)


def random_poses(count: int, side: float = 0.4) -> Any:
    rng = np.random.default_rng(0)
    return np.concatenate([rng.uniform(-side, side, (count, 2)), rng.uniform(-10.0, 10.0, (count, 1))], axis=1)


# --------------------------------------------------------------------------------------------------------------- poses
def test_a_ring_by_hand() -> None:
    """Cells of 5 mm: [50, 100) is the flange 0.25 to 0.5 m from the base."""
    part, poses = ring(50, 100), random_poses(2000)
    radius, inside = flange_radius(poses), abs(poses[:, :2]).max(axis=1) <= WORKSPACE
    assert (part.contains(poses) == ((radius >= 0.25) & (radius < 0.5) & inside)).all()


def test_the_heading_is_relative_to_the_direction_of_the_flange() -> None:
    """Only headings of 0 to 90 degrees from that direction are free."""
    free = np.zeros((200, NUM_HEADINGS), dtype=bool)
    free[:, : NUM_HEADINGS // 4] = True
    part = ReachMap(Mounting(), free)
    for direction in (-0.4, 0.0, 0.3):
        for heading, expected in ((-0.1, False), (0.1, True), (1.5, True), (1.6, False), (0.1 - 2 * np.pi, True)):
            flange = np.array([Mounting().x + 0.5 * math.cos(direction), 0.5 * math.sin(direction)])
            theta = direction + heading
            position = flange + FLANGE_BEHIND * np.array([math.cos(theta), math.sin(theta)])
            assert part.contains([*position, theta]) == expected


def test_contains_takes_arrays_of_any_shape() -> None:
    poses = random_poses(24)
    assert (REACH.contains(poses.reshape(2, 3, 4, 3)).ravel() == REACH.contains(poses)).all()
    assert REACH.contains(poses[0]).shape == ()
    assert not REACH.contains([np.nan, 0.0, 0.0])


def test_most_of_the_table_is_reached() -> None:
    """The numbers of the module: 99.7% of the poses over the table, all of them over most of it."""
    rng = np.random.default_rng(0)
    poses = np.stack([*rng.uniform(-0.25, 0.25, (2, 20_000)), rng.uniform(-np.pi, np.pi, 20_000)], axis=1)
    assert REACH.contains(poses).mean() == pytest.approx(0.997, abs=0.002)
    assert REACH.contains(poses[abs(poses[:, :2]).max(axis=1) < 0.15]).all()
    places = np.linspace(-0.25, 0.25, 11)
    assert all(REACH.headings((x, y)).mean() > 0.5 for x in places for y in places)
    assert not REACH.headings((0.6, 0.0)).any()


def test_mounting_elsewhere_moves_the_map() -> None:
    moved = ReachMap.load(Mounting(0.0, -0.55, 0.0, 0.0))
    poses = random_poses(500)
    turned = np.stack([-poses[:, 1], poses[:, 0], poses[:, 2] + np.pi / 2], axis=1)
    assert (moved.contains(turned) == REACH.contains(poses)).all()


# -------------------------------------------------------------------------------------------------------------- motions
motions = st.builds(GripperMotion, st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.8, 0.8))
reals = st.floats(-0.4, 0.4)


def along_the_way(part: ReachMap, pose: Any, motion: GripperMotion) -> bool:
    theta = pose[2]
    ahead = np.array([math.cos(theta), math.sin(theta)])
    line = motion.forward * ahead + motion.left * np.array([-ahead[1], ahead[0]])
    count = math.ceil(max(np.linalg.norm(line) / LEAVING_DISTANCE, abs(motion.rotation) / LEAVING_ANGLE))
    parts = np.arange(1, count + 1) / max(count, 1)
    way = np.array(pose) + parts[:, None] * np.array([*line, motion.rotation])
    return bool(part.contains(way).all())


@settings(deadline=None)
@given(st.tuples(reals, reals, st.floats(-4.0, 4.0)), motions)
def test_allows_is_contains_along_the_way(pose: Any, motion: GripperMotion) -> None:
    assert REACH.allows(pose, motion) == along_the_way(REACH, pose, motion)


def test_allows_is_contains_along_the_way_in_a_narrow_map_too() -> None:
    part, rng = ring(80, 130), np.random.default_rng(2)
    part.free[100, 30:40] = False
    part = ReachMap(Mounting(), part.free)
    answers = []
    for pose in random_poses(2000):
        forward, left, rotation = rng.uniform(-1.0, 1.0, 3) * (0.1, 0.1, 0.8)
        motion = GripperMotion(forward, left, rotation)
        answers.append(part.allows(pose, motion))
        assert answers[-1] == along_the_way(part, pose, motion)
    assert 0.1 < np.mean(answers) < 0.9


def test_a_way_out_of_the_map_and_back_is_not_allowed() -> None:
    """A chord: both ends have the flange 0.351 m from the base, the middle 0.347 m; the map begins at 0.35 m."""
    part = ring(70, 200)
    x = Mounting().x + FLANGE_BEHIND + 0.347
    assert part.contains([[x, 0.05, 0.0], [x, -0.05, 0.0]]).all()
    assert not part.allows([x, 0.05, 0.0], GripperMotion(left=-0.1))
    assert part.allows([x + 0.01, 0.05, 0.0], GripperMotion(left=-0.1))


def test_a_start_just_outside_can_be_left() -> None:
    x = Mounting().x + FLANGE_BEHIND + 0.35
    part = ring(70, 200)
    assert not part.contains([x - 0.005, 0.0, 0.0])
    assert part.allows([x - 0.005, 0.0, 0.0], GripperMotion(forward=0.05))
    assert not part.allows([x - 0.005, 0.0, 0.0], GripperMotion(forward=-0.05))
    assert not part.allows([x - 0.02, 0.0, 0.0], GripperMotion(forward=0.05))


def test_fingers_move_anywhere() -> None:
    assert ring(0, 0).allows([0.0, 0.0, 0.0], GripperMotion(closed=True))


def test_check_says_where() -> None:
    REACH.check([0.0, 0.0, 0.0], GripperMotion(forward=0.1))
    with pytest.raises(UnreachableError, match=r"\(0.340 m, 0.000 m, 0.0 degrees\), which is outside the workspace"):
        REACH.check([0.25, 0.0, 0.0], GripperMotion(forward=0.09))
    with pytest.raises(UnreachableError, match="which cannot be taken by the arm"):
        REACH.check([-0.2, 0.0, 0.0], GripperMotion(forward=-0.05))


# ---------------------------------------------------------------------------------------------------------------- files
def test_maps_are_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = ring(50, 100)
    part.save(tmp_path / "map.npz")
    monkeypatch.setattr(reach, "REACH_FILE", tmp_path / "map.npz")
    loaded = ReachMap.load()
    assert (loaded.free == part.free).all() and loaded.mounting == part.mounting


def test_a_copy_is_the_same() -> None:
    poses = random_poses(100)
    assert (pickle.loads(pickle.dumps(REACH)).contains(poses) == REACH.contains(poses)).all()


def test_a_map_for_another_geometry_is_refused() -> None:
    with pytest.raises(DataError, match=r"compute one with visualrhp\.embodiment\.reach_computation"):
        ReachMap.load(Mounting(height=0.1))


@pytest.mark.parametrize("free", [np.zeros(3, bool), np.zeros((4, 3), bool), np.zeros((4, NUM_HEADINGS))])
def test_maps_have_one_shape(free: Any) -> None:
    with pytest.raises(DataError, match="has the shape"):
        ReachMap(Mounting(), free)
