"""Objects of the cell: what stands and lies on the table, with physics that the planner does not know."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.simulated_cell.solids import Revolution, Solid, bottle, box, cup, fruit
from visualrhp.errors import SceneError
from visualrhp.types import FloatArray, ObjectSize

Rgb = tuple[float, float, float]
"""Red, green and blue, from 0 to 1."""

DENSITIES: dict[Kind, tuple[float, float]] = {
    Kind.APPLE: (750.0, 900.0),
    Kind.ORANGE: (750.0, 950.0),
    Kind.CUP: (120.0, 450.0),
    Kind.BOTTLE: (150.0, 900.0),
    Kind.BOX: (150.0, 450.0),
}
"""Mass over volume [kg/m^3]: fruit floats on water; cups are empty, bottles and boxes empty to nearly full."""

FRICTION: tuple[float, float] = (0.22, 0.45)
"""Range of the Coulomb coefficient against the table: fruit skin, plastic, ceramics and cardboard on wood."""

ROLLING_FRICTION: tuple[float, float] = (0.0010, 0.0025)
"""Range of the lever of the rolling resistance [m]: a ball of 36 mm that rolls at 0.15 m/s stops after 3 to 8 cm."""


@dataclass(frozen=True)
class CellObject:
    """An object of the cell.

    Attributes:
        kind: what it is.
        solid: its shape.
        is_lying: whether it starts on its side.
        mass: [kg].
        friction: Coulomb coefficient against the table and other objects.
        rolling_friction: lever of the rolling resistance [m].
        look: seed of its texture.
        colour: main colour; None for one that is drawn from ``look``.

    Raises:
        SceneError: mass or friction is not positive.
    """

    kind: Kind
    solid: Solid
    is_lying: bool = False
    mass: float = 0.2
    friction: float = 0.3
    rolling_friction: float = 0.0015
    look: int = 0
    colour: Rgb | None = None

    def __post_init__(self) -> None:
        for name in ("mass", "friction", "rolling_friction"):
            if not getattr(self, name) > 0.0:
                raise SceneError(f"an object's {name} must be positive, not {getattr(self, name)!r:.60}")

    def rotation(self, yaw: float) -> FloatArray:
        """[3, 3] of the body frame in the world frame, at the start.

        Args:
            yaw: rotation about the vertical [rad]; of a lying object the direction of its axis.
        """
        c, s = np.cos(yaw), np.sin(yaw)
        about_vertical = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        if not self.is_lying:
            return about_vertical
        return about_vertical @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])

    def lies(self, rotation: FloatArray) -> bool:
        """Whether a bottle or a cup lies on its side, rotated by ``rotation`` [3, 3]; other kinds never do."""
        return self.kind in (Kind.BOTTLE, Kind.CUP) and abs(float(rotation[2, 2])) < math.sqrt(0.5)


def volume(solid: Solid) -> float:
    """[m^3]."""
    if not isinstance(solid, Revolution):
        return 8.0 * float(np.prod(solid.half_extents))
    z, radius = np.array(solid.profile).T
    return float((np.pi / 3.0 * np.diff(z) * (radius[1:] ** 2 + radius[1:] * radius[:-1] + radius[:-1] ** 2)).sum())


def sample_object(
    kind: Kind,
    size: ObjectSize,
    rng: np.random.Generator,
    lying: bool | None = None,
    friction: tuple[float, float] = FRICTION,
    rolling_friction: tuple[float, float] = ROLLING_FRICTION,
    mass_factor: tuple[float, float] = (1.0, 1.0),
) -> CellObject:
    """An object of ``kind`` with random size, physics and look.

    Args:
        kind: what it is.
        size: ``small`` objects fit between the fingers (85 mm) from any direction, unless they are boxes or lying
            bottles, which do from some; ``large`` ones do not, or only from some directions; ``mixed`` is either.
        rng: source of the random numbers.
        lying: whether a bottle lies; None: half of them do.
        friction: range of the Coulomb coefficient.
        rolling_friction: range of the lever of the rolling resistance [m].
        mass_factor: range of a factor on the mass.
    """
    large = bool(rng.random() < 0.5) if size == "mixed" else size == "large"
    is_lying = kind is Kind.BOTTLE and (bool(rng.random() < 0.5) if lying is None else lying)
    solid = _sample_solid(kind, large, rng)
    return CellObject(
        kind,
        solid,
        is_lying,
        mass=float(rng.uniform(*DENSITIES[kind]) * rng.uniform(*mass_factor)) * volume(solid),
        friction=float(rng.uniform(*friction)),
        rolling_friction=float(rng.uniform(*rolling_friction)),
        look=int(rng.integers(2**31)),
    )


def _sample_solid(kind: Kind, large: bool, rng: np.random.Generator) -> Solid:
    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    match kind:
        case Kind.APPLE:
            return fruit(between(0.044, 0.050) if large else between(0.030, 0.038), between(0.86, 0.96))
        case Kind.ORANGE:
            return fruit(between(0.038, 0.042) if large else between(0.031, 0.038))
        case Kind.CUP:
            return cup(between(0.080, 0.100), between(0.039, 0.042) if large else between(0.035, 0.039))
        case Kind.BOTTLE:
            return bottle(between(0.033, 0.036) if large else between(0.030, 0.033), between(0.150, 0.200))
        case Kind.BOX:
            half_y = between(0.030, 0.040) if large else between(0.020, 0.030)
            half_x = between(0.040, 0.055) if large else between(0.025, 0.040)
            return box(half_x, half_y, between(0.050, 0.090))
