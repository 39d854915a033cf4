"""State of a receding horizon planner that is kept between the decisions of an episode."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from visualrhp.planning.planner import Decision, PlanningModel
from visualrhp.types import Action, Column, FloatArray, State, wrap_angle

RESOLUTION = 1e-3
"""Largest difference between the entries of equal states [m], [rad]."""


@dataclass(slots=True)
class EpisodeMemory:
    """The memory of one episode.

    Attributes:
        rest: actions of the last decision's chosen roll-out that were not executed yet.
        perturbed_models: of robust look-ahead.
    """

    rest: tuple[Action, ...] = ()
    perturbed_models: list[PlanningModel] = field(default_factory=list)
    _visited: list[FloatArray] = field(default_factory=list)

    def enter(self, state: State) -> None:
        """Remember that the episode has reached ``state``."""
        self._visited.append(state.vector)

    def has_visited(self, state: State) -> bool:
        """Whether the episode has been in ``state``, up to :data:`RESOLUTION`."""
        differences = np.array(self._visited) - state.vector
        for angles in (Column.GRIPPER_THETA, Column.OBJECTS_THETA):
            differences[:, angles] = wrap_angle(differences[:, angles])
        return bool((np.abs(differences).max(axis=1) <= RESOLUTION).any())

    def remember(self, decision: Decision) -> None:
        """Remember the chosen roll-out."""
        self.rest = () if decision.chosen is None else decision.rollouts[decision.chosen].actions[1:]
