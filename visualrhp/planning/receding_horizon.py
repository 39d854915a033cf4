"""Receding horizon planning guided by a heuristic (Sec. 5.2, Algorithm 1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from visualrhp.errors import ConfigError, SimulationError
from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy, Rollout
from visualrhp.scene.scene import Scene
from visualrhp.simulation.task import DISCOUNT
from visualrhp.types import Action, State, Transition


class RecedingHorizon(Planner):
    r"""VisualRHP of Algorithm 1: the first action of the roll-out of the highest return.

    A roll-out of actions drawn from the heuristic's stochastic policy earns (Eq. 3)

    .. math:: R_{t:h} = r_1 + \gamma r_2 + \dots + \gamma^{h-1} r_h + \gamma^h v(s_h),

    and stops early in a terminal state (goal or drop), after which there is nothing to bootstrap from. With other
    heuristics the same algorithm is CartesianRHP and CraftedHeuristicRHP (Sec. 7.5).

    All roll-outs advance together, so that the heuristic is called h + 1 times a decision, whatever n is. A roll-out
    that diverges (the physics fails, or a pose, reward or value is not finite) returns minus infinity and is counted.
    If all diverge, the decision is the mode of the heuristic's policy. The first of equal returns wins.

    Args:
        heuristic: the stochastic policy and the value estimate.
        num_rollouts: n, at least 1.
        horizon: h, at least 1.
        discount: gamma, in (0, 1].
        name: name in tables and figures; "RHP {n}x{h}" by default.

    Raises:
        ConfigError: a parameter is out of range.
    """

    def __init__(
        self,
        heuristic: Heuristic,
        num_rollouts: int = 3,
        horizon: int = 3,
        discount: float = DISCOUNT,
        name: str | None = None,
    ) -> None:
        if num_rollouts < 1:
            raise ConfigError(f"num_rollouts is the number of roll-outs n and must be at least 1, not {num_rollouts}.")
        if horizon < 1:
            raise ConfigError(f"horizon is the depth h of a roll-out and must be at least 1, not {horizon}.")
        if not 0.0 < discount <= 1.0:
            raise ConfigError(f"discount is gamma of Eq. 3 and must be in (0, 1], not {discount}.")
        self.heuristic = heuristic
        self.num_rollouts = num_rollouts
        self.horizon = horizon
        self.discount = discount
        self._name = name or f"RHP {num_rollouts}x{horizon}"

    @property
    def name(self) -> str:
        return self._name

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        def policy(state: State) -> Decision:
            return self.plan(model, state, rng)

        return policy

    def plan(self, model: PlanningModel, state: State, rng: np.random.Generator) -> Decision:
        """Choose an action in ``state`` (Algorithm 1)."""
        return self.plan_batch([model], [state], [rng])[0]

    def plan_batch(
        self, models: Sequence[PlanningModel], states: Sequence[State], rngs: Sequence[np.random.Generator]
    ) -> list[Decision]:
        """Choose an action in each of B independent tasks; the roll-outs of all share the calls of the heuristic.

        Args:
            models: B models, one per task.
            states: B current states, none terminal.
            rngs: B generators. A task draws from its own alone, so its decision does not depend on its neighbours.

        Returns:
            B decisions.
        """
        root = self.heuristic.guide([model.scene for model in models], states)
        first_actions = [root.sample(rngs) for _ in range(self.num_rollouts)]  # [n, B]
        growing = [
            [_GrowingRollout(model, rng, state, first_actions[i][b]) for i in range(self.num_rollouts)]
            for b, (model, rng, state) in enumerate(zip(models, rngs, states, strict=True))
        ]  # [B, n]
        known: list[_Known] = [{} for _ in models]
        active = [(rollout, known[b]) for b, rollouts in enumerate(growing) for rollout in rollouts]
        for depth in range(1, self.horizon + 1):
            for rollout, memory in active:
                rollout.simulate(memory)
            active = [(rollout, memory) for rollout, memory in active if rollout.is_open]
            if not active:
                break
            guidance = self.heuristic.guide(*_observed(active))
            if depth < self.horizon:
                actions = guidance.sample([rollout.rng for rollout, _ in active])
                for (rollout, _), action in zip(active, actions, strict=True):
                    rollout.next_action = action
            else:
                for (rollout, _), value in zip(active, guidance.values, strict=True):
                    rollout.value_estimate = float(value)

        modes: list[Action] | None = None
        decisions = []
        for b, rollouts in enumerate(growing):
            finished = tuple(rollout.finish(self.discount) for rollout in rollouts)
            returns = np.array([rollout.total_return for rollout in finished])
            num_invalid = int(np.count_nonzero(np.isneginf(returns)))
            if num_invalid < len(finished):
                action = finished[int(np.argmax(returns))].actions[0]
            else:
                modes = root.mode() if modes is None else modes
                action = modes[b]
            decisions.append(Decision(action=action, rollouts=finished, num_invalid=num_invalid))
        return decisions


_Known = dict[tuple[State, int], Transition]


@dataclass(slots=True)
class _GrowingRollout:
    """A roll-out of Algorithm 1 under way."""

    model: PlanningModel
    rng: np.random.Generator
    state: State
    next_action: Action
    actions: list[Action] = field(default_factory=list)
    transitions: list[Transition] = field(default_factory=list)
    value_estimate: float = 0.0
    is_diverged: bool = False

    @property
    def is_open(self) -> bool:
        """Whether it can go on: neither diverged nor in a terminal state."""
        return not self.is_diverged and not self.transitions[-1].is_terminal

    def simulate(self, known: _Known) -> None:
        """s, r <- simulatePhysics(s, a). Discrete roll-outs often begin alike: what is in ``known`` is not redone."""
        current = self.transitions[-1].next_state if self.transitions else self.state
        self.actions.append(self.next_action)
        key = (current, self.next_action) if isinstance(self.next_action, int) else None
        transition = known.get(key) if key is not None else None
        if transition is None:
            try:
                transition = self.model.simulate(current, self.next_action)
            except SimulationError:
                self.is_diverged = True
                return
            if key is not None:
                known[key] = transition
        if not (math.isfinite(transition.reward) and np.isfinite(transition.next_state.vector).all()):
            self.is_diverged = True
            return
        self.transitions.append(transition)

    def finish(self, discount: float) -> Rollout:
        """Return the finished roll-out with its return (Eq. 3)."""
        rewards = tuple(transition.reward for transition in self.transitions)
        if self.is_diverged or not math.isfinite(self.value_estimate):
            total_return, value_estimate = -math.inf, math.nan
        else:
            value_estimate = self.value_estimate
            total_return = sum(discount**k * reward for k, reward in enumerate(rewards))
            if not self.transitions[-1].is_terminal:
                total_return += discount ** len(rewards) * value_estimate
        states = (self.state, *(transition.next_state for transition in self.transitions))
        return Rollout(tuple(self.actions), states, rewards, value_estimate, total_return)


def _observed(active: Sequence[tuple[_GrowingRollout, _Known]]) -> tuple[list[Scene], list[State]]:
    """Return the scenes and the current states of the open roll-outs."""
    scenes = [rollout.model.scene for rollout, _ in active]
    states = [rollout.transitions[-1].next_state for rollout, _ in active]
    return scenes, states
