"""The rules of the task: goal, validity, reward, and when an episode ends (paper, Sec. 4 and 7)."""

from __future__ import annotations

import math
from typing import Final

from visualrhp.scene import geometry
from visualrhp.scene.scene import Scene
from visualrhp.types import Outcome, State

ACTION_REWARD: Final = -1.0
"""Reward of every action (Sec. 7)."""

DROP_REWARD: Final = -50.0
"""Reward of an action that drops an object outside the surface edges (Sec. 7)."""

DISCOUNT: Final = 0.995
"""gamma (Sec. 7.4)."""

MAX_ACTIONS: Final = 50
"""A task must be completed in fewer actions than this (Sec. 7.3)."""

MAX_EPISODE_ACTIONS: Final = MAX_ACTIONS - 1
"""Actions after which an episode is truncated."""


def is_goal(scene: Scene, state: State) -> bool:
    """Whether the desired object's centre is in the target region: ||(x, y)^desObj - (x, y)^tarReg|| <= rad^tarReg."""
    x, y = state.desired_position.tolist()
    target_x, target_y = scene.target.position.tolist()
    return math.hypot(x - target_x, y - target_y) <= scene.target.radius


def is_dropped(scene: Scene, state: State) -> bool:
    """Whether the state is invalid: the centre of an object is outside the surface edges."""
    edges = scene.edges.tolist()
    return not all(geometry.contains(edges, x, y) for x, y in state.object_positions.tolist())


def dropped_objects(scene: Scene, state: State) -> list[int]:
    """Indices of the objects whose centre is outside the surface edges."""
    edges = scene.edges.tolist()
    return [i for i, (x, y) in enumerate(state.object_positions.tolist()) if not geometry.contains(edges, x, y)]


def reward(dropped: bool) -> float:
    """Reward of one action: -1, or -50 if it dropped an object."""
    return DROP_REWARD if dropped else ACTION_REWARD


def outcome_after(is_goal: bool, is_dropped: bool, num_actions: int) -> Outcome | None:
    """Outcome of an episode in the state after ``num_actions`` actions; None if the episode continues.

    A drop takes precedence over the goal, and the goal over the action limit: success requires under 50 actions.
    """
    outcome = Outcome.of_state(is_goal, is_dropped)
    if outcome is None and num_actions >= MAX_EPISODE_ACTIONS:
        return Outcome.OUT_OF_ACTIONS
    return outcome
