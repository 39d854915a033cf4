"""Receding horizon planning guided by a heuristic (Sec. 5.2, Algorithm 1)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from visualrhp.errors import SimulationError
from visualrhp.heuristics.heuristic import Guidance, Heuristic
from visualrhp.parameters import Count, Discount, Positive, SkipValidation, parameters
from visualrhp.planning.deadline import DecisionClock
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy, Rollout
from visualrhp.simulation.rules import DISCOUNT
from visualrhp.types import Action, State, Transition


@parameters(kw_only=True)
class RecedingHorizonParameters:
    """Parameters of Algorithm 1; the defaults are those of VisualRHP 3x3 (Sec. 7.5).

    Attributes:
        num_rollouts: n; with a deadline, the number of roll-outs per round.
        horizon: h.
        discount: gamma.
        deadline_s: time limit of a decision [s]; None for n roll-outs without a limit. The decisions of one
            :meth:`RecedingHorizon.plan_batch` share it.
        name: in tables and figures; "RHP {n}x{h}" by default, with the deadline if there is one.

    Raises:
        ConfigError: a parameter is out of range.
    """

    num_rollouts: Count = 3
    horizon: Count = 3
    discount: Discount = DISCOUNT
    deadline_s: Positive | None = None
    name: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            limit = "" if self.deadline_s is None else f" in {1000.0 * self.deadline_s:g} ms"
            object.__setattr__(self, "name", f"RHP {self.num_rollouts}x{self.horizon}{limit}")


@parameters
class RecedingHorizon(RecedingHorizonParameters, Planner):
    r"""VisualRHP, Algorithm 1: chooses the first action of the roll-out with the highest return.

    The actions of a roll-out are sampled from the heuristic's stochastic policy. Its return is (Eq. 3)

    .. math:: R_{t:h} = r_1 + \gamma r_2 + \dots + \gamma^{h-1} r_h + \gamma^h v(s_h).

    It stops early in a terminal state (goal or drop), which is not bootstrapped. With other heuristics, the same
    algorithm is CartesianRHP or CraftedHeuristicRHP (Sec. 7.5).

    All roll-outs advance together, so the heuristic is called h + 1 times per decision, for any n. A roll-out that
    diverges (the physics fails, or a pose, reward or value is not finite) has a return of minus infinity and is
    counted. If all roll-outs diverge, the action is the mode of the heuristic's policy. Ties go to the first roll-out.

    **With a deadline**, a decision chooses the best of as many roll-outs as fit, in rounds of n; it holds all of them.
    The heuristic evaluates all roll-outs at every depth, so a roll-out that the deadline stops is equivalent to one
    with a shorter horizon: it ends in the last state with a value, or in its terminal state. A decision is late by at
    most one simulated action (:class:`~visualrhp.planning.deadline.DecisionClock`). If there is no time for a roll-out,
    the action is the mode of the heuristic's policy, as of Greedy. The number of roll-outs depends on the machine and
    its load, so **decisions with a deadline are not reproducible**; those without one are.

    Attributes:
        heuristic: the stochastic policy and the value estimate.
        clock: returns the time [s].
        num_rollouts, horizon, discount, deadline_s, name: see :class:`RecedingHorizonParameters`.
    """

    heuristic: SkipValidation[Heuristic]
    clock: SkipValidation[Callable[[], float]] = field(default=time.perf_counter, kw_only=True, repr=False)

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
        """Choose an action in each of B independent tasks; their roll-outs share the calls of the heuristic.

        Args:
            models: B models, one per task.
            states: B current states s_cur, none terminal.
            rngs: B generators, one per task, so that a decision does not depend on the other tasks.

        Returns:
            B decisions.
        """
        clock = DecisionClock(self.clock, self.deadline_s)
        known: list[_Known] = [{} for _ in models]
        finished: list[list[Rollout]] = [[] for _ in models]
        root = clock.guide(self.heuristic, [model.scene for model in models], states)
        for _ in clock.rounds():  # one round without a deadline
            # FirstAction: a ~ pi(.|s_cur), n samples in every task.
            first_actions = [root.sample(rngs) for _ in range(self.num_rollouts)]  # [n, B]
            rollouts = [
                [_GrowingRollout(*task, first_actions[i][b]) for i in range(self.num_rollouts)]
                for b, task in enumerate(zip(models, rngs, known, states, strict=True))
            ]  # [B, n]
            growing = [rollout for task in rollouts for rollout in task]
            for depth in range(1, self.horizon + 1):
                # s <- simulatePhysics(s, a), r <- receiveRewards
                if not clock.simulate(growing):
                    break
                # if isTerminal(s): break
                growing = [rollout for rollout in growing if rollout.is_open]
                if not growing or clock.is_too_late_to_guide():
                    break
                # v(s), and a ~ pi(.|s) for the next action
                scenes = [rollout.model.scene for rollout in growing]
                guidance = clock.guide(self.heuristic, scenes, [rollout.current for rollout in growing])
                for rollout, value in zip(growing, guidance.values.tolist(), strict=True):
                    rollout.value(value)
                if depth < self.horizon:
                    actions = guidance.sample([rollout.rng for rollout in growing])
                    for rollout, action in zip(growing, actions, strict=True):
                        rollout.next_action = action
            # R <- R + gamma^h v(s), unless isTerminal(s) (Eq. 3)
            for b, task in enumerate(rollouts):
                finished[b] += [rollout.finish(self.discount) for rollout in task if rollout.is_valued]
        # FirstAction[argmax(RolloutsReturn)]
        return _choose(finished, root, clock)


def _choose(finished: Sequence[Sequence[Rollout]], root: Guidance, clock: DecisionClock) -> list[Decision]:
    """The first action of the best roll-out of every task; the mode of the policy if none has a return."""
    best = [max(rollouts, key=lambda rollout: rollout.total_return, default=None) for rollouts in finished]
    is_lost = any(rollout is None or rollout.is_diverged for rollout in best)
    modes = root.mode() if is_lost else [None] * len(best)
    timing = clock.timing()
    return [
        Decision(
            action=mode if rollout is None or rollout.is_diverged else rollout.actions[0],
            rollouts=tuple(rollouts),
            num_invalid=sum(rollout.is_diverged for rollout in rollouts),
            timing=timing,
        )
        for rollout, rollouts, mode in zip(best, finished, modes, strict=True)
    ]


_Known = dict[tuple[State, int], Transition]


@dataclass(slots=True)
class _GrowingRollout:
    """A roll-out of Algorithm 1 in progress.

    Attributes:
        known: transitions that were simulated in this decision.
        num_valued: number of actions before the state with value ``value_estimate``; 0 if there is no value yet.
    """

    model: PlanningModel
    rng: np.random.Generator
    known: _Known
    state: State
    next_action: Action
    actions: list[Action] = field(default_factory=list)
    transitions: list[Transition] = field(default_factory=list)
    value_estimate: float = 0.0
    num_valued: int = 0
    is_diverged: bool = False

    @property
    def current(self) -> State:
        """The last state."""
        return self.transitions[-1].next_state if self.transitions else self.state

    @property
    def is_terminal(self) -> bool:
        """Whether it has reached a terminal state."""
        return bool(self.transitions) and self.transitions[-1].is_terminal

    @property
    def is_open(self) -> bool:
        """Whether it continues: neither diverged nor in a terminal state."""
        return not self.is_diverged and not self.is_terminal

    @property
    def is_valued(self) -> bool:
        """Whether it has a return, possibly minus infinity; otherwise the deadline passed before it had one."""
        return self.num_valued > 0 or not self.is_open

    def simulate(self) -> None:
        """s, r <- simulatePhysics(s, a). Discrete roll-outs often share their first actions, so ``known`` is reused."""
        current = self.current
        self.actions.append(self.next_action)
        key = (current, self.next_action) if isinstance(self.next_action, int) else None
        transition = self.known.get(key) if key is not None else None
        if transition is None:
            try:
                transition = self.model.simulate(current, self.next_action)
            except SimulationError:
                self.is_diverged = True
                return
            if key is not None:
                self.known[key] = transition
        if not math.isfinite(transition.reward + sum(transition.next_state.vector.tolist())):
            self.is_diverged = True
            return
        self.transitions.append(transition)

    def value(self, estimate: float) -> None:
        """Set v of the last state."""
        self.value_estimate, self.num_valued = estimate, len(self.transitions)

    def finish(self, discount: float) -> Rollout:
        """Return the finished roll-out with its return (Eq. 3)."""
        if self.is_open:  # the deadline may have passed between the last action and its value
            del self.actions[self.num_valued :], self.transitions[self.num_valued :]
        states = [self.state, *(transition.next_state for transition in self.transitions)]
        rewards = [transition.reward for transition in self.transitions]
        value_estimate = math.nan if self.is_diverged else 0.0 if self.is_terminal else self.value_estimate
        return Rollout.of(self.actions, states, rewards, value_estimate, discount)
