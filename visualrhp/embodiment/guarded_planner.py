"""A planner whose failures end an episode of a robot in a named state, with the robot at rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from visualrhp.errors import CellFault, PerceptionError
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.types import State


class GuardedPlanner(Planner):
    """Makes what a planner raises, and actions that are not in the action space, a CellFault.

    The robot is at rest while a planner decides, and stays so.

    Args:
        planner: the planner.
        stop: stops the robot for a reason (:meth:`visualrhp.embodiment.robot_world.RobotWorld.stop`).
    """

    def __init__(self, planner: Planner, stop: Callable[[str], None]) -> None:
        self.name = planner.name
        self._planner = planner
        self._stop = stop

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        policy: Policy | None = None

        def guarded(state: State) -> Decision:
            nonlocal policy
            try:
                if policy is None:
                    policy = self._planner.start(model, rng)
                decision = policy(state)
                if decision.action is not None:
                    model.action_space.motion(decision.action)
            except (CellFault, PerceptionError):
                raise
            except Exception as error:
                fault = CellFault(f"the planner failed: {type(error).__name__}: {error!s:.300}")
                self._stop(str(fault))
                raise fault from error
            return decision

        return guarded
