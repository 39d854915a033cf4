"""The camera projects as computed by hand, and back-projection undoes it."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visualrhp.embodiment.camera import Camera
from visualrhp.errors import ConfigError, DataError

STRAIGHT = Camera.above((0.0, 0.0, 2.0), 1000.0, 641, 481)
DISTORTED = Camera.above(
    (0.03, -0.02, 1.4), 980.0, look_at=(0.05, 0.04, 0.0), distortion=(0.12, -0.1, 0.002, -0.001, 0.02)
)


def test_points_by_hand() -> None:
    # 2 m below the camera, 10 cm are 50 px; x is to the right, and y upwards.
    seen = STRAIGHT.project([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.0, 1.0]])
    assert seen == pytest.approx(np.array([[320.0, 240.0], [370.0, 240.0], [320.0, 190.0], [420.0, 240.0]]))


def test_behind_the_camera_nothing_is_seen() -> None:
    assert np.isnan(STRAIGHT.project([[0.0, 0.0, 3.0]])).all()
    assert STRAIGHT.project(np.zeros((0, 3))).shape == (0, 2)


def test_back_projection_by_hand() -> None:
    assert STRAIGHT.back_project([[370.0, 190.0]]) == pytest.approx(np.array([[0.1, 0.1]]))
    assert STRAIGHT.back_project([[370.0, 190.0]], 1.0) == pytest.approx(np.array([[0.05, 0.05]]))
    assert STRAIGHT.back_project(np.zeros((0, 2))).shape == (0, 2)


@settings(max_examples=50, deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.0, 0.25))
def test_a_lens_with_distortion_is_undone(x: float, y: float, z: float) -> None:
    pixels = DISTORTED.project([[x, y, z]])
    assert DISTORTED.back_project(pixels, z)[0] == pytest.approx([x, y], abs=1e-9)


def test_a_line_of_sight_above_the_horizon_meets_nothing() -> None:
    sideways = Camera.above((0.0, 0.0, 1.0), 100.0, look_at=(5.0, 0.0, 0.9))
    seen = sideways.back_project([[0.0, 240.0], [639.0, 240.0]])  # the image's right is up
    assert np.isfinite(seen[0]).all() and np.isnan(seen[1]).all()


def test_a_plane_above_the_camera_is_refused() -> None:
    with pytest.raises(ConfigError, match="not below the camera"):
        STRAIGHT.back_project([[0.0, 0.0]], 2.0)


def test_the_table_is_seen_through_a_homography() -> None:
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (5, 2))
    mapped = np.column_stack([points, np.ones(5)]) @ STRAIGHT.table_homography().T
    assert mapped[:, :2] / mapped[:, 2:] == pytest.approx(STRAIGHT.project(np.column_stack([points, np.zeros(5)])))


def test_position_nadir_and_inverse() -> None:
    assert DISTORTED.position == pytest.approx([0.03, -0.02, 1.4])
    assert DISTORTED.nadir == pytest.approx([0.03, -0.02])
    assert DISTORTED.world_to_camera @ DISTORTED.pose == pytest.approx(np.eye(4))


def test_a_file_holds_a_camera(tmp_path) -> None:
    DISTORTED.save(tmp_path / "camera.json")
    assert Camera.load(tmp_path / "camera.json") == DISTORTED != STRAIGHT
    assert Camera.from_document(json.loads(json.dumps(DISTORTED.to_document()))) == DISTORTED
    assert hash(Camera.load(tmp_path / "camera.json")) == hash(DISTORTED)
    assert pickle.loads(pickle.dumps(DISTORTED)) == DISTORTED


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"intrinsics": [[1.0, 0.0], [0.0, 1.0]]}, r"intrinsics should be finite numbers of the shape \[3, 3\]"),
        ({"intrinsics": [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "positive focal lengths"),
        (
            {"pose": [[2.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]]},
            "rotation",
        ),
        ({"pose": np.eye(4).tolist()}, "above the table"),
        ({"distortion": [0.0]}, r"distortion should be finite numbers of the shape \[5\]"),
        ({"width": 0}, "width=0 is out of range"),
        ({"height": 1.5}, "height=1.5 has the wrong type"),
        ({"format": 7}, "format=7 is not known"),
        ({"pose": "here"}, "pose=here has the wrong type"),
    ],
)
def test_documents_that_are_refused(tmp_path, change, message: str) -> None:
    content = STRAIGHT.to_document() | change
    with pytest.raises(DataError, match=message):
        Camera.from_document(content)
    (tmp_path / "camera.json").write_text(json.dumps(content))
    with pytest.raises(DataError, match=rf"camera\.json is damaged: .*{message}.*; calibrate the camera again"):
        Camera.load(tmp_path / "camera.json")


def test_a_missing_file_is_named(tmp_path) -> None:
    with pytest.raises(DataError, match=r"none\.json does not exist"):
        Camera.load(tmp_path / "none.json")


def test_its_arrays_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        STRAIGHT.pose[0, 0] = 2.0
