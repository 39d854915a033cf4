"""The handcrafted heuristic of the CraftedHeuristicRHP baseline (Sec. 7.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from visualrhp.heuristics.heuristic import Guidance, Heuristic, UniformGuidance
from visualrhp.parameters import NonNegative, parameters
from visualrhp.scene.scene import Scene
from visualrhp.simulation.rules import is_dropped
from visualrhp.types import ActionSpaceName, Column, FloatArray, State, state_dimension, wrap_angle


@parameters
class CostToGo:
    r"""The handcrafted cost-to-go in units of actions: a weighted sum of the terms in Sec. 7.5.

    With r, o, t the positions of gripper, desired object and target region, :math:`\theta` the gripper's heading and
    :math:`\angle` the wrapped difference of two directions,

    .. math::
        c = w_{reach} \|o - r\| + w_{turn} |\angle(o - r, \theta)| + w_{carry} \|t - o\|
            + w_{align} |\angle(t - o, o - r)| + w_{face} \, b \, |\angle(t - r, \theta)|
            + w_{drop} [\text{an object is outside the edges}],

    where :math:`b = \max(0, \cos\angle(t - o, o - r))` measures how far the gripper is behind the desired object,
    seen from the target region: 1 straight behind it, 0 at its side or in front of it.

    The default weights are the result of ``python -m pipelines.tune_crafted``: one set for both action spaces, with 8 x
    4 roll-outs, on task instances that the evaluation does not use (docs/crafted_heuristic.md). Their scale matters,
    not only their ratios: a drop ends a roll-out at a cost of 50, so a higher cost-to-go would make dropping
    attractive.

    Attributes:
        reach: per metre between gripper and desired object.
        turn: per radian of angular displacement between the gripper's heading and the desired object.
        carry: per metre between desired object and target region.
        align: per radian by which gripper, desired object and target region are out of line.
        face: per radian between heading and target region, if behind the object.
        drop: for a dropped object; no effect in roll-outs, which end with a drop (Algorithm 1).

    Raises:
        ConfigError: a weight is negative or not a number.
    """

    reach: NonNegative = 9.57
    turn: NonNegative = 0.0898
    carry: NonNegative = 62.2
    align: NonNegative = 2.94
    face: NonNegative = 0.258
    drop: NonNegative = 50.0

    def __call__(self, scenes: Sequence[Scene], states: Sequence[State]) -> FloatArray:
        """Return the cost-to-go of every state, [B]."""
        vectors = np.array([state.vector[: state_dimension(1)] for state in states])  # gripper and desired object
        gripper, heading = vectors[:, Column.GRIPPER_POSITION], vectors[:, Column.GRIPPER_THETA]
        desired = vectors[:, Column.DESIRED_POSITION]
        target = np.array([scene.target.position for scene in scenes])
        dropped = np.array([is_dropped(scene, state) for scene, state in zip(scenes, states, strict=True)])
        to_object, to_target = _direction(desired - gripper), _direction(target - desired)
        misalignment = np.abs(wrap_angle(to_target - to_object))
        behind = np.maximum(0.0, np.cos(misalignment))
        return (
            self.reach * np.linalg.norm(desired - gripper, axis=1)
            + self.turn * np.abs(wrap_angle(to_object - heading))
            + self.carry * np.linalg.norm(target - desired, axis=1)
            + self.align * misalignment
            + self.face * behind * np.abs(wrap_angle(_direction(target - gripper) - heading))
            + self.drop * dropped
        )


@dataclass(frozen=True, slots=True)
class CraftedHeuristic(Heuristic):
    """Uniform random actions, and minus the handcrafted cost-to-go as the value (Sec. 7.5).

    Attributes:
        action_space: name of the action space that actions are sampled from.
        cost: the cost-to-go.
    """

    action_space: ActionSpaceName
    cost: CostToGo = field(default_factory=CostToGo)

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        return UniformGuidance(self.action_space, -self.cost(scenes, states))


def _direction(vectors: FloatArray) -> FloatArray:
    """[B] angle of [B, 2] vectors [rad]."""
    return np.arctan2(vectors[:, 1], vectors[:, 0])
