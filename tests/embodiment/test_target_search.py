"""The printed disc is found in synthetic images: any colours, covered in part, through a distorted lens."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from tests.embodiment.seen_bodies import CIRCLE, painted, top_camera
from visualrhp.embodiment.target_search import TargetSearch, find_target
from visualrhp.errors import ConfigError, PerceptionError
from visualrhp.scene.scene import square_edges

EDGES = square_edges(0.5)
ANY = TargetSearch(colour=None)


def on_table(camera, ring):
    return shapely.Polygon(camera.project(np.column_stack([ring, np.zeros(len(ring))])))


def picture(camera, centre, disc=(200, 40, 30), table=(150, 140, 120), noise=3.0, seed=0):
    image = np.full((camera.height, camera.width, 3), 60.0)
    image[painted(camera, on_table(camera, EDGES))] = table
    image[painted(camera, on_table(camera, np.asarray(centre) + 0.07 * CIRCLE))] = disc
    image += np.random.default_rng(seed).normal(0.0, noise, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.17, 0.11), (-0.17, -0.15)])
@pytest.mark.parametrize(("disc", "table"), [((200, 40, 30), (150, 140, 120)), ((240, 240, 240), (90, 60, 40))])
def test_the_centre_is_found_within_a_millimetre(centre, disc, table) -> None:
    camera = top_camera(focal_length=1000.0)
    found = find_target(picture(camera, centre, disc, table), camera, EDGES, search=ANY)
    assert np.abs(found.position - centre).max() < 1e-3
    assert found.score > 0.9
    assert found.visible > 0.9


def test_a_lens_with_distortion_and_a_tilt_displace_nothing() -> None:
    camera = top_camera(focal_length=1000.0, distortion=(0.1, -0.05, 0.002, -0.001, 0.0), look_at=(0.05, -0.03, 0.0))
    found = find_target(picture(camera, (0.1, -0.1)), camera, EDGES, search=ANY)
    assert np.abs(found.position - (0.1, -0.1)).max() < 1.5e-3


def test_a_low_contrast_is_enough() -> None:
    camera = top_camera(focal_length=1000.0)
    image = picture(camera, (0.05, 0.02), disc=(150, 140, 132), table=(150, 140, 120), noise=2.0)
    assert np.abs(find_target(image, camera, EDGES, search=ANY).position - (0.05, 0.02)).max() < 2e-3


def test_what_covers_the_disc_is_left_out() -> None:
    camera = top_camera(focal_length=1000.0)
    image = picture(camera, (0.05, 0.02))
    covered = painted(camera, on_table(camera, np.array([0.09, 0.02]) + 0.05 * CIRCLE))
    image[covered] = (20, 200, 40)
    found = find_target(image, camera, EDGES, covered, ANY)
    assert np.abs(found.position - (0.05, 0.02)).max() < 2e-3
    assert found.visible < 0.9


def test_a_disc_that_touches_the_edge_is_found() -> None:
    camera = top_camera(focal_length=1000.0)
    found = find_target(picture(camera, (0.2, -0.19)), camera, EDGES, search=ANY)
    assert np.abs(found.position - (0.2, -0.19)).max() < 3e-3


def test_a_printed_ring_is_a_region_of_the_template() -> None:
    camera = top_camera(focal_length=1000.0)
    image = picture(camera, (-0.1, 0.1))
    image[painted(camera, on_table(camera, (-0.1, 0.1) + 0.05 * CIRCLE))] = (150, 140, 120)
    found = find_target(image, camera, EDGES, search=TargetSearch(inner=(0.05,), colour=None))
    assert np.abs(found.position - (-0.1, 0.1)).max() < 1.5e-3


def test_a_disc_that_was_found_is_found_again_nearby() -> None:
    camera = top_camera(focal_length=1000.0)
    image = picture(camera, (0.05, 0.02))
    again = find_target(image, camera, EDGES, search=ANY, near=np.array([0.054, 0.017]))
    assert np.abs(again.position - find_target(image, camera, EDGES, search=ANY).position).max() < 5e-4


def test_a_known_colour_tells_the_disc_from_another_one() -> None:
    camera = top_camera(focal_length=1000.0)
    image = picture(camera, (0.1, 0.1), disc=(200, 40, 30))
    other = painted(camera, on_table(camera, np.array([-0.1, -0.1]) + 0.07 * CIRCLE))
    image[other] = (30, 170, 90)
    red, green = (
        find_target(image, camera, EDGES, search=TargetSearch(colour=c)) for c in ((0.9, 0.1, 0.1), (0.1, 0.7, 0.4))
    )
    assert red.position == pytest.approx([0.1, 0.1], abs=2e-3)
    assert green.position == pytest.approx([-0.1, -0.1], abs=2e-3)


def test_no_disc_is_an_error() -> None:
    camera = top_camera(focal_length=1000.0)
    image = picture(camera, (0.0, 0.0), disc=(150, 140, 120))
    with pytest.raises(PerceptionError, match="target disc is not found"):
        find_target(image, camera, EDGES, search=ANY)
    with pytest.raises(PerceptionError, match="cover the surface"):
        find_target(picture(camera, (0.0, 0.0)), camera, EDGES, np.ones((480, 640), dtype=bool))


def test_a_score_is_a_share() -> None:
    with pytest.raises(ConfigError, match=r"least_score=2\.0 is out of range"):
        TargetSearch(least_score=2.0)
    with pytest.raises(ConfigError, match="should be smaller than radius"):
        TargetSearch(inner=(0.08,))
    with pytest.raises(ConfigError, match="is grey, without a hue"):
        TargetSearch(colour=(0.5, 0.5, 0.5))
