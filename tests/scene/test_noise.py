"""Noise levels of Sec. 8.2: the spread of each parameter is what the level says, and masses follow."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import shapely

from visualrhp.errors import SceneError
from visualrhp.scene import (
    NOISE_LEVELS,
    ObjectShape,
    Scene,
    SceneDistribution,
    TargetRegion,
    geometry,
    perturb,
    sample_task_instance,
)
from visualrhp.scene.noise import perturb_poses
from visualrhp.streams import Split
from visualrhp.types import Column, State, wrap_angle

HEXAGON = 0.03 * np.stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3)], axis=1)
L_SHAPE = [[0, 0], [0.06, 0], [0.06, 0.02], [0.02, 0.02], [0.02, 0.06], [0, 0.06]]
U_SHAPE = [[0, 0], [0.08, 0], [0.08, 0.06], [0.06, 0.06], [0.06, 0.02], [0.02, 0.02], [0.02, 0.06], [0, 0.06]]
STAR = [[np.cos(a) * r, np.sin(a) * r] for a, r in zip(np.arange(60) * np.pi / 30, 30 * [0.05, 0.049], strict=True)]
SHAPES = {"convex": HEXAGON, "L": L_SHAPE, "U": U_SHAPE}
LEVELS = [0.01, 0.03, 0.05]
DRAWS = 900


@pytest.fixture
def scene() -> Scene:
    return Scene(TargetRegion([0.1, 0.1]), (ObjectShape.centred(HEXAGON), ObjectShape.centred(L_SHAPE, 2.0, 0.5)))


def vertex_factors(shape: ObjectShape, noisy: ObjectShape) -> np.ndarray:
    """[V] by what each vertex's distance from the centre of mass was multiplied, before the outline was centred anew.

    With the shift c of the centre, noisy_i = factor_i * v_i - c: 2 V linear equations for V + 2 unknowns, which have
    an exact solution if noise moves every vertex along its ray and does nothing else.
    """
    count = len(shape.outline)
    assert len(noisy.outline) == count
    equations = np.zeros((2 * count, count + 2))
    for i, (x, y) in enumerate(shape.outline):
        equations[2 * i, [i, -2]] = x, -1.0
        equations[2 * i + 1, [i, -1]] = y, -1.0
    solution, *_ = np.linalg.lstsq(equations, noisy.outline.ravel(), rcond=None)
    assert equations @ solution == pytest.approx(noisy.outline.ravel(), abs=1e-12)
    return solution[:count]


def aligned(shape: ObjectShape, noisy: ObjectShape) -> ObjectShape:
    """The convex hull starts at any vertex: number the vertices as those of ``shape``."""
    first = int(np.argmin(np.hypot(*(noisy.outline - shape.outline[0]).T)))
    return ObjectShape(np.roll(noisy.outline, -first, axis=0), noisy.density, noisy.friction)


def test_levels_are_those_of_footnote_7() -> None:
    assert NOISE_LEVELS == {"none": 0.0, "low": 0.01, "medium": 0.03, "high": 0.05}


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", list(SHAPES))
def test_spread_is_the_level_and_parameters_are_independent(name: str, level: float) -> None:
    """Over N draws, a mean's standard error is level / sqrt(N), a standard deviation's level / sqrt(2 N), and that of
    the correlation of two independent parameters 1 / sqrt(N): all within 5 of those (one in 1.7 million each)."""
    shape = ObjectShape.centred(SHAPES[name], 2.0, 0.5)
    scene = Scene(TargetRegion([0.1, 0.1]), (shape,))
    rng = np.random.default_rng(0)
    draws = []
    for _ in range(DRAWS):
        noisy = perturb(scene, level, rng).objects[0]
        if name == "convex":
            noisy = aligned(shape, noisy)
        draws.append([noisy.density / 2.0, noisy.friction / 0.5, *vertex_factors(shape, noisy)])
    factors = np.array(draws)  # [draws, 2 + V]
    assert np.abs(factors.mean(axis=0) - 1.0).max() < 5.0 * level / np.sqrt(DRAWS)
    assert factors.std(axis=0) == pytest.approx(level, rel=5.0 / np.sqrt(2 * DRAWS))
    correlations = np.corrcoef(factors.T)
    assert max(abs(correlations[i, j]) for i, j in combinations(range(len(correlations)), 2)) < 5.0 / np.sqrt(DRAWS)


@pytest.mark.parametrize("level", LEVELS)
def test_objects_stay_valid_and_in_their_order(scene: Scene, level: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        noisy = perturb(scene, level, rng)
        assert (noisy.target, noisy.gripper) == (scene.target, scene.gripper)
        assert np.array_equal(noisy.edges, scene.edges)
        for before, after in zip(scene.objects, noisy.objects, strict=True):
            assert geometry.is_convex(after.outline) == geometry.is_convex(before.outline)
            assert shapely.Polygon(after.outline).is_valid
            assert after.density == pytest.approx(before.density, rel=8 * level)
            overlap = shapely.intersection(shapely.Polygon(before.outline), shapely.Polygon(after.outline))
            assert overlap.area > (1.0 - 8.0 * level) * before.area, "another object, or another pose"


@pytest.mark.parametrize("number", [0, 1])
def test_mass_follows_shape_and_density(scene: Scene, number: int) -> None:
    noisy = perturb(scene, 0.05, np.random.default_rng(1)).objects[number]
    assert noisy.mass == pytest.approx(noisy.density * shapely.Polygon(noisy.outline).area)
    assert noisy.mass != pytest.approx(scene.objects[number].mass, rel=1e-6)
    assert geometry.centroid(noisy.outline) == pytest.approx([0.0, 0.0], abs=1e-12)


def test_the_random_pool_keeps_its_vertices() -> None:
    """No vertex of a random object ends up within the hull of the others, where it would not count as noise."""
    for index in range(60):
        scene = sample_task_instance(SceneDistribution(), 0, Split.TUNING, index).scene
        noisy = perturb(scene, 0.05, np.random.default_rng(index))
        counts = [[len(shape.outline) for shape in each.objects] for each in (scene, noisy)]
        assert counts[0] == counts[1]


def test_an_outline_that_is_thin_somewhere_stays_thick_enough() -> None:
    """Noise that would make a leg of 3.2 mm too thin is drawn again."""
    t = 0.0032
    shape = ObjectShape.centred([[0, 0], [0.06, 0], [0.06, 0.02], [t, 0.02], [t, 0.06], [0, 0.06]])
    scene = Scene(TargetRegion([0.0, 0.0]), (shape,))
    for seed in range(20):
        assert len(perturb(scene, 0.03, np.random.default_rng(seed)).objects[0].outline) == 6


def test_no_noise_is_the_same_scene_and_a_seed_is_the_same_noise(scene: Scene) -> None:
    assert perturb(scene, 0.0, np.random.default_rng(0)) is scene
    assert perturb(scene, 0.03, np.random.default_rng(2)) == perturb(scene, 0.03, np.random.default_rng(2))
    for level in (-0.1, np.nan, np.inf):
        with pytest.raises(SceneError, match="negative"):
            perturb(scene, level, np.random.default_rng(0))


@pytest.mark.parametrize("level", [None, "0.1", True, 1e6, [0.1]])
def test_what_is_no_level(scene: Scene, level: object) -> None:
    with pytest.raises(SceneError, match="standard deviation of the noise is"):
        perturb(scene, level, np.random.default_rng(0))


def test_noise_that_leaves_no_outline_ends() -> None:
    """Hundreds of vertices, each at another distance, make a rough outline whatever the sample."""
    angles = np.linspace(0.0, 2.0 * np.pi, 900, endpoint=False)
    dense = ((0.045 + 0.012 * np.cos(3 * angles)) * np.array([np.cos(angles), np.sin(angles)])).T
    scene = Scene(TargetRegion([0.0, 0.0]), (ObjectShape.centred(dense),))
    with pytest.raises(
        SceneError, match=r"deviation 0.05 leaves no valid outline .* 900 vertices; reduce their number"
    ):
        perturb(scene, 0.05, np.random.default_rng(0))
    with pytest.raises(SceneError, match="no valid outline"):
        perturb(Scene(TargetRegion([0.0, 0.0]), (ObjectShape.centred(STAR),)), 5.0, np.random.default_rng(0))


# ------------------------------------------------------------------------- how the surface resists turning, and poses
def test_turning_resistance_is_perturbed_apart(scene: Scene) -> None:
    """Its noise does not change the other random numbers, and nothing but this factor."""
    without = perturb(scene, 0.03, np.random.default_rng(2))
    noisy = perturb(scene, 0.03, np.random.default_rng(2), turning_std=0.2)
    for one, other in zip(without.objects, noisy.objects, strict=True):
        assert replace(other, turning_resistance=1.0) == one and other.turning_resistance != 1.0
    factors = [
        perturb(scene, 0.0, np.random.default_rng(seed), turning_std=0.2).objects[0].turning_resistance
        for seed in range(2000)
    ]
    assert np.mean(factors) == pytest.approx(1.0, abs=0.02) and np.std(factors) == pytest.approx(0.2, rel=0.06)
    again = perturb(noisy, 0.03, np.random.default_rng(3))
    assert [s.turning_resistance for s in again.objects] == [s.turning_resistance for s in noisy.objects]
    with pytest.raises(SceneError, match="negative"):
        perturb(scene, 0.0, np.random.default_rng(0), turning_std=-0.1)


def test_only_the_poses_of_objects_are_perturbed() -> None:
    state = State.create([0.1, 0.2, 3.0], 0.05, True, [[0.0, 0.1, 3.14], [0.2, -0.1, 0.0]])
    rng = np.random.default_rng(0)
    samples = np.array([perturb_poses(state, 0.004, 0.05, rng).vector for _ in range(4000)])
    assert (samples[:, : Column.OBJECTS.start] == state.vector[: Column.OBJECTS.start]).all()
    errors = samples[:, Column.OBJECTS].reshape(-1, 2, 3) - state.object_poses
    errors[..., 2] = wrap_angle(errors[..., 2])
    assert np.abs(samples[:, Column.OBJECTS_THETA]).max() <= np.pi
    assert errors.std(axis=0) == pytest.approx(np.array([[0.004, 0.004, 0.05]] * 2), rel=0.05)
    assert np.abs(errors.mean(axis=0) / (0.004, 0.004, 0.05)).max() < 0.08
