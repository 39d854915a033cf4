from dataclasses import replace

import numpy as np
import pytest

from tests.embodiment.simulated_cell.cells import EVERYTHING, ORANGE
from visualrhp.embodiment.simulated_cell.looks import TARGET_RINGS, object_texture, sample_look, surface_texture


@pytest.mark.parametrize("thing", EVERYTHING, ids=lambda thing: thing.kind)
def test_textures_are_functions_of_the_seed(thing) -> None:
    first, again, other = (object_texture(replace(thing, look=seed)) for seed in (1, 1, 2))
    assert first.dtype == np.uint8
    assert first.shape == (64, 64, 3)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("thing", EVERYTHING, ids=lambda thing: thing.kind)
def test_a_given_colour_is_the_main_one(thing) -> None:
    texture = object_texture(replace(thing, colour=(0.1, 0.2, 0.9)))
    blue = (texture[..., 2] > texture[..., 0]) & (texture[..., 2] > texture[..., 1])
    assert blue.mean() > 0.25


def test_oranges_are_orange() -> None:
    for seed in range(20):
        red, green, blue = object_texture(replace(ORANGE, look=seed)).reshape(-1, 3).mean(axis=0)
        assert red > green > blue


def test_surfaces_differ_in_style() -> None:
    textures = [surface_texture(seed) for seed in range(30)]
    assert all(texture.shape == (256, 256, 3) for texture in textures)
    roughness = [np.abs(np.diff(texture.astype(float), axis=0)).mean() for texture in textures]
    assert min(roughness) < 1.0
    assert max(roughness) > 4.0


def test_looks_are_functions_of_the_random_numbers() -> None:
    first, again = (sample_look(np.random.default_rng(5), (1.0, 2.0), (0.3, 0.4)) for _ in range(2))
    assert first == again
    assert 1.0 <= first.noise <= 2.0
    assert 0.3 <= first.blur <= 0.4
    for seed in range(20):
        look = sample_look(np.random.default_rng(seed), (0.0, 0.0), (0.0, 0.0))
        assert 1 <= len(look.lights) <= 3
        assert [light.casts_shadow for light in look.lights] == [True] + [False] * (len(look.lights) - 1)
        assert 0.5 < look.ambient + sum(light.brightness for light in look.lights) < 1.4, "neither dark nor overexposed"


def test_the_target_has_a_dark_ring_around_a_light_disc() -> None:
    (outer, dark), (inner, light) = TARGET_RINGS
    assert outer == pytest.approx(0.07)
    assert inner < outer
    assert sum(dark) < 0.5 < sum(light)
