"""The interface of heuristics: a stochastic policy to sample from, and an estimate of the remaining return.

In Algorithm 1 the heuristic proposes the actions of a roll-out and estimates the rewards beyond the horizon (Sec. 5.2).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from visualrhp.scene.scene import Scene
from visualrhp.simulation.action_spaces import DiscreteActionSpace, make_action_space
from visualrhp.streams import mode_generator
from visualrhp.types import Action, ActionSpaceName, FloatArray, State


class Guidance(ABC):
    """Policy and value of a heuristic in B states.

    Attributes:
        values: [B] expected return from each state.
        observation_s: duration of the observations [s]; 0 for a heuristic that reads the states directly.
    """

    values: FloatArray
    observation_s: float = 0.0

    @abstractmethod
    def sample(self, rngs: Sequence[np.random.Generator]) -> list[Action]:
        """Sample an action for every state, each with its own generator."""

    def sample_distinct(self, count: int, tried: Collection[int], rng: np.random.Generator) -> list[Action]:
        """Sample up to ``count`` different actions for a single state.

        Discrete actions are sampled without replacement, and those in ``tried`` only after all others. Continuous
        samples always differ.
        """
        return [self.sample([rng])[0] for _ in range(count)]

    def log_probability(self, action: int) -> float:
        """Log-probability of a discrete action in a single state, up to a constant; 0 if it is unknown."""
        return 0.0

    @abstractmethod
    def mode(self) -> list[Action]:
        """The most likely action of every state."""

    @abstractmethod
    def take(self, rows: Sequence[int]) -> Guidance:
        """The guidance of the states with these indices."""

    @abstractmethod
    def widened(self, factor: float) -> Guidance:
        """A policy with ``factor`` times the standard deviation or temperature, and the same values."""


class Heuristic(ABC):
    """Guides a planner in one action space.

    Attributes:
        action_space: name of the action space.
    """

    action_space: ActionSpaceName

    @abstractmethod
    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        """Evaluate B states, each in its scene, in one call."""


@dataclass(frozen=True)
class SoftmaxGuidance(Guidance):
    r"""Policy and value from action values.

    .. math:: P(a|s) = \frac{\exp(q(s, a) / \tau)}{\sum_{a_i} \exp(q(s, a_i) / \tau)}, \quad v(s) = \max_a q(s, a)

    (Eq. 2 and Sec. 5.2).

    Attributes:
        q_values: [B, 8] q(s, a).
        temperature: tau.
    """

    q_values: FloatArray
    temperature: float
    observation_s: float = field(default=0.0, compare=False)

    @property
    def values(self) -> FloatArray:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.q_values.max(axis=1)

    @property
    def probabilities(self) -> FloatArray:
        """[B, 8] P(a|s)."""
        scaled = self.q_values / self.temperature
        weights = np.exp(scaled - scaled.max(axis=1, keepdims=True))
        return weights / weights.sum(axis=1, keepdims=True)

    @cached_property
    def _cumulative(self) -> list[list[float]]:
        return np.cumsum(self.probabilities, axis=1).tolist()

    def sample(self, rngs: Sequence[np.random.Generator]) -> list[Action]:
        # With NaN no comparison holds, and the search ends after the last action.
        last = self.q_values.shape[1] - 1
        return [
            min(bisect_right(row, rng.random() * row[-1]), last)
            for row, rng in zip(self._cumulative, rngs, strict=True)
        ]

    def sample_distinct(self, count: int, tried: Collection[int], rng: np.random.Generator) -> list[Action]:
        return _without_replacement(self.q_values[0] / self.temperature, count, tried, rng)

    def log_probability(self, action: int) -> float:
        scaled = self.q_values[0] / self.temperature
        return float(scaled[action] - scaled.max() - np.log(np.exp(scaled - scaled.max()).sum()))

    def mode(self) -> list[Action]:
        return [int(action) for action in self.q_values.argmax(axis=1)]

    def take(self, rows: Sequence[int]) -> SoftmaxGuidance:
        return replace(self, q_values=self.q_values[list(rows)])

    def widened(self, factor: float) -> SoftmaxGuidance:
        return replace(self, temperature=factor * self.temperature)


@dataclass(frozen=True)
class GaussianGuidance(Guidance):
    """A diagonal Gaussian policy and its value, N(mu, sigma) of Sec. 4.

    Attributes:
        means: [B, 4] in [-1, 1].
        stds: [B, 4].
        values: [B].
    """

    means: FloatArray
    stds: FloatArray
    values: FloatArray
    observation_s: float = field(default=0.0, compare=False)

    def sample(self, rngs: Sequence[np.random.Generator]) -> list[Action]:
        draws = np.array([rng.standard_normal(self.means.shape[1]) for rng in rngs])
        return list(self.means + self.stds * draws)

    def mode(self) -> list[Action]:
        return list(self.means)

    def take(self, rows: Sequence[int]) -> GaussianGuidance:
        chosen = list(rows)
        return replace(self, means=self.means[chosen], stds=self.stds[chosen], values=self.values[chosen])

    def widened(self, factor: float) -> GaussianGuidance:
        return replace(self, stds=factor * self.stds)


@dataclass(frozen=True)
class UniformGuidance(Guidance):
    """A uniform policy; its mode is the first action of a fixed stream, since all actions are equally likely.

    Attributes:
        action_space: name of the action space.
        values: [B].
    """

    action_space: ActionSpaceName
    values: FloatArray

    def sample(self, rngs: Sequence[np.random.Generator]) -> list[Action]:
        action_space = make_action_space(self.action_space)
        return [action_space.sample(rng) for rng in rngs]

    def sample_distinct(self, count: int, tried: Collection[int], rng: np.random.Generator) -> list[Action]:
        if self.action_space != "discrete":
            return super().sample_distinct(count, tried, rng)
        return _without_replacement(np.zeros(DiscreteActionSpace.NUM_ACTIONS), count, tried, rng)

    def mode(self) -> list[Action]:
        return self.sample([mode_generator() for _ in self.values])

    def take(self, rows: Sequence[int]) -> UniformGuidance:
        return replace(self, values=self.values[list(rows)])

    def widened(self, factor: float) -> UniformGuidance:
        return self


def _without_replacement(
    logits: FloatArray, count: int, tried: Collection[int], rng: np.random.Generator
) -> list[Action]:
    """The largest of logits plus Gumbel noise are a sample without replacement (Kool et al., ICML 2019)."""
    keys = logits + rng.gumbel(size=len(logits))
    order = np.argsort(-keys, kind="stable").tolist()
    return sorted(order, key=lambda action: action in tried)[:count]
