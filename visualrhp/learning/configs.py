"""Parameters of the learners. This module does not import torch.

Defaults: Sec. 7.4.
"""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Literal

from visualrhp.parameters import AsTuple, Count, Discount, Field, Fraction, NonNegative, Positive, parameters
from visualrhp.scene.sampling import NumObjects
from visualrhp.simulation.rules import DISCOUNT


@parameters
class ImitationConfig:
    """Parameters for both action spaces. Defaults: Sec. 7.4.

    Attributes:
        discount: gamma.
        l2_regularization: weight of the squared norm of the parameters.
        batch_size: M.
        epochs: passes over the pairs.
        lr: learning rate of Adam.
        lr_schedule: ``constant``, or ``cosine`` with zero at the last step.
        mirror: whether to mirror every pair with probability 1/2.
        validation_fraction: share of held-out demonstrations.

    Raises:
        ConfigError: a parameter is out of range.
    """

    discount: Discount = DISCOUNT
    l2_regularization: NonNegative = 0.0
    batch_size: Count = 2000
    epochs: Count = 100
    lr: Positive = 1e-4
    lr_schedule: Literal["constant", "cosine"] = "constant"
    mirror: bool = True
    validation_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.05


@parameters
class QImitationConfig(ImitationConfig):
    """Discrete action space (Sec. 6.2.1).

    Attributes:
        margin_actions: eta.
        margin_cost: r_cost.
    """

    margin_actions: Count = 3
    margin_cost: Positive = 1.0


@parameters
class ActorCriticImitationConfig(ImitationConfig):
    """Continuous action space (Sec. 6.2.2).

    Attributes:
        likelihood_coefficient: Upsilon.
        value_coefficient: c1.
        entropy_coefficient: c2.
        return_unit: unit of the returns in the squared error of the value; 1 in the paper.
    """

    likelihood_coefficient: Positive = 0.5
    value_coefficient: Positive = 0.7
    entropy_coefficient: NonNegative = 0.01
    return_unit: Positive = 1.0


@parameters
class ExpertIterationConfig:
    """Parameters of expert iteration (not in the paper).

    Attributes:
        rounds: of collecting, imitating and validating.
        episodes_per_round: task instances that the planner solves in each round.
        max_objects: largest number of objects in the first and in the last round; it grows linearly.
        greedy_share: share of the episodes in which the mode of the policy acts, and the planner only decides.
        noise: relative standard deviation of shapes, friction and density in the world, also in validation.
        replay_rounds: number of rounds, including the present one, whose episodes are imitated.
        action_cost: weight of 49 actions, relative to a success, in the score of a network.
        imitation: of the episodes, in every round.

    Raises:
        ConfigError: a parameter is out of range.
    """

    rounds: Count = 10
    episodes_per_round: Count = 3_000
    max_objects: Annotated[tuple[NumObjects, NumObjects], AsTuple] = (7, 12)
    greedy_share: Fraction = 0.25
    noise: NonNegative = 0.0
    replay_rounds: Count = 3
    action_cost: NonNegative = 0.5
    imitation: QImitationConfig | ActorCriticImitationConfig = field(default_factory=ActorCriticImitationConfig)

    def __post_init__(self) -> None:
        first, last = self.max_objects
        if first > last:
            raise ValueError(f"max_objects=[{first}, {last}]: the smaller bound comes first.")

    def max_objects_in(self, round_: int) -> int:
        """Largest number of objects in round ``round_``, from 1 to ``rounds``."""
        first, last = self.max_objects
        share = (round_ - 1) / max(1, self.rounds - 1)
        return round(first + share * (last - first))


@parameters
class DQNConfig:
    """Parameters of DQN; the defaults are those of Sec. 7.4.

    Attributes:
        buffer_size: transitions in the replay buffer.
        frames_per_batch: transitions collected per iteration, a multiple of the number of environments.
        epochs: passes per update, each over as many samples as were collected.
        batch_size: M, transitions in a minibatch.
        lr: learning rate of Adam.
        discount: gamma.
        epsilon: probability of a random action.
        l2_regularization: weight of the sum of the squared parameters in the loss.
        target_update_interval: minibatches between copies into a target network, or None for no target network (as in
            Eq. 7).
        max_grad_norm: limit of the norm of the gradient, or None (as in the paper).

    Raises:
        ConfigError: a parameter is out of range.
    """

    buffer_size: Count = 500_000
    frames_per_batch: Count = 2_000
    epochs: Count = 3
    batch_size: Count = 2_000
    lr: Positive = 1e-5
    discount: Discount = DISCOUNT
    epsilon: Fraction = 0.2
    l2_regularization: NonNegative = 1e-5
    target_update_interval: Count | None = None
    max_grad_norm: Positive | None = None


@parameters
class C3POConfig:
    """Parameters of C3PO; the defaults are those of Sec. 7.4.

    Attributes:
        frames_per_batch: transitions collected per iteration, a multiple of the number of environments.
        batch_size: M, transitions in a minibatch.
        baseline_epochs: epochs over L_baseline (Eq. 10).
        policy_epochs: epochs over L_actor-critic (Eq. 8).
        baseline_step: whether L_baseline is optimized; False is plain PPO.
        lr: learning rate of Adam.
        discount: gamma.
        clip_epsilon: clip range of the ratio in Eq. 8 (PPO).
        value_coefficient: c3.
        entropy_coefficient: c4.
        baseline_value_coefficient: c5.
        gae_lambda: lambda of generalized advantage estimation; 0 gives the one-step targets of Eq. 8, Eq. 9 and Eq. 10.
        normalize_advantage: whether the advantages of a minibatch are standardized (not in the paper).
        max_grad_norm: limit of the norm of the gradient, or None (as in the paper).

    Raises:
        ConfigError: a parameter is out of range.
    """

    frames_per_batch: Count = 10_000
    batch_size: Count = 2_000
    baseline_epochs: Count = 20
    policy_epochs: Count = 15
    baseline_step: bool = True
    lr: Positive = 1e-5
    discount: Discount = DISCOUNT
    clip_epsilon: Positive = 0.075
    value_coefficient: Positive = 0.7
    entropy_coefficient: NonNegative = 0.1
    baseline_value_coefficient: Positive = 0.35
    gae_lambda: Fraction = 0.0
    normalize_advantage: bool = False
    max_grad_norm: Positive | None = None

    def __post_init__(self) -> None:
        if self.batch_size > self.frames_per_batch:
            raise ValueError(
                f"batch_size={self.batch_size}: it should not exceed frames_per_batch={self.frames_per_batch}."
            )
