"""A heuristic with scripted values and actions, and a clock that is advanced explicitly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tests.planning.conftest import cell_of
from visualrhp.heuristics.heuristic import Guidance, Heuristic
from visualrhp.scene import Scene
from visualrhp.types import Action, ActionSpaceName, State

STAY = 2


def cells(states: Sequence[State]) -> list[int]:
    return [cell_of(state) for state in states]


class ScriptedGuidance(Guidance):
    """Draws actions from a script, or at random without one."""

    def __init__(self, script: list[Action] | None, values: np.ndarray) -> None:
        self._script = script
        self.values = values

    def sample(self, rngs: Sequence[np.random.Generator]) -> list[Action]:
        if self._script is None:
            return [int(rng.integers(3)) for rng in rngs]
        return [self._script.pop(0) for _ in rngs]

    def mode(self) -> list[Action]:
        return [STAY] * len(self.values)

    def take(self, rows: Sequence[int]) -> Guidance:
        return ScriptedGuidance(self._script, self.values[list(rows)])

    def widened(self, factor: float) -> Guidance:
        return self


class ScriptedHeuristic(Heuristic):
    """v(cell) from a table. ``script``: actions in the order of drawing: the first of all roll-outs first."""

    action_space: ActionSpaceName = "discrete"

    def __init__(self, values: dict[int, float], script: Sequence[Action] | None = None) -> None:
        self._values = values
        self._script = None if script is None else list(script)
        self.calls: list[list[int]] = []

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        assert len(scenes) == len(states)
        self.calls.append(cells(states))
        return ScriptedGuidance(self._script, np.array([self._values.get(cell, 0.0) for cell in cells(states)]))


class Clock:
    """Stands still but for :meth:`spend`."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def spend(self, seconds: float, function: Callable[..., Any]) -> Callable[..., Any]:
        """``function``, which from now on takes that long."""

        def slow(*arguments: Any) -> Any:
            self.now += seconds
            return function(*arguments)

        return slow
