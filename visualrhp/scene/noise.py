"""Noise on the parameters of the objects and on their poses: a world that differs from the model (paper, Sec. 8.2)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from visualrhp.errors import SceneError
from visualrhp.scene import geometry
from visualrhp.scene.contours import MAX_EXACT_VERTICES, is_number
from visualrhp.scene.scene import ObjectShape, Scene
from visualrhp.types import Column, State, wrap_angle

NoiseLevel = Literal["none", "low", "medium", "high"]

NOISE_LEVELS: dict[NoiseLevel, float] = {"none": 0.0, "low": 0.01, "medium": 0.03, "high": 0.05}
"""Relative standard deviation of each noise level (footnote 7)."""

_ATTEMPTS = 1000
_ATTEMPTS_OF_MANY_VERTICES = 20  # of outlines that take long to check
_MAX_STD = 100.0


def perturb(scene: Scene, relative_std: float, rng: np.random.Generator, turning_std: float = 0.0) -> Scene:
    """Sample a scene whose objects' parameters are Gaussian around those of ``scene``.

    The distance of every vertex from the centre of mass, and the friction and density of every object, are sampled
    independently, with a standard deviation of ``relative_std`` times the mean; then its resistance to turning, with
    ``turning_std`` (not in the paper). Edges and target do not change; masses follow. A convex outline stays convex: a
    vertex within the hull of the others is removed. Any other outline stays simple: if it crosses itself or is too
    thin, its vertices are sampled again. The body frame moves with the centre of mass, so that poses keep their
    meaning.

    Raises:
        SceneError: a standard deviation is negative or not finite, or so large that no valid outline is found.
    """
    for std in (relative_std, turning_std):
        if not (is_number(std) and 0.0 <= std <= _MAX_STD):
            raise SceneError(
                f"the relative standard deviation of the noise is {std!r:.100}; it must not be negative, nor above "
                f"{_MAX_STD:g}"
            )
    objects = scene.objects
    if relative_std > 0.0:
        objects = tuple(_perturb_object(shape, relative_std, rng) for shape in objects)
    if turning_std > 0.0:
        objects = tuple(
            replace(shape, turning_resistance=shape.turning_resistance * _positive_factor(turning_std, rng))
            for shape in objects
        )
    if objects is scene.objects:
        return scene
    return Scene(scene.target, objects, scene.edges, scene.gripper)


def perturb_poses(state: State, position_std: float, angle_std: float, rng: np.random.Generator) -> State:
    """Sample a state whose objects' poses are Gaussian around those of ``state``, as a camera sees them.

    Args:
        state: the observed state.
        position_std: of x and of y [m].
        angle_std: [rad].
        rng: source of the random numbers.
    """
    vector = state.vector.copy()
    errors = rng.standard_normal((state.num_objects, 3)) * (position_std, position_std, angle_std)
    vector[Column.OBJECTS] += errors.ravel()
    vector[Column.OBJECTS_THETA] = wrap_angle(vector[Column.OBJECTS_THETA])
    return State(vector)


def _perturb_object(shape: ObjectShape, relative_std: float, rng: np.random.Generator) -> ObjectShape:
    density = shape.density * _positive_factor(relative_std, rng)
    friction = shape.friction * _positive_factor(relative_std, rng)
    convex = geometry.is_convex(shape.outline)
    many = len(shape.outline) > MAX_EXACT_VERTICES
    for _ in range(_ATTEMPTS_OF_MANY_VERTICES if many else _ATTEMPTS):
        outline = shape.outline * (1.0 + relative_std * rng.standard_normal((len(shape.outline), 1)))
        try:
            centred = ObjectShape.centred(geometry.convex_hull(outline) if convex else outline, density, friction)
            return replace(centred, turning_resistance=shape.turning_resistance)
        except SceneError:  # not a simple polygon, or too thin: sample its vertices again
            continue
    advice = "; reduce their number with ObjectShape.from_contour" if many else ""
    raise SceneError(
        f"noise of relative standard deviation {relative_std:g} leaves no valid outline of an object of "
        f"{len(shape.outline)} vertices{advice}"
    )


def _positive_factor(relative_std: float, rng: np.random.Generator) -> float:
    """1 + relative_std * N(0, 1), sampled again if not positive."""
    for _ in range(_ATTEMPTS):  # at least every other one is positive
        factor = 1.0 + relative_std * rng.standard_normal()
        if factor > 0.0:
            return float(factor)
    raise SceneError(f"noise of relative standard deviation {relative_std:g} gives no positive parameter")
