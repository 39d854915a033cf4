"""A world small enough for tables: a line of cells along which the desired object walks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from visualrhp.errors import SimulationError
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.simulation import DiscreteActionSpace
from visualrhp.types import Action, State, Transition

RIGHT, LEFT, BREAK = 0, 1, 7


def at(cell: int) -> State:
    """The state in which the object is in ``cell``."""
    return State.create([0.0, 0.0, 0.0], 0.085, False, [[float(cell), 0.0, 0.0]])


def cell_of(state: State) -> int:
    """The cell of the object."""
    return int(state.object_poses[0, 0])


@dataclass
class LineWorld:
    """Cells ... -1, 0, 1, ...: action 0 goes right, 1 goes left, 7 breaks the physics, the others stay.

    ``goal`` is the goal cell; in cells below ``edge`` the object has dropped.
    """

    goal: int = 3
    edge: int = 0
    simulated: list[tuple[int, Action]] = field(default_factory=list)
    scene: Scene = field(
        default_factory=lambda: Scene(
            TargetRegion(np.zeros(2)), (ObjectShape.centred([[0.0, 0.0], [0.03, 0.0], [0.0, 0.03]]),)
        )
    )
    action_space: DiscreteActionSpace = field(default_factory=DiscreteActionSpace)

    def simulate(self, state: State, action: Action) -> Transition:
        cell = cell_of(state)
        self.simulated.append((cell, action))
        if action == BREAK:
            raise SimulationError("broken on purpose")
        assert isinstance(action, int)
        after = at(cell + {RIGHT: 1, LEFT: -1}.get(action, 0))
        dropped = self.is_dropped(after)
        return Transition(state, action, -50.0 if dropped else -1.0, after, self.is_goal(after), dropped)

    def is_goal(self, state: State) -> bool:
        return cell_of(state) == self.goal

    def is_dropped(self, state: State) -> bool:
        return cell_of(state) < self.edge


@pytest.fixture
def line_world() -> Callable[..., LineWorld]:
    return LineWorld
