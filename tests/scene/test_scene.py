"""Shapes and scenes: physical parameters by hand, and errors for what cannot be simulated."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pytest

from visualrhp.errors import SceneError
from visualrhp.scene import Gripper, ObjectShape, Scene, TargetRegion, TaskInstance
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
        (BOX[::-1], "an object's outline runs clockwise"),
        ([*BOX, BOX[0]], "an object's outline repeats its first vertex.*vertex 4"),
        ([BOX[0], [0.0, -0.01], *BOX[1:]], "an object's outline has collinear vertices.*vertex 1"),
        ([[0, 0], [1, 0], [1, 0, 0]], "array of numbers"),
    ],
)
def test_outlines_that_cannot_be_simulated(outline: list[list[float]], message: str) -> None:
    for make in (ObjectShape, ObjectShape.centred):
        with pytest.raises(SceneError, match=message):
            make(outline)


def test_an_outline_is_about_its_centre_of_mass() -> None:
    with pytest.raises(SceneError, match="centre of mass"):
        ObjectShape(np.array(BOX) + 0.01)


def test_the_surface_may_have_a_vertex_within_an_edge() -> None:
    edges = [[-0.2, -0.2], [0.0, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]
    assert len(Scene(TargetRegion([0.0, 0.0]), (ObjectShape(BOX),), edges).edges) == 5


def test_located_says_where_the_centre_of_mass_was() -> None:
    shape, position = ObjectShape.located(np.array(BOX) + (0.3, -0.1))
    assert position == pytest.approx([0.3, -0.1])
    assert shape.outline + position == pytest.approx(np.array(BOX) + (0.3, -0.1))


@pytest.mark.parametrize("parameter", ["density", "friction", "turning_resistance"])
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
    ("start", "opening", "message"),
    [([0, 0, np.nan], 0.05, "not finite"), ([0, 0, 0], 0.086, "opening"), ([0, 0, 0], -1e-9, "opening")],
)
def test_instance_errors(start: list[float], opening: float, message: str) -> None:
    scene = Scene(TargetRegion([0.0, 0.0]), (ObjectShape(BOX),))
    with pytest.raises(SceneError, match=message):
        TaskInstance(scene, State([*start, opening, 0.0, 0.1, 0.0, 0.0]))


@pytest.mark.parametrize("value", [None, "1", True, [1.0], np.nan, np.inf, -1.0, 1j, 10**400, np.zeros(2)], ids=str)
def test_what_is_no_positive_number(value: object) -> None:
    for make in (
        lambda: ObjectShape(BOX, density=value),
        lambda: ObjectShape(BOX, friction=value),
        lambda: TargetRegion([0.0, 0.0], value),
        lambda: Gripper(stroke=value),
        lambda: Gripper(palm_length=value),
    ):
        with pytest.raises(SceneError, match="positive") as caught:
            make()
        assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "value", [None, "a", {"x": 1}, [[0, 0], [1]], [["0", "0"], ["1", "0"], ["0", "1"]], [True] * 3]
)
def test_what_is_no_array_of_numbers(value: object) -> None:
    target, box = TargetRegion([0.0, 0.0]), ObjectShape(BOX)
    for make in (ObjectShape, ObjectShape.centred, TargetRegion, lambda edges: Scene(target, (box,), edges)):
        with pytest.raises(SceneError, match=r"numbers|vertices"):
            make(value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, (ObjectShape(BOX),)), "a scene has a target"),
        ((TargetRegion([0, 0]), None), "no objects"),
        ((TargetRegion([0, 0]), (BOX,)), "a tuple of ObjectShape"),
        ((TargetRegion([0, 0]), "box"), "no objects"),
        ((TargetRegion([0, 0]), [ObjectShape(BOX)], None), "array of numbers"),
    ],
)
def test_what_is_no_scene(arguments: tuple, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Scene(*arguments)


def test_a_convex_outline_collides_as_drawn() -> None:
    assert ObjectShape(BOX).contact_tolerance == 0.0


def test_arrays_are_read_only() -> None:
    shape = ObjectShape(BOX)
    with pytest.raises(ValueError, match="read-only"):
        shape.outline[0, 0] = 1.0


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda scene: pickle.loads(pickle.dumps(scene))])
def test_copies_are_equal_and_read_only(copied: Callable[[Scene], Scene]) -> None:
    scene = Scene(TargetRegion([0.1, 0.0]), (ObjectShape.centred([[0, 0], [0.04, 0], [0.04, 0.03], [0, 0.03]]),))
    assert len(scene.objects[0].convex_parts) == 1  # computed before it is copied
    other = copied(scene)
    assert other == scene
    (shape,) = other.objects
    for array in (other.edges, other.target.position, shape.outline, *shape.convex_parts):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
