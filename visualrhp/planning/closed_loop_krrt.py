"""Closed-loop K.RRT: the planner of Sec. 6.1 again in every state that is not the one it foresaw. No part of the paper.

The paper runs K.RRT open loop (Sec. 7.5), which fails where the world departs from the model (Sec. 8.2). This baseline
needs no learning either, and closes the loop as receding horizon planning does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT, replay
from visualrhp.planning.plan import Plan
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.simulation.task import MAX_EPISODE_ACTIONS
from visualrhp.types import State


@dataclass(frozen=True, slots=True)
class ClosedLoopKRRT(Planner):
    """Decides after each action how to go on to the goal, and takes one action of that.

    A state that is to the bit the one that the plan foresaw is not planned in again: nothing is known now that was not
    known before. Where the model is the world, that is always so, and the planner acts as it does open loop; where it
    is not, hardly ever. In any other state:

    1. With ``keep_plan``, the rest of the plan is simulated from the observed state, and kept if it still reaches a
       goal state.
    2. Otherwise a new tree is grown, which has ``rrt.max_simulations`` and ``rrt.time_limit_s`` to find a plan within
       the actions that are left in the episode.
    3. If it finds none, the rest of the old plan is followed, although the state is not the one that it was made for;
       once nothing is left of it, the planner gives up.

    Attributes:
        rrt: the search and its budget for one decision.
        keep_plan: without it, the planner plans anew in every unforeseen state. That takes more time and somewhat more
            actions: plans that are drawn at random have little in common.
    """

    rrt: KinodynamicRRT
    keep_plan: bool = True

    @property
    def name(self) -> str:
        return "K.RRT closed loop"

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        """Return a policy for one episode; its first call is taken to be in the episode's initial state."""
        plan = Plan()
        num_decisions = 0

        def policy(state: State) -> Decision:
            nonlocal plan, num_decisions
            if not plan.foresees(state):
                found = replay(model, state, plan.actions)[0] if self.keep_plan else None
                if found is None:
                    found = self.rrt.search(model, state, rng, MAX_EPISODE_ACTIONS - num_decisions).episode
                if found is not None:
                    plan = Plan(found)
            num_decisions += 1
            return plan.follow()

        return policy
