"""What overlaps is moved apart, as little as possible."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visualrhp.embodiment.robot_model import CELL_GRIPPER
from visualrhp.embodiment.separation import MAX_MOTION, MAX_OVERLAP, penetration, separated
from visualrhp.scene.scene import ObjectShape, Scene, TargetRegion
from visualrhp.scene.start import check_start
from visualrhp.types import State

SQUARE = np.array([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]])
SHAPE = ObjectShape.centred(SQUARE)
AWAY = (-0.2, 0.0, math.pi)


def test_two_squares() -> None:
    depth, direction = penetration(SQUARE, SQUARE + (0.035, 0.0))
    assert depth == pytest.approx(0.005)
    assert direction == pytest.approx([-1.0, 0.0])
    assert penetration(SQUARE, SQUARE + (0.0, 0.05))[0] == pytest.approx(-0.01)


def test_a_vertex_in_an_edge() -> None:
    turned = SQUARE @ np.array([[1.0, 1.0], [-1.0, 1.0]]) * math.sqrt(0.5)
    depth, direction = penetration(turned + (0.04, 0.0), SQUARE)
    assert depth == pytest.approx(0.02 + 0.02 * math.sqrt(2.0) - 0.04)
    assert direction == pytest.approx([1.0, 0.0])


def test_apart_nothing_moves() -> None:
    poses = np.array([[0.0, 0.0, 0.3], [0.1, 0.0, -1.0]])
    moved, opening = separated([SHAPE, SHAPE], poses, CELL_GRIPPER, AWAY, 0.06)
    assert np.array_equal(moved, poses) and opening == 0.06


def test_two_objects_share_the_motion() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [0.036, 0.0, 0.0]])
    moved, _ = separated([SHAPE, SHAPE], poses, CELL_GRIPPER, AWAY, 0.06)
    assert moved[:, 0] == pytest.approx([-0.002, 0.038], abs=MAX_OVERLAP)
    assert np.array_equal(moved[:, 1:], poses[:, 1:])


def test_the_gripper_stays_and_the_object_moves() -> None:
    tip = CELL_GRIPPER.finger_reach
    poses = np.array([[tip + 0.016, 0.05, 0.0]])  # in front of the left finger, 4 mm in it
    moved, opening = separated([SHAPE], poses, CELL_GRIPPER, (0.0, 0.0, 0.0), 0.06)
    assert moved[0] == pytest.approx([tip + 0.02, 0.05, 0.0], abs=MAX_OVERLAP)
    assert opening == 0.06


def test_the_fingers_are_as_far_apart_as_what_they_hold() -> None:
    poses = np.array([[0.0, 0.003, 0.0]])
    moved, opening = separated([SHAPE], poses, CELL_GRIPPER, (0.0, 0.0, 0.0), 0.036, held=[0])
    assert opening == pytest.approx(0.04)
    assert moved[0, 1] == pytest.approx(0.0, abs=1e-9)


def test_what_is_held_loosely_is_moved_off_the_finger() -> None:
    poses = np.array([[0.0, 0.02, 0.0]])
    moved, opening = separated([SHAPE], poses, CELL_GRIPPER, (0.0, 0.0, 0.0), 0.07, held=[0])
    assert opening == 0.07
    assert moved[0, 1] == pytest.approx(0.015, abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_a_planner_can_start_from_what_is_seen(seed: int) -> None:
    """Bodies that do not overlap, seen with an error of up to 4 mm."""
    rng = np.random.default_rng(seed)
    angles = 2.0 * np.pi * np.arange(10) / 10
    shape = ObjectShape.centred(0.035 * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    grid = np.array([[0.0, 0.0], [0.07, 0.0], [0.14, 0.0], [0.0, 0.07], [0.07, 0.07], [0.14, 0.07]])
    poses = np.column_stack([grid - 0.02 + rng.uniform(-0.004, 0.004, grid.shape), np.zeros(6)])
    gripper_pose = (-0.08, 0.0, 0.0)
    moved, opening = separated([shape] * 6, poses, CELL_GRIPPER, gripper_pose, 0.085)
    assert np.abs(moved - poses).max() < 0.02
    scene = Scene(TargetRegion(np.zeros(2)), (shape,) * 6, gripper=CELL_GRIPPER)
    check_start(scene, State.create(gripper_pose, opening, False, moved))


def test_nothing_is_moved_far() -> None:
    box = ObjectShape.centred(np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]]))
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.05, 0.0]])
    moved, _ = separated([box, box], poses, CELL_GRIPPER, (1.0, 1.0, 0.0), 0.0)
    assert np.hypot(*(moved - poses)[:, :2].T) == pytest.approx([MAX_MOTION, MAX_MOTION])
