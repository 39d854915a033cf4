"""Physics simulation with pymunk: action spaces, transition function, reward, goal and validity."""

from visualrhp.simulation.action_spaces import (
    ActionSpace,
    ContinuousActionSpace,
    DiscreteActionSpace,
    GripperMotion,
    make_action_space,
)
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.rules import (
    ACTION_REWARD,
    DISCOUNT,
    DROP_REWARD,
    MAX_ACTIONS,
    MAX_EPISODE_ACTIONS,
)
from visualrhp.simulation.transition_model import TransitionModel

__all__ = [
    "ACTION_REWARD",
    "DISCOUNT",
    "DROP_REWARD",
    "MAX_ACTIONS",
    "MAX_EPISODE_ACTIONS",
    "ActionSpace",
    "ContinuousActionSpace",
    "DiscreteActionSpace",
    "GripperMotion",
    "Physics",
    "TransitionModel",
    "make_action_space",
]
