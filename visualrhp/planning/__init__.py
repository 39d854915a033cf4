"""Planners: receding horizon planning, the greedy policy, and kinodynamic RRT in open and closed loop."""

from visualrhp.planning.closed_loop_krrt import ClosedLoopKRRT
from visualrhp.planning.dhrrt import DHRRT
from visualrhp.planning.greedy import Greedy
from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT, SearchResult, TreeSearch, shorten_plan
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy, Rollout
from visualrhp.planning.receding_horizon import RecedingHorizon

__all__ = [
    "DHRRT",
    "ClosedLoopKRRT",
    "Decision",
    "Greedy",
    "KinodynamicRRT",
    "Planner",
    "PlanningModel",
    "Policy",
    "RecedingHorizon",
    "Rollout",
    "SearchResult",
    "TreeSearch",
    "shorten_plan",
]
