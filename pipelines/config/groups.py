"""Groups of ``conf/``: observations, heuristics, planners, learners, and groups of several pipelines."""

from __future__ import annotations

from typing import Annotated, Literal

from visualrhp.heuristics.crafted import CostToGo
from visualrhp.learning import configs as learning
from visualrhp.observation import observation_class
from visualrhp.parameters import Count, Field, Index, Positive, parameters
from visualrhp.planning.closed_loop_krrt import ClosedLoopKRRT
from visualrhp.planning.decision_task import RecedingHorizonParameters
from visualrhp.planning.dhrrt import DHRRT
from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT


@parameters
class ObservationConfig:
    """Group ``observation``: the input of the network.

    Attributes:
        name: of a class of :mod:`visualrhp.observation`.
        num_objects: numbers of objects with a separate network (Cartesian; Sec. 7.5); empty for one network for all
            numbers of objects (image).
    """

    name: str
    num_objects: tuple[Count, ...]

    def __post_init__(self) -> None:
        if observation_class(self.name).fixes_num_objects and not self.num_objects:
            raise ValueError(
                f"num_objects is empty: {self.name.capitalize()} observations need the numbers of objects to train "
                "networks for, such as observation.num_objects=[1,4,7]."
            )
        if not observation_class(self.name).fixes_num_objects and self.num_objects:
            raise ValueError(
                f"num_objects must be empty, []: one network of {self.name} observations serves every number of "
                "objects."
            )


@parameters
class LearnedHeuristicConfig:
    """A trained network.

    Attributes:
        observation: that the network reads.
        temperature: of the softmax of Eq. 2 (discrete action space).
        folder: with the trained networks, ``<action space>/<observation>/heuristic*.safetensors``; ``pretrained`` or
            ``pretrained_paper`` for the released ones. The key ``heuristics`` of a stage takes precedence.
    """

    kind: Literal["learned"]
    observation: str
    temperature: Positive
    folder: str


@parameters(kw_only=True)
class CraftedHeuristicConfig(CostToGo):
    """The weights of the handcrafted heuristic (Sec. 7.5)."""

    kind: Literal["crafted"]


@parameters(kw_only=True)
class RecedingHorizonConfig(RecedingHorizonParameters):
    """Algorithm 1 and its heuristic."""

    algorithm: Literal["receding_horizon"]
    heuristic: Annotated[LearnedHeuristicConfig | CraftedHeuristicConfig, Field(discriminator="kind")]


@parameters
class GreedyConfig:
    """The policy of a trained network without look-ahead (Sec. 7.5)."""

    algorithm: Literal["greedy"]
    name: str
    heuristic: LearnedHeuristicConfig


@parameters(kw_only=True)
class KinodynamicRRTConfig(KinodynamicRRT):
    """K.RRT, open loop (Sec. 7.5)."""

    algorithm: Literal["kinodynamic_rrt"]


@parameters(kw_only=True)
class ClosedLoopKRRTConfig(ClosedLoopKRRT):
    """K.RRT, closed loop."""

    algorithm: Literal["closed_loop_krrt"]
    rrt: KinodynamicRRTConfig


@parameters(kw_only=True)
class DHRRTConfig(DHRRT):
    """K.RRT with a dynamic planning horizon."""

    algorithm: Literal["dhrrt"]
    rrt: KinodynamicRRTConfig


PlannerConfig = Annotated[
    RecedingHorizonConfig | GreedyConfig | KinodynamicRRTConfig | ClosedLoopKRRTConfig | DHRRTConfig,
    Field(discriminator="algorithm"),
]


@parameters(kw_only=True)
class QImitationLearnerConfig(learning.QImitationConfig):
    """Imitation in the discrete action space."""

    algorithm: Literal["q_imitation"]


@parameters(kw_only=True)
class ActorCriticImitationLearnerConfig(learning.ActorCriticImitationConfig):
    """Imitation in the continuous action space."""

    algorithm: Literal["actor_critic_imitation"]


@parameters(kw_only=True)
class DQNLearnerConfig(learning.DQNConfig):
    """DQN, its budget, its environments, and the parameters of RHP (Sec. 6.3.1).

    Attributes:
        iterations: of collecting and updating.
        num_envs: number of parallel tasks to collect in.
        num_rollouts: n of eps-RHP.
        horizon: h of eps-RHP.
        temperature: tau of eps-RHP's policy (Eq. 2).
    """

    algorithm: Literal["dqn"]
    iterations: Count
    num_envs: Count
    num_rollouts: Count
    horizon: Count
    temperature: Positive


@parameters(kw_only=True)
class C3POLearnerConfig(learning.C3POConfig):
    """C3PO or PPO, its budget and its environments (Sec. 6.3.2).

    Attributes:
        iterations: of collecting and updating.
        num_envs: number of parallel tasks to collect in.
    """

    algorithm: Literal["c3po"]
    iterations: Count
    num_envs: Count


@parameters(kw_only=True)
class ExpertIterationLearnerConfig(learning.ExpertIterationConfig):
    """Expert iteration, and the imitation in its rounds."""

    algorithm: Literal["expert_iteration"]
    imitation: Annotated[QImitationLearnerConfig | ActorCriticImitationLearnerConfig, Field(discriminator="algorithm")]


@parameters
class RoundValidationConfig:
    """Validation after each round. Attributes: ``num_instances``, the number of task instances, always the same."""

    num_instances: Count


@parameters
class ValidationConfig:
    """Greedy evaluation during training, on separate task instances.

    Attributes:
        num_instances: number of task instances, always the same ones; 0 for no evaluation.
        every: epochs or iterations between evaluations.
    """

    num_instances: Index
    every: Count


@parameters
class VideoConfig:
    """The video of the result of a stage.

    Attributes:
        num_scenes: number of filmed task instances; 0 for no video.
        size_px: width.
    """

    num_scenes: Index
    size_px: Count
