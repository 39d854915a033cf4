"""What a planner is: a transition model and a random generator in, a policy out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from visualrhp.scene.scene import Scene
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.simulation.task import DISCOUNT
from visualrhp.types import Action, State, Transition


class PlanningModel(Protocol):
    """What planning needs of a world: :class:`visualrhp.simulation.TransitionModel`, or anything that behaves alike.

    ``simulate`` is a pure function of (state, action).
    """

    @property
    def scene(self) -> Scene:
        """The scene that the states belong to (the heuristic reads it)."""
        ...

    @property
    def action_space(self) -> ActionSpace:
        """The actions that ``simulate`` takes."""
        ...

    def simulate(self, state: State, action: Action) -> Transition:
        """Apply ``action`` in ``state``. Raises SimulationError when the physics diverges."""
        ...

    def is_goal(self, state: State) -> bool:
        """Whether ``state`` is valid and has the desired object in the target region."""
        ...


@dataclass(frozen=True, slots=True)
class Rollout:
    """One simulated look ahead: of receding horizon planning (Alg. 1), or what is left of a plan that is followed.

    Time indices: ``actions[k]`` is taken in ``states[k]``, earns ``rewards[k]`` and leads to ``states[k + 1]``.

    Attributes:
        actions: of a roll-out up to h, fewer when it reached a terminal state or diverged, or when a deadline cut it
            short; the one on which the physics diverged is the last, and has no reward. Of a plan, what is left of it.
        states: the states passed through: as many as rewards, plus one. A roll-out begins in the current state, the
            rest of a plan in the state that was foreseen.
        rewards: one per simulated action.
        value_estimate: v of the last state, or 0 if that is terminal and nothing is left to earn; NaN if it diverged.
            Planners without an estimate say 0.
        total_return: R_{t:h} of Eq. 3; minus infinity if the roll-out diverged.
    """

    actions: tuple[Action, ...]
    states: tuple[State, ...]
    rewards: tuple[float, ...]
    value_estimate: float
    total_return: float

    @classmethod
    def of(
        cls,
        actions: Sequence[Action],
        states: Sequence[State],
        rewards: Sequence[float],
        value_estimate: float = 0.0,
        discount: float = DISCOUNT,
    ) -> Rollout:
        """A roll-out with its return; one whose ``value_estimate`` is not finite has diverged."""
        total_return = sum(discount**k * reward for k, reward in enumerate(rewards))
        total_return += discount ** len(rewards) * value_estimate
        if not math.isfinite(value_estimate):
            total_return, value_estimate = -math.inf, math.nan
        return cls(tuple(actions), tuple(states), tuple(rewards), value_estimate, total_return)

    @property
    def is_diverged(self) -> bool:
        """Whether it has no return."""
        return self.total_return == -math.inf


@dataclass(frozen=True, slots=True)
class Timing:
    """How long a decision took on the wall [s]; for tasks that are planned together, how long it took for all of them.

    Attributes:
        total_s: all of it.
        simulation_s: simulating actions.
        observation_s: drawing what a network sees.
        heuristic_s: asking the heuristic, without the observations.
    """

    total_s: float
    simulation_s: float
    observation_s: float
    heuristic_s: float


@dataclass(frozen=True, slots=True)
class Decision:
    """What a policy answers, and what it considered on the way.

    Attributes:
        action: the action to execute now, or None if the planner gives up: the task then counts as not completed.
        rollouts: the roll-outs that were compared, or the plan that is followed; empty for planners that have neither.
        num_invalid: how many of them diverged.
        timing: how long it took, for planners that say so. Decisions that differ in nothing else are equal.
    """

    action: Action | None
    rollouts: tuple[Rollout, ...] = ()
    num_invalid: int = 0
    timing: Timing | None = field(default=None, compare=False)


class Policy(Protocol):
    """Answers states with decisions; called once an action, in the order in which an episode unfolds."""

    def __call__(self, state: State) -> Decision:
        """Decide in ``state``."""
        ...


class Planner(ABC):
    """A way to choose actions. It holds configuration only; what belongs to one episode lives in its policy."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name in tables and figures."""

    @abstractmethod
    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        """Return a policy for one episode that plans with ``model``; all its random draws come from ``rng``."""
