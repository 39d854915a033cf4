"""Noise levels of Sec. 8.2: the spread of each parameter is what the level says, and masses follow."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.errors import SceneError
from visualrhp.scene import NOISE_LEVELS, ObjectShape, Scene, TargetRegion, perturb

HEXAGON = 0.03 * np.stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3)], axis=1)


@pytest.fixture
def scene() -> Scene:
    return Scene(TargetRegion([0.1, 0.1]), (ObjectShape.centred(HEXAGON), ObjectShape.centred(HEXAGON, 2.0, 0.5)))


def test_levels_are_those_of_footnote_7() -> None:
    assert NOISE_LEVELS == {"none": 0.0, "low": 0.01, "medium": 0.03, "high": 0.05}


@pytest.mark.parametrize("level", [0.01, 0.03, 0.05])
def test_spread_is_the_level(scene: Scene, level: float) -> None:
    rng = np.random.default_rng(0)
    noisy = [perturb(scene, level, rng).objects[1] for _ in range(800)]
    for values, mean in (([o.density for o in noisy], 2.0), ([o.friction for o in noisy], 0.5)):
        assert np.mean(values) == pytest.approx(mean, rel=level * 0.15)
        assert np.std(values) == pytest.approx(level * mean, rel=0.1)
    # a hexagon stays convex at these levels: every vertex's distance spreads by the level
    radii = np.array([np.hypot(*o.outline.T) for o in noisy if len(o.outline) == 6])
    assert len(radii) > 700
    assert np.std(radii) == pytest.approx(level * 0.03, rel=0.2)


def test_mass_follows_shape_and_density(scene: Scene) -> None:
    noisy = perturb(scene, 0.05, np.random.default_rng(1)).objects[0]
    assert noisy.mass == pytest.approx(noisy.density * noisy.area)
    assert noisy.mass != pytest.approx(scene.objects[0].mass, rel=1e-6)


def test_no_noise_is_the_same_scene_and_a_seed_is_the_same_noise(scene: Scene) -> None:
    assert perturb(scene, 0.0, np.random.default_rng(0)) is scene
    assert perturb(scene, 0.03, np.random.default_rng(2)) == perturb(scene, 0.03, np.random.default_rng(2))
    with pytest.raises(SceneError, match="negative"):
        perturb(scene, -0.1, np.random.default_rng(0))
