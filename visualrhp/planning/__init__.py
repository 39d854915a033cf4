"""How actions are chosen: receding horizon planning, the greedy policy, kinodynamic RRT."""

from visualrhp.planning.greedy import Greedy
from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT, SearchResult
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy, Rollout
from visualrhp.planning.receding_horizon import RecedingHorizon

__all__ = [
    "Decision",
    "Greedy",
    "KinodynamicRRT",
    "Planner",
    "PlanningModel",
    "Policy",
    "RecedingHorizon",
    "Rollout",
    "SearchResult",
]
