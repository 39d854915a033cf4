"""Named set-ups of the cell, after those that the paper shows on its robot (Fig. 1 and 11 to 16).

The paper prints photographs, no measures: objects, their number and what has to be done are the paper's, the places are
ours.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.simulated_cell.looks import CellLook, Light
from visualrhp.embodiment.simulated_cell.objects import DENSITIES, CellObject, Rgb, volume
from visualrhp.embodiment.simulated_cell.solids import Solid, bottle, box, cup, fruit
from visualrhp.embodiment.simulated_cell.task import CellTask
from visualrhp.errors import ConfigError
from visualrhp.scene.scene import TargetRegion

_Placed = tuple[CellObject, float, float, float]

_LOOK: Final = CellLook(table=14, floor=16, ambient=0.5, lights=(Light((0.15, 0.2, -1.0), 0.45),))

_UP: Final = 0.5 * math.pi
_RED: Final = (0.75, 0.12, 0.10)
_GREEN: Final = (0.45, 0.65, 0.20)


def _placed(
    kind: Kind,
    solid: Solid,
    x: float,
    y: float,
    degrees: float = 0.0,
    *,
    lying: bool = False,
    look: int = 0,
    colour: Rgb | None = None,
) -> _Placed:
    mass = sum(DENSITIES[kind]) / 2.0 * volume(solid)
    return CellObject(kind, solid, lying, mass, look=look, colour=colour), x, y, math.radians(degrees)


def _task(target: tuple[float, float], gripper_pose: tuple[float, float, float], *placed: _Placed) -> CellTask:
    objects = tuple(thing for thing, *_ in placed)
    poses = np.array([pose for _, *pose in placed])
    return CellTask(objects, poses, TargetRegion(np.array(target)), gripper_pose, look=_LOOK)


def _low_clutter() -> CellTask:
    return _task(
        (0.13, 0.12),
        (-0.02, -0.22, _UP),
        _placed(Kind.ORANGE, fruit(0.034), 0.01, 0.02),
        _placed(Kind.APPLE, fruit(0.036, 0.9), -0.13, 0.08, colour=_RED),
        _placed(Kind.BOTTLE, bottle(0.032, 0.17), 0.13, -0.08, 60.0, lying=True, look=3),
    )


def _high_clutter() -> CellTask:
    return _task(
        (0.13, 0.14),
        (-0.02, -0.22, _UP),
        _placed(Kind.ORANGE, fruit(0.034), 0.00, 0.06),
        _placed(Kind.BOTTLE, bottle(0.032, 0.17), 0.00, -0.04, 20.0, lying=True, look=3),
        _placed(Kind.APPLE, fruit(0.036, 0.9), 0.19, 0.02, colour=_RED),
        _placed(Kind.APPLE, fruit(0.035, 0.9), -0.10, 0.12, colour=_GREEN),
        _placed(Kind.CUP, cup(0.09, 0.037), -0.17, 0.00, look=5),
        _placed(Kind.ORANGE, fruit(0.035), 0.17, -0.10),
        _placed(Kind.BOX, box(0.035, 0.025, 0.07), -0.17, -0.13, 30.0, look=2),
    )


def _two_strategies() -> CellTask:
    return _task(
        (-0.14, -0.12),
        (0.06, -0.22, _UP),
        _placed(Kind.BOTTLE, bottle(0.032, 0.18), 0.08, 0.09, 150.0, lying=True, look=3),
        _placed(Kind.APPLE, fruit(0.037, 0.9), 0.05, -0.06, colour=_RED),
    )


def _apple(radius: float) -> CellTask:
    return _task(
        (-0.12, -0.10),
        (0.03, -0.22, _UP),
        _placed(Kind.APPLE, fruit(radius, 0.9), 0.05, 0.13, colour=_RED),
        _placed(Kind.BOTTLE, bottle(0.032, 0.17), -0.07, 0.03, 100.0, lying=True, look=3),
        _placed(Kind.ORANGE, fruit(0.035), 0.16, 0.03),
        _placed(Kind.CUP, cup(0.09, 0.037), 0.05, -0.01, look=5),
        _placed(Kind.BOX, box(0.035, 0.025, 0.07), 0.17, -0.11, 70.0, look=2),
    )


def _bottle() -> CellTask:
    return _task(
        (0.13, 0.14),
        (-0.05, -0.22, _UP),
        _placed(Kind.BOTTLE, bottle(0.032, 0.18), -0.05, 0.02, 10.0, lying=True, look=3),
        _placed(Kind.APPLE, fruit(0.036, 0.9), 0.14, -0.06, colour=_RED),
        _placed(Kind.ORANGE, fruit(0.035), -0.14, 0.15),
    )


def _surrounded() -> CellTask:
    return _task(
        (0.02, 0.16),
        (0.0, -0.22, _UP),
        _placed(Kind.BOTTLE, bottle(0.032, 0.17), 0.0, 0.04, 5.0, lying=True, look=3),
        _placed(Kind.APPLE, fruit(0.046, 0.92), 0.0, -0.07, colour=_GREEN),
        _placed(Kind.ORANGE, fruit(0.036), -0.12, -0.04),
        _placed(Kind.CUP, cup(0.09, 0.038), 0.13, -0.03, look=5),
        _placed(Kind.BOX, box(0.040, 0.030, 0.08), -0.17, 0.08, 80.0, look=2),
        _placed(Kind.APPLE, fruit(0.036, 0.9), 0.17, 0.09, colour=_RED),
    )


def _squeeze() -> CellTask:
    return _task(
        (0.14, -0.12),
        (-0.05, -0.22, _UP),
        _placed(Kind.ORANGE, fruit(0.034), -0.05, 0.14),
        _placed(Kind.BOX, box(0.045, 0.030, 0.08), -0.12, 0.01, 90.0, look=2),
        _placed(Kind.CUP, cup(0.09, 0.038), 0.02, 0.02, look=5),
        _placed(Kind.APPLE, fruit(0.046, 0.92), 0.12, 0.06, colour=_RED),
        _placed(Kind.BOTTLE, bottle(0.032, 0.17), 0.09, 0.18, 0.0, lying=True, look=3),
        _placed(Kind.APPLE, fruit(0.036, 0.9), -0.18, 0.14, colour=_GREEN),
    )


_SCENARIOS: Final[dict[str, tuple[str, Callable[[], CellTask]]]] = {
    "low_clutter": ("Fig. 11: an orange among few objects", _low_clutter),
    "high_clutter": ("Fig. 12: an orange among many objects", _high_clutter),
    "two_strategies": ("Fig. 13: a bottle, behind an apple", _two_strategies),
    "small_object": ("Fig. 14, top: an apple that fits between the fingers", lambda: _apple(0.033)),
    "large_object": ("Fig. 14, bottom: an apple that does not", lambda: _apple(0.049)),
    "bottle": ("Fig. 15: a bottle, for discrete and continuous actions", _bottle),
    "surrounded": ("Fig. 16: a bottle with little room around it", _surrounded),
    "squeeze": ("Fig. 1: an orange behind a narrow gap", _squeeze),
}

SCENARIOS: Final[dict[str, str]] = {name: description for name, (description, _) in _SCENARIOS.items()}
"""Names, and what they are."""


def scenario(name: str) -> CellTask:
    """The set-up called ``name``, one of :data:`SCENARIOS`; the desired object comes first.

    Raises:
        ConfigError: there is no such set-up.
    """
    if name not in _SCENARIOS:
        raise ConfigError(f"scenario={name!r:.60}: choose one of {', '.join(_SCENARIOS)}.")
    return _SCENARIOS[name][1]()
