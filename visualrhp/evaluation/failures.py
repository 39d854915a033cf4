"""Why an episode failed: what fell, or what the last actions did."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Final

import numpy as np

from visualrhp.scene.scene import Scene
from visualrhp.simulation import rules
from visualrhp.types import Episode, Outcome, State, wrap_angle

WINDOW: Final = 12
"""Number of last actions that tell why an episode ran out of actions."""

STILL: Final = 0.02
"""An object that is displaced by less than this in the whole window has hardly moved [m]."""

SAME_POSITION: Final = 0.015
"""Two states are the same if the gripper and every object are displaced by less than this [m] ..."""

SAME_HEADING: Final = 0.3
"""... and the gripper is turned by less than this [rad]."""

MAX_PERIOD: Final = 6
"""Longest oscillation [actions]."""

RECURRENCE: Final = 0.5
"""Share of the states in the window that are a return to an earlier one, from which on the episode oscillates."""


class Failure(StrEnum):
    """Why an episode failed."""

    NONE = "none"
    """It did not."""
    DESIRED_DROPPED = "desired dropped"
    """The desired object fell off the surface, alone or with others."""
    OBSTACLE_DROPPED = "obstacle dropped"
    """Another object fell."""
    OSCILLATION = "oscillation"
    """Out of actions: the last ones left a state and came back to it, again and again."""
    IDLE = "idle"
    """Out of actions: the last ones hardly moved an object."""
    OUT_OF_ACTIONS = "out of actions"
    """Out of actions, while objects still moved."""
    JAM = "jam"
    """Objects were wedged: the chosen action could not be simulated, or the arm could not make it."""
    GAVE_UP = "gave up"
    """The planner found no action: before the first one, or after its plan had failed."""
    STOPPED = "stopped"
    """A fault stopped the robot."""


_OF_OUTCOME: Final = {
    Outcome.SUCCESS: Failure.NONE,
    Outcome.NO_PLAN: Failure.GAVE_UP,
    Outcome.PLAN_FAILED: Failure.GAVE_UP,
    Outcome.DIVERGED: Failure.JAM,
    Outcome.UNREACHABLE: Failure.JAM,
    Outcome.STOPPED: Failure.STOPPED,
}


def failure_of(scene: Scene, episode: Episode) -> Failure:
    """Why a finished episode failed."""
    outcome = episode.outcome
    assert outcome is not None  # it is finished
    if outcome is Outcome.DROPPED:
        is_desired = 0 in rules.dropped_objects(scene, episode.states[-1])
        return Failure.DESIRED_DROPPED if is_desired else Failure.OBSTACLE_DROPPED
    if outcome is Outcome.OUT_OF_ACTIONS:
        return _why_out_of_actions(episode.states[-1 - WINDOW - MAX_PERIOD :])
    return _OF_OUTCOME[outcome]


def _why_out_of_actions(states: Sequence[State]) -> Failure:
    """The reason in the window at the end of an episode; ``states`` also has those to which it may return."""
    num_actions = min(WINDOW, len(states) - 1)
    is_return = [_is_return(states[: end + 1]) for end in range(len(states) - num_actions, len(states))]
    if np.mean(is_return) >= RECURRENCE:
        return Failure.OSCILLATION
    moved = states[-1].object_positions - states[-1 - num_actions].object_positions
    return Failure.IDLE if np.hypot(*moved.T).max() < STILL else Failure.OUT_OF_ACTIONS


def _is_return(states: Sequence[State]) -> bool:
    """Whether the last state is one that was left at most ``MAX_PERIOD`` actions ago."""
    *before, now = states[-1 - MAX_PERIOD :]
    is_same = [_are_same(state, now) for state in before]
    return any(is_same) and not all(is_same[is_same.index(True) :])


def _are_same(one: State, other: State) -> bool:
    positions = [np.vstack([state.gripper_position, state.object_positions]) for state in (one, other)]
    turn = abs(wrap_angle(float(one.gripper_pose[2] - other.gripper_pose[2])))
    return bool(turn < SAME_HEADING and np.hypot(*(positions[0] - positions[1]).T).max() < SAME_POSITION)
