"""Starts that are fit to be simulated and those that are not."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.errors import SceneError
from visualrhp.scene import MAX_START_OVERLAP, ObjectShape, Scene, TargetRegion, check_start
from visualrhp.scene.start import field_path, start_faults
from visualrhp.types import State

BOX = ObjectShape([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]])
U_SHAPE = ObjectShape.centred(
    [[0, 0], [0.08, 0], [0.08, 0.08], [0.07, 0.08], [0.07, 0.01], [0.01, 0.01], [0.01, 0.08], [0, 0.08]]
)
SCENE = Scene(TargetRegion([0.0, 0.0]), (BOX, BOX))


def state(*poses: tuple[float, float, float], start: tuple[float, float, float] = (0.0, -0.2, 1.57)) -> State:
    return State.create(start, 0.085, False, poses)


def faults(scene: Scene, start: State) -> list[str]:
    return [field_path(fault.where) for fault in start_faults(scene, start)]


def test_a_valid_start() -> None:
    check_start(SCENE, state((0.1, 0.1, 0.0), (-0.1, 0.1, 3.0)))


@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0])
@pytest.mark.parametrize(("depth", "fits"), [(0.9, True), (1.1, False), (10.0, False)])
def test_overlap_is_measured_as_depth(depth: float, fits: bool, angle: float) -> None:
    """Two boxes face to face, and a box and a finger: whatever the area, what counts is how deep."""
    gap = 0.04 - depth * MAX_START_OVERLAP
    second = (gap * np.cos(angle), gap * np.sin(angle), angle)
    assert faults(SCENE, state((0.0, 0.0, angle), second)) == ([] if fits else ["objects[1].pose"])
    # the inner face of a finger is at half the opening, left of the gripper's heading
    beside = 0.0425 - 0.02 + depth * MAX_START_OVERLAP
    scene = Scene(TargetRegion([0.0, 0.0]), (BOX,))
    held = (-np.sin(angle) * beside, np.cos(angle) * beside, angle)
    found = faults(scene, State.create((0.0, 0.0, angle), 0.085, False, [held]))
    assert found == ([] if fits else ["objects[0].pose"])


def test_an_object_may_lie_in_the_notch_of_another() -> None:
    scene = Scene(TargetRegion([0.0, 0.0]), (U_SHAPE, BOX))
    x, y = U_SHAPE.outline[0] + (0.04, 0.035)  # the notch reaches from 0.01 to 0.07 m
    assert faults(scene, state((0.0, 0.1, 0.0), (x, y + 0.1, 0.0))) == []
    assert faults(scene, state((0.0, 0.1, 0.0), (x + 0.015, y + 0.1, 0.0))) == ["objects[1].pose"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({8: np.nan}, r"objects\[1\].pose: .*finite"),
        ({8: 1e300}, r"objects\[1\].pose: .*within 100 m"),
        ({8: 0.26}, r"objects\[1\].pose: .*not on the surface"),
        ({8: 0.11}, r"objects\[0\] and objects\[1\] overlap around \(0.105, 0.100\)"),
        ({8: 0.0, 9: -0.24}, r"objects\[1\] and the palm overlap"),
        ({3: 0.09}, "start.opening: .*0.085"),
        ({3: -1e-9}, "start.opening: "),
        ({3: np.nan}, "start.opening: .*nan"),
        ({4: 0.5}, "start.closed: is 0.5"),
        ({0: np.inf}, "start.pose: .*finite"),
    ],
)
def test_errors_name_the_field(changes: dict[int, float], message: str) -> None:
    vector = [0.0, -0.2, 1.57, 0.085, 0.0, 0.1, 0.1, 0.0, -0.1, 0.1, 0.0]
    check_start(SCENE, State(vector))
    for index, value in changes.items():
        vector[index] = value
    with pytest.raises(SceneError, match=message):
        check_start(SCENE, State(vector))


def test_another_number_of_objects() -> None:
    with pytest.raises(SceneError, match="1 objects and the scene 2"):
        check_start(SCENE, state((0.1, 0.1, 0.0)))


def test_every_fault_is_reported() -> None:
    scene = Scene(TargetRegion([0.0, 0.0]), (BOX, BOX, BOX))
    start = state((0.1, 0.1, 0.0), (0.1, 0.11, 0.0), (0.3, 0.0, 0.0))
    assert faults(scene, start) == ["objects[2].pose", "objects[1].pose"]


def test_many_faults_make_a_short_message() -> None:
    scene = Scene(TargetRegion([0.0, 0.0]), (BOX,) * 300)
    with pytest.raises(SceneError) as caught:
        check_start(scene, state(*[(0.1, 0.1, 0.0)] * 300))
    assert len(str(caught.value)) < 2000 and "more faults" in str(caught.value)
