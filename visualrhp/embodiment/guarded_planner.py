"""A planner for a robot: its failures end the episode in a named state, and its actions are motions of the arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from visualrhp.embodiment.planned_model import ReachableModel
from visualrhp.errors import CellFault, PerceptionError
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.simulation.action_spaces import MAX_ROTATION, MAX_TRANSLATION, GripperMotion
from visualrhp.types import Action, FloatArray, State

_NUM_TRIED: Final = 64


class GuardedPlanner(Planner):
    """Makes what a planner raises, and actions that are not in the action space, a CellFault.

    The robot is at rest while a planner decides, and stays so. A planner decides for an action that the arm cannot make
    if it has found no other; the most similar one of some that the arm can make takes its place.

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
                    if isinstance(model, ReachableModel):
                        decision = replace(decision, action=_possible(model, state, decision.action, rng))
            except (CellFault, PerceptionError):
                raise
            except Exception as error:
                fault = CellFault(f"the planner failed: {type(error).__name__}: {error!s:.300}")
                self._stop(str(fault))
                raise fault from error
            return decision

        return guarded


def _possible(model: ReachableModel, state: State, action: Action, rng: np.random.Generator) -> Action:
    """``action``, or if the arm cannot make it, the most similar one of those that are tried, if there is one."""
    if model.motion_fault(state, action) is None:
        return action
    space = model.action_space
    wanted = _vector(space.motion(action))
    others = [space.sample(rng) for _ in range(_NUM_TRIED)]
    others.sort(key=lambda other: float(np.linalg.norm(_vector(space.motion(other)) - wanted)))
    return next((other for other in others if model.motion_fault(state, other) is None), action)


def _vector(motion: GripperMotion) -> FloatArray:
    """Translation and rotation [3], relative to the largest of an action."""
    return np.array(
        [motion.forward / MAX_TRANSLATION, motion.left / MAX_TRANSLATION, motion.rotation / MAX_ROTATION], np.float64
    )
