"""Objects at random places: apart, on the surface, and the same as without the shortcuts."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from visualrhp.scene import Gripper, SceneDistribution, TargetRegion, geometry
from visualrhp.scene.placement import CORNER_DISTANCE, place_objects, sample_position
from visualrhp.scene.scene import square_edges
from visualrhp.types import FloatArray

EDGES = square_edges(0.5)
TARGET = TargetRegion([0.1, 0.1])


def outlines_of(count: int, radius: float, rng: np.random.Generator) -> list[FloatArray]:
    angles = 2.0 * np.pi * np.arange(6) / 6
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return [radius * float(rng.uniform(0.5, 1.0)) * circle * (1.0, 0.6) for _ in range(count)]


def placed_by_hand(
    distribution: SceneDistribution, outlines: list[FloatArray], obstacles: list[FloatArray], rng: np.random.Generator
) -> FloatArray | None:
    """Rejection sampling to the letter, without circles."""
    surface = shapely.Polygon(EDGES).buffer(-distribution.clearance)
    occupied = [shapely.Polygon(outline) for outline in obstacles]
    poses = []
    for number, outline in enumerate(outlines):
        for _ in range(100):
            pose = np.array([rng.uniform(-0.25, 0.25), rng.uniform(-0.25, 0.25), rng.uniform(-np.pi, np.pi)])
            if number == 0 and np.hypot(*(pose[:2] - TARGET.position)) <= TARGET.radius:
                continue
            body = shapely.Polygon(geometry.to_world(outline, pose))
            if surface.contains(body) and all(body.distance(o) >= distribution.clearance for o in occupied):
                occupied.append(body)
                poses.append(pose)
                break
        else:
            return None
    return np.array(poses)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("clearance", [0.005, 0.02])
def test_the_circles_decide_nothing_else(seed: int, clearance: float) -> None:
    rng = np.random.default_rng(seed)
    distribution = SceneDistribution(num_objects=8, clearance=clearance)
    outlines = outlines_of(int(rng.integers(3, 12)), 0.07, rng)
    obstacles = list(Gripper().outlines([0.0, -0.2, 1.5], 0.085))
    poses = place_objects(distribution, outlines, EDGES, TARGET, obstacles, np.random.default_rng(seed))
    expected = placed_by_hand(distribution, outlines, obstacles, np.random.default_rng(seed))
    assert (poses is None) == (expected is None)
    if poses is not None and expected is not None:
        assert np.array_equal(poses, expected)


def test_what_does_not_fit_has_no_place() -> None:
    distribution, rng = SceneDistribution(), np.random.default_rng(0)
    assert place_objects(distribution, outlines_of(1, 2.0, rng), EDGES, TARGET, [], rng) is None
    assert place_objects(distribution, outlines_of(200, 0.06, rng), EDGES, TARGET, [], rng) is None


def test_the_desired_object_is_in_a_corner_if_the_layout_says_so() -> None:
    distribution = SceneDistribution(layout="object_in_corner")
    for seed in range(10):
        rng = np.random.default_rng(seed)
        poses = place_objects(distribution, outlines_of(3, 0.03, rng), EDGES, TARGET, [], rng)
        if poses is not None:
            assert np.linalg.norm(EDGES - poses[0, :2], axis=1).min() <= CORNER_DISTANCE


def test_positions_are_uniform_over_the_surface() -> None:
    rng = np.random.default_rng(0)
    samples = np.array([sample_position(-0.25, 0.25, rng) for _ in range(2000)])
    assert ((samples >= -0.25) & (samples < 0.25)).all()
    assert np.abs(samples.mean(axis=0)).max() < 0.02
