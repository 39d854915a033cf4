"""The handcrafted heuristic of the CraftedHeuristicRHP baseline (Sec. 7.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from visualrhp.errors import ConfigError
from visualrhp.heuristics.heuristic import Guidance, Heuristic, UniformGuidance
from visualrhp.scene.scene import Scene
from visualrhp.simulation.task import is_dropped
from visualrhp.types import ActionSpaceName, FloatArray, State, wrap_angle


@dataclass(frozen=True, slots=True)
class CostToGo:
    r"""The handcrafted cost-to-go in units of actions: a weighted sum of the terms that Sec. 7.5 lists.

    With r, o, t the positions of robot, desired object and target region, :math:`\theta` the robot's heading and
    :math:`\angle` the wrapped difference of two directions,

    .. math::
        c = w_{reach} \|o - r\| + w_{turn} |\angle(o - r, \theta)| + w_{carry} \|t - o\|
            + w_{align} |\angle(t - o, o - r)| + w_{face} \, b \, |\angle(t - r, \theta)|
            + w_{drop} [\text{an object is outside the edges}],

    where :math:`b = \max(0, \cos\angle(t - o, o - r))` is how much the robot is behind the desired object as seen
    from the target region: 1 straight behind, 0 beside or in front of it.

    The default weights are the outcome of ``python -m pipelines.tune_crafted``: with 8 x 4 roll-outs, one set for both
    action spaces, on task instances apart from the evaluation's (docs/crafted_heuristic.md). Their scale matters beside
    the ratios, since a drop ends a roll-out at a cost of 50: a cost-to-go above that would make dropping attractive.

    Attributes:
        reach: per metre between robot and desired object.
        turn: per radian of angular displacement between the robot's heading and the desired object.
        carry: per metre between desired object and target region.
        align: per radian by which robot, desired object and target region are out of line.
        face: per radian between heading and target region, once behind.
        drop: for a dropped object; without effect in a roll-out, which ends there (Alg. 1).

    Raises:
        ConfigError: a weight is negative or not a number.
    """

    reach: float = 9.57
    turn: float = 0.0898
    carry: float = 62.2
    align: float = 2.94
    face: float = 0.258
    drop: float = 50.0

    def __post_init__(self) -> None:
        for weight in fields(self):
            if not 0.0 <= getattr(self, weight.name) < np.inf:
                raise ConfigError(
                    f"{weight.name}={getattr(self, weight.name)}: a weight of the handcrafted cost-to-go is a finite "
                    "number and not negative."
                )

    def __call__(self, scenes: Sequence[Scene], states: Sequence[State]) -> FloatArray:
        """Return the cost-to-go of every state, [B]."""
        poses = np.array([state.vector[:7] for state in states])  # [B, 7]: robot x, y, theta, gripper, object x, y
        robot, heading, desired = poses[:, :2], poses[:, 2], poses[:, 5:7]
        target = np.array([scene.target.position for scene in scenes])
        dropped = np.array([is_dropped(scene, state) for scene, state in zip(scenes, states, strict=True)])
        to_object, to_target = _direction(desired - robot), _direction(target - desired)
        misalignment = np.abs(wrap_angle(to_target - to_object))
        behind = np.maximum(0.0, np.cos(misalignment))
        return (
            self.reach * np.linalg.norm(desired - robot, axis=1)
            + self.turn * np.abs(wrap_angle(to_object - heading))
            + self.carry * np.linalg.norm(target - desired, axis=1)
            + self.align * misalignment
            + self.face * behind * np.abs(wrap_angle(_direction(target - robot) - heading))
            + self.drop * dropped
        )


@dataclass(frozen=True, slots=True)
class CraftedHeuristic(Heuristic):
    """Uniform random actions, and minus the handcrafted cost-to-go as the value (Sec. 7.5).

    Attributes:
        action_space: name of the action space that actions are drawn from.
        cost: the cost-to-go.
    """

    action_space: ActionSpaceName
    cost: CostToGo = field(default_factory=CostToGo)

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        return UniformGuidance(self.action_space, -self.cost(scenes, states))


def _direction(vectors: FloatArray) -> FloatArray:
    """[B] angle of [B, 2] vectors [rad]."""
    return np.arctan2(vectors[:, 1], vectors[:, 0])
