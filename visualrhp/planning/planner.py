"""The interface of planners: given a transition model and a random generator, a planner returns a policy."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from visualrhp.scene.scene import Scene
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.simulation.rules import DISCOUNT
from visualrhp.types import Action, State, Transition

RolloutOrigin = Literal["policy", "mode", "warm start", "resampling", "plan"]
"""Where the actions of a roll-out come from (see :class:`visualrhp.planning.RecedingHorizon`); ``plan``: a plan that is
followed."""


class PlanningModel(Protocol):
    """The model that planning needs: :class:`visualrhp.simulation.TransitionModel`, or an object that behaves like it.

    ``simulate`` is a pure function of (state, action).
    """

    @property
    def scene(self) -> Scene:
        """The scene of the states, which the heuristic observes."""
        ...

    @property
    def action_space(self) -> ActionSpace:
        """The action space of ``simulate``."""
        ...

    def simulate(self, state: State, action: Action) -> Transition:
        """Apply ``action`` in ``state``. Raises SimulationError when the physics diverges."""
        ...

    def is_goal(self, state: State) -> bool:
        """Whether ``state`` is valid and has the desired object in the target region."""
        ...

    def perturbed(self, relative_std: float, turning_std: float, rng: np.random.Generator) -> PlanningModel:
        """A model that differs from this one as the world might (robust look-ahead).

        Args:
            relative_std: standard deviation of shapes, friction and density, relative to their values.
            turning_std: the same of the resistance of the surface to turning.
            rng: source of the random numbers.
        """
        ...


@dataclass(frozen=True, slots=True)
class Rollout:
    """A simulated sequence of actions: a roll-out of Algorithm 1, or the rest of a plan that is followed.

    Time indices: ``actions[k]`` is taken in ``states[k]``, earns ``rewards[k]`` and leads to ``states[k + 1]``.

    Attributes:
        actions: of a roll-out up to h, or fewer if it reached a terminal state, diverged, or was cut short by a
            deadline; an action on which the physics diverged is the last, without a reward. Of a plan, its rest.
        states: one more than rewards. A roll-out begins in the current state, the rest of a plan in the predicted
            one.
        rewards: one per simulated action.
        value_estimate: v of the last state, 0 if that state is terminal, NaN if the roll-out diverged. 0 for planners
            without an estimate.
        total_return: R_{t:h} of Eq. 3; minus infinity if the roll-out diverged.
        origin: of its actions.
        robust_return: its return over the nominal and the perturbed models (robust look-ahead); None if it was not
            judged in these.
        prior: of its first action, added to its return in comparisons; 0 without a prior.
    """

    actions: tuple[Action, ...]
    states: tuple[State, ...]
    rewards: tuple[float, ...]
    value_estimate: float
    total_return: float
    origin: RolloutOrigin = "policy"
    robust_return: float | None = None
    prior: float = 0.0

    @property
    def compared(self) -> float:
        """The return by which roll-outs are compared."""
        return (self.total_return if self.robust_return is None else self.robust_return) + self.prior

    @classmethod
    def of(
        cls,
        actions: Sequence[Action],
        states: Sequence[State],
        rewards: Sequence[float],
        value_estimate: float = 0.0,
        discount: float = DISCOUNT,
        origin: RolloutOrigin = "policy",
    ) -> Rollout:
        """Make a roll-out with its return; it has diverged if ``value_estimate`` is not finite."""
        total_return = sum(discount**k * reward for k, reward in enumerate(rewards))
        total_return += discount ** len(rewards) * value_estimate
        if not math.isfinite(value_estimate):
            total_return, value_estimate = -math.inf, math.nan
        return cls(tuple(actions), tuple(states), tuple(rewards), value_estimate, total_return, origin)

    @property
    def is_diverged(self) -> bool:
        """Whether it diverged and has no return."""
        return self.total_return == -math.inf


@dataclass(frozen=True, slots=True)
class Timing:
    """Wall-clock time of a decision [s]; for tasks that are planned together, of all their decisions.

    Attributes:
        total_s: total time.
        simulation_s: simulation of actions.
        observation_s: observations for the network.
        heuristic_s: evaluation of the heuristic, without observations.
    """

    total_s: float
    simulation_s: float
    observation_s: float
    heuristic_s: float


@dataclass(frozen=True, slots=True)
class Decision:
    """The output of a policy: an action, and the roll-outs behind it.

    Attributes:
        action: the action to execute now, or None if the planner gives up: the task then counts as not completed.
        rollouts: the roll-outs that were compared, or the plan that is followed; empty for planners that have neither.
        num_invalid: number of roll-outs that diverged.
        timing: durations, for planners that measure them; not part of the comparison of decisions.
        chosen: index of the roll-out whose first action is executed; None if it is the action of no roll-out.
    """

    action: Action | None
    rollouts: tuple[Rollout, ...] = ()
    num_invalid: int = 0
    timing: Timing | None = field(default=None, compare=False)
    chosen: int | None = None


class Policy(Protocol):
    """Maps states to decisions; called once per action, in the order of the episode."""

    def __call__(self, state: State) -> Decision:
        """Decide in ``state``."""
        ...


class Planner(ABC):
    """Base class of planners. A planner holds only its configuration; the state of an episode is in the policy.

    Attributes:
        name: in tables and figures.
    """

    name: str

    @abstractmethod
    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        """Return a policy for one episode that plans with ``model``; all its random numbers come from ``rng``."""
