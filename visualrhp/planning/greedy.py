"""The greedy baseline (Sec. 7.5): follows the heuristic without look-ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.types import State


@dataclass(frozen=True, slots=True)
class Greedy(Planner):
    """Takes the action with the highest value (discrete) or the mean of the policy (continuous).

    The model is used only to observe the state. The random generator is not used.
    """

    heuristic: Heuristic
    name: str = "Greedy"

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        scenes = [model.scene]

        def policy(state: State) -> Decision:
            return Decision(action=self.heuristic.guide(scenes, [state]).mode()[0])

        return policy
