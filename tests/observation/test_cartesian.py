"""Cartesian features by hand and under mirroring (Sec. 7.5)."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.observation.cartesian import cartesian_dimension, cartesian_features, mirror_cartesian
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.types import State

SQUARE = ObjectShape([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]])


def test_features_by_hand() -> None:
    """The gripper heads along the world's y axis: world x right of it is -left."""
    scene = Scene(TargetRegion([-0.1, 0.05]), (SQUARE,))
    state = State.create([0.0, -0.2, np.pi / 2], 0.085, False, [[0.1, 0.05, np.pi]])
    expected = [1.0, -0.4, 0.0, 1.0, 1.0, 0.4, 0.0, -0.8, 0.0, 1.0]
    features = cartesian_features(scene, state)
    assert features.dtype == np.float32
    assert features == pytest.approx(expected, abs=1e-6)
    assert len(features) == cartesian_dimension(1)


def test_mirroring_is_the_mirrored_scene() -> None:
    scene = Scene(TargetRegion([-0.1, 0.05]), (SQUARE, SQUARE))
    state = State.create([0.02, -0.2, 0.9], 0.085, False, [[0.1, 0.05, 2.0], [0.0, -0.1, -0.4]])
    mirrored_scene = Scene(TargetRegion([-0.1, -0.05]), (SQUARE, SQUARE))
    mirrored_state = State.create(state.gripper_pose * (1, -1, -1), 0.085, False, state.object_poses * (1, -1, -1))
    mirrored = mirror_cartesian(cartesian_features(scene, state))
    assert mirrored == pytest.approx(cartesian_features(mirrored_scene, mirrored_state), abs=1e-6)
