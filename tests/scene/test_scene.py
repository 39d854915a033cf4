"""Shapes and scenes: physical parameters by hand, and errors for what cannot be simulated."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.errors import SceneError
from visualrhp.scene import Gripper, ObjectShape, Scene, TargetRegion, TaskInstance, geometry
from visualrhp.scene.polygons import MIN_OBJECT_THICKNESS
from visualrhp.types import State

BOX = [[-0.02, -0.01], [0.02, -0.01], [0.02, 0.01], [-0.02, 0.01]]


def test_box_by_hand() -> None:
    box = ObjectShape(BOX, density=2.0, friction=0.4)
    assert box.area == pytest.approx(8e-4)
    assert box.mass == pytest.approx(1.6e-3)
    assert box.moment_of_inertia == pytest.approx(1.6e-3 * (0.04**2 + 0.02**2) / 12.0)


def test_centred_moves_the_centre_of_mass_to_the_origin() -> None:
    assert ObjectShape.centred(np.array(BOX) + (5.0, -3.0)).outline == pytest.approx(np.array(BOX))


@pytest.mark.parametrize(
    ("outline", "message"),
    [
        ([[0, 0], [1, 0]], "at least three vertices"),
        ([[0, 0], [1, 0], [np.nan, 1]], "not finite"),
        ([[-1, -1], [1, 1], [1, -1], [-1, 1]], r"crosses or touches itself at \(0, 0\)"),
        (BOX[::-1], "counter-clockwise"),
        ([[0, 0], [1, 0], [np.inf, 1]], "not finite.*vertex 2"),
        ([[0, 0], [40, 0], [40, 500]], "metres.*vertex 2"),
        ([[0, 0], [1, 0], [1, 0, 0]], "array of numbers"),
        ([*BOX[:2], BOX[1], *BOX[2:]], "duplicate vertex.*vertex 2"),
        ([*BOX, BOX[0]], "repeats its first vertex.*vertex 4"),
        ([[0, 0], [0.02, 0.02], [0.04, 0.04]], "collinear vertices only"),
        ([BOX[0], [0.0, -0.01], *BOX[1:]], "collinear.*vertex 1"),
        ([[-0.02, 0], [0.02, -1e-5], [0.02, 1e-5]], "area"),
        ([[-0.02, -0.0014], [0.02, -0.0014], [0.02, 0.0014], [-0.02, 0.0014]], "too thin: 2.8 mm"),
        # an L with a leg of 2 mm, and two plates on a bridge of 2 mm
        ([[0, 0], [0.06, 0], [0.06, 0.02], [0.002, 0.02], [0.002, 0.06], [0, 0.06]], "too thin around .*vertex [45]"),
        (
            [[0, 0], [0.02, 0], [0.02, 0.009], [0.024, 0.009], [0.024, 0], [0.044, 0]]
            + [[0.044, 0.02], [0.024, 0.02], [0.024, 0.011], [0.02, 0.011], [0.02, 0.02], [0, 0.02]],
            r"neck around \[0.022",
        ),
        (np.array(BOX) + 0.01, "centre of mass"),
    ],
)
def test_outlines_that_cannot_be_simulated(outline: object, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        ObjectShape(outline)
    if message != "centre of mass":
        with pytest.raises(SceneError, match=message):
            ObjectShape.centred(outline)


def test_thickness_is_that_of_the_least_width() -> None:
    """Just thick enough is enough: a bar, a bar across, a needle, and an L of such arms."""
    t = 1.001 * MIN_OBJECT_THICKNESS
    for outline in (
        [[0, 0], [0.1, 0], [0.1, t], [0, t]],
        np.array([[0, 0], [0.1, 0], [0.1, t], [0, t]]) @ geometry.rotation_matrix(0.7).T,
        [[0, 0], [0.1, 0], [0, t * 1.001]],
        [[0, 0], [0.06, 0], [0.06, t], [t, t], [t, 0.06], [0, 0.06]],
    ):
        ObjectShape.centred(outline)


def test_the_surface_may_have_a_vertex_within_an_edge() -> None:
    edges = [[-0.2, -0.2], [0.0, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]
    assert len(Scene(TargetRegion([0.0, 0.0]), (ObjectShape(BOX),), edges).edges) == 5


def test_located_says_where_the_centre_of_mass_was() -> None:
    shape, position = ObjectShape.located(np.array(BOX) + (0.3, -0.1))
    assert position == pytest.approx([0.3, -0.1])
    assert shape.outline + position == pytest.approx(np.array(BOX) + (0.3, -0.1))


@pytest.mark.parametrize("parameter", ["density", "friction"])
def test_parameters_must_be_positive(parameter: str) -> None:
    with pytest.raises(SceneError, match=parameter):
        ObjectShape(BOX, **{parameter: 0.0})


def test_scene_errors() -> None:
    with pytest.raises(SceneError, match="no objects"):
        Scene(TargetRegion([0.0, 0.0]), ())
    with pytest.raises(SceneError, match="not within the edges"):
        Scene(TargetRegion([0.3, 0.0]), (ObjectShape(BOX),))
    with pytest.raises(SceneError, match="radius"):
        TargetRegion([0.0, 0.0], 0.0)


def test_instance_needs_a_pose_for_every_object() -> None:
    scene = Scene(TargetRegion([0.0, 0.0]), (ObjectShape(BOX),))
    with pytest.raises(SceneError, match="2 objects and the scene 1"):
        TaskInstance(scene, State.create([0, 0, 0], 0.085, False, np.zeros((2, 3))))


@pytest.mark.parametrize(
    ("robot", "opening", "message"),
    [([0, 0, np.nan], 0.05, "not finite"), ([0, 0, 0], 0.086, "opening"), ([0, 0, 0], -1e-9, "opening")],
)
def test_instance_errors(robot: list[float], opening: float, message: str) -> None:
    scene = Scene(TargetRegion([0.0, 0.0]), (ObjectShape(BOX),))
    with pytest.raises(SceneError, match=message):
        TaskInstance(scene, State([*robot, opening, 0.0, 0.1, 0.0, 0.0]))


@pytest.mark.parametrize(
    "parameters", [{"stroke": 0.2}, {"stroke": 0.0}, {"palm_length": -0.1}, {"finger_reach": np.nan}]
)
def test_gripper_errors(parameters: dict[str, float]) -> None:
    with pytest.raises(SceneError, match=next(iter(parameters))):
        Gripper(**parameters)


def test_arrays_are_read_only() -> None:
    shape = ObjectShape(BOX)
    with pytest.raises(ValueError, match="read-only"):
        shape.outline[0, 0] = 1.0
