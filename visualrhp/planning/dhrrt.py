"""Kinodynamic RRT with a dynamic planning horizon, after dhRRT. Not in the paper.

After Ren, Kavraki and Hang, "Rearrangement-Based Manipulation via Kinodynamic Planning and Dynamic Planning Horizons",
IROS 2022 (arXiv:2208.02312): planning and execution are interleaved, and the horizon of a plan depends on its progress,
measured by a heuristic of the task, so that most actions are planned from observed states.

This implementation follows the abstract of that paper, not its text or code: **results of this baseline are not results
of their method.**
"""

from __future__ import annotations

import math

import numpy as np

from visualrhp.parameters import Positive, parameters
from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT, TreeSearch
from visualrhp.planning.plan import Plan
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.scene.scene import Scene
from visualrhp.simulation.rules import MAX_EPISODE_ACTIONS
from visualrhp.types import Episode, State


@parameters
class DHRRT(Planner):
    """Plans until the heuristic has improved by ``progress``, executes that motion, observes, and plans again.

    In an observed state s_0, a tree is grown until it contains a goal state or a state s with h(s) <= h(s_0) -
    ``progress``, or its budget is spent. The motion to the goal state, or otherwise to the state with the least h, is
    executed to its end; its length is the horizon. If no state is better than s_0, the planner gives up.

    The heuristic is :func:`distance_to_target`.

    Differences from dhRRT: the tree is that of :class:`KinodynamicRRT` (its samples, its metric, several children per
    expansion, all of them kept); budgets are counts of simulated actions; a motion is cut at the action limit of an
    episode (Sec. 7.3); the tree is not reused for the next horizon.

    Attributes:
        rrt: the search and its budget for one horizon.
        progress: required decrease of h [m].
        name: in tables and figures.

    Raises:
        ConfigError: a parameter is out of range.
    """

    rrt: KinodynamicRRT
    progress: Positive = 0.1
    name: str = "dhRRT"

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        motion = Plan()
        num_decisions = 0

        def policy(state: State) -> Decision:
            nonlocal motion, num_decisions
            if not motion.actions:
                motion = Plan(self.plan_motion(model, state, rng, MAX_EPISODE_ACTIONS - num_decisions))
            num_decisions += 1
            return motion.follow()

        return policy

    def plan_motion(
        self, model: PlanningModel, state: State, rng: np.random.Generator, max_actions: int = MAX_EPISODE_ACTIONS
    ) -> Episode | None:
        """Plan a motion: up to ``max_actions`` actions, none in a goal state; None if no better state was found."""
        search = TreeSearch(self.rrt, model, state, rng, max_actions)
        best, least = 0, distance_to_target(model.scene, state)
        wanted = least - self.progress
        while not search.is_over and least > wanted:
            for node in search.expand():
                distance = distance_to_target(model.scene, search.state(node))
                if distance < least:
                    best, least = node, distance
        if search.plan is not None:
            return search.plan
        return Episode.from_transitions(search.path(best)) if best else None


def distance_to_target(scene: Scene, state: State) -> float:
    """h: distance of the desired object's centre from the target region [m], 0 within it."""
    x, y = state.desired_position.tolist()
    target_x, target_y = scene.target.position.tolist()
    return max(math.hypot(x - target_x, y - target_y) - scene.target.radius, 0.0)
