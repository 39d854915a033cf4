"""Closed-loop K.RRT: replans with the planner of Sec. 6.1 in every state that it did not predict. Not in the paper.

The paper runs K.RRT open loop (Sec. 7.5), which fails where the world differs from the model (Sec. 8.2). This baseline
needs no learning either, and closes the loop as receding horizon planning does.
"""

from __future__ import annotations

import numpy as np

from visualrhp.parameters import parameters
from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT, replay
from visualrhp.planning.plan import Plan
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.simulation.rules import MAX_EPISODE_ACTIONS
from visualrhp.types import State


@parameters
class ClosedLoopKRRT(Planner):
    """Plans to the goal after each action, and takes the first action of the plan.

    If the state equals the one predicted by the plan, the plan is kept, since there is no new information. With an
    exact model this is always the case, and the planner acts as it does open loop; otherwise it is rare. In any other
    state:

    1. With ``keep_plan``, the rest of the plan is simulated from the observed state, and kept if it still reaches a
       goal state.
    2. Otherwise a new tree is grown, with the budget ``rrt.max_simulations`` and ``rrt.time_limit_s``, to find a plan
       within the remaining actions of the episode.
    3. If it finds none, the rest of the old plan is followed, although it was made for another state. At the end of
       that plan, the planner gives up.

    Attributes:
        rrt: the search and its budget for one decision.
        keep_plan: if false, the planner plans again in every state that was not predicted, which takes more time and
            slightly more actions, because random plans have little in common.
        name: in tables and figures.
    """

    rrt: KinodynamicRRT
    keep_plan: bool = True
    name: str = "K.RRT closed loop"

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        """Return a policy for one episode; its first call must be in the initial state of the episode."""
        plan = Plan()
        num_decisions = 0

        def policy(state: State) -> Decision:
            nonlocal plan, num_decisions
            if not plan.predicts(state):
                found = replay(model, state, plan.actions)[0] if self.keep_plan else None
                if found is None:
                    found = self.rrt.search(model, state, rng, MAX_EPISODE_ACTIONS - num_decisions).episode
                if found is not None:
                    plan = Plan(found)
            num_decisions += 1
            return plan.follow()

        return policy
