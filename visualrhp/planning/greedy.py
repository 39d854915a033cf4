"""The greedy baseline (Sec. 7.5): act on the heuristic alone, without looking ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.types import State


@dataclass(frozen=True, slots=True)
class Greedy(Planner):
    """Takes the action of the highest value (discrete) or the mean of the policy (continuous).

    The model serves only to observe the state. The random generator is not used.
    """

    heuristic: Heuristic

    @property
    def name(self) -> str:
        return "Greedy"

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        scenes = [model.scene]

        def policy(state: State) -> Decision:
            return Decision(action=self.heuristic.guide(scenes, [state]).mode()[0])

        return policy
