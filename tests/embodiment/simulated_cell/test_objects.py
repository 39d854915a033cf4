import numpy as np
import pytest

from tests.embodiment.simulated_cell.cells import APPLE, BOX, CUP, LYING_BOTTLE, ORANGE
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.simulated_cell.objects import CellObject, sample_object, volume
from visualrhp.embodiment.simulated_cell.solids import Revolution, box, fruit
from visualrhp.errors import SceneError


def test_volumes_are_known() -> None:
    assert volume(ORANGE.solid) == pytest.approx(4.0 / 3.0 * np.pi * 0.036**3, rel=0.02)
    assert volume(APPLE.solid) == pytest.approx(0.9 * 4.0 / 3.0 * np.pi * 0.034**3, rel=0.02)
    assert volume(BOX.solid) == pytest.approx(0.07 * 0.05 * 0.07)
    r, h = 0.038, 0.09
    assert volume(CUP.solid) == pytest.approx(np.pi * h / 3.0 * (r**2 + 0.8 * r**2 + 0.64 * r**2))


def test_a_lying_object_points_where_its_yaw_says() -> None:
    for yaw in (-2.0, 0.0, 0.7):
        assert LYING_BOTTLE.rotation(yaw)[:, 2] == pytest.approx([np.cos(yaw), np.sin(yaw), 0.0])
        assert CUP.rotation(yaw)[:, 2] == pytest.approx([0.0, 0.0, 1.0])
        for thing in (LYING_BOTTLE, CUP):
            assert thing.rotation(yaw) @ thing.rotation(yaw).T == pytest.approx(np.eye(3))
            assert np.linalg.det(thing.rotation(yaw)) == pytest.approx(1.0)


def test_bottles_and_cups_lie_on_their_side_and_fruit_and_boxes_do_not() -> None:
    lying = LYING_BOTTLE.rotation(0.3)
    assert [thing.lies(lying) for thing in (LYING_BOTTLE, CUP, APPLE, ORANGE, BOX)] == [True, True, False, False, False]
    assert not CUP.lies(np.eye(3))


@pytest.mark.parametrize("kind", Kind)
@pytest.mark.parametrize("size", ["small", "large", "mixed"])
def test_sizes_are_those_of_real_things(kind, size) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        thing = sample_object(kind, size, rng)
        assert thing.kind is kind
        assert thing.is_lying <= (kind is Kind.BOTTLE)
        assert 0.02 < thing.mass < 1.0
        assert 0.05 <= thing.solid.height <= 0.2 or kind in (Kind.APPLE, Kind.ORANGE)
        if isinstance(thing.solid, Revolution):
            assert 0.03 <= thing.solid.radius <= 0.05
        if size == "small":
            width = (
                2.0 * thing.solid.radius if isinstance(thing.solid, Revolution) else 2.0 * thing.solid.half_extents[1]
            )
            assert width < 0.08, "fits between the fingers"


def test_physics_are_drawn_from_the_ranges_given() -> None:
    rng = np.random.default_rng(0)
    things = [
        sample_object(Kind.BOX, "small", rng, friction=(0.1, 0.2), rolling_friction=(1e-3, 1e-3)) for _ in range(20)
    ]
    assert all(0.1 <= thing.friction <= 0.2 and thing.rolling_friction == 1e-3 for thing in things)
    light = sample_object(Kind.BOX, "small", np.random.default_rng(1), mass_factor=(0.5, 0.5))
    heavy = sample_object(Kind.BOX, "small", np.random.default_rng(1), mass_factor=(1.0, 1.0))
    assert light.mass == pytest.approx(0.5 * heavy.mass)


def test_objects_are_functions_of_the_random_numbers() -> None:
    assert sample_object(Kind.CUP, "mixed", np.random.default_rng(3)) == sample_object(
        Kind.CUP, "mixed", np.random.default_rng(3)
    )


@pytest.mark.parametrize("name", ["mass", "friction", "rolling_friction"])
def test_physics_that_cannot_be_are_refused(name) -> None:
    with pytest.raises(SceneError, match=f"{name} must be positive"):
        CellObject(Kind.BOX, box(0.03, 0.03, 0.05), **{name: 0.0})
    with pytest.raises(SceneError, match=f"{name} must be positive"):
        CellObject(Kind.APPLE, fruit(0.03), **{name: float("nan")})
