"""Receding horizon planning guided by a heuristic (Sec. 5.2, Algorithm 1)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from visualrhp.errors import ConfigError, SimulationError
from visualrhp.heuristics.heuristic import Guidance, Heuristic
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy, Rollout, Timing
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

    **With a deadline** a decision is the best of as many roll-outs as there is time for, n after n; the decision holds
    them all. The heuristic values all roll-outs at every depth, so that one that the deadline stops is as good as one
    of a shorter horizon: it ends where it was last valued, or in its terminal state. After the deadline no action is
    simulated any more, so a decision is late by one simulated action at most; a call of the heuristic is not begun if
    it would end late, going by the longest one of this decision. Only the first call is always made: a deadline that
    leaves no time for a roll-out gets the mode of the heuristic's policy, as Greedy would answer. How many roll-outs
    fit depends on the machine and its load, so **decisions with a deadline are not reproducible**; those without one
    are.

    Args:
        heuristic: the stochastic policy and the value estimate.
        num_rollouts: n, at least 1; with a deadline, how many advance together.
        horizon: h, at least 1.
        discount: gamma, in (0, 1].
        name: name in tables and figures; "RHP {n}x{h}" by default, with the deadline if there is one.
        deadline_s: how long a decision may take [s]; None for n roll-outs, however long they take. The decisions of one
            :meth:`plan_batch` share it.
        clock: tells the time [s].

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
        deadline_s: float | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        if num_rollouts < 1:
            raise ConfigError(f"num_rollouts is the number of roll-outs n and must be at least 1, not {num_rollouts}.")
        if horizon < 1:
            raise ConfigError(f"horizon is the depth h of a roll-out and must be at least 1, not {horizon}.")
        if not 0.0 < discount <= 1.0:
            raise ConfigError(f"discount is gamma of Eq. 3 and must be in (0, 1], not {discount}.")
        if deadline_s is not None and not (deadline_s > 0.0 and math.isfinite(deadline_s)):
            raise ConfigError(f"deadline_s is how long a decision may take and must be positive, not {deadline_s}.")
        self.heuristic = heuristic
        self.num_rollouts = num_rollouts
        self.horizon = horizon
        self.discount = discount
        self.deadline_s = deadline_s
        limit = "" if deadline_s is None else f" in {1000.0 * deadline_s:g} ms"
        self._name = name or f"RHP {num_rollouts}x{horizon}{limit}"
        self._clock = clock

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
        watch = _Watch(self._clock, self.deadline_s)
        root = watch.guide(self.heuristic, [model.scene for model in models], states)
        known: list[_Known] = [{} for _ in models]
        finished: list[list[Rollout]] = [[] for _ in models]
        for _ in watch.rounds():
            first_actions = [root.sample(rngs) for _ in range(self.num_rollouts)]  # [n, B]
            growing = [
                [_GrowingRollout(*task, first_actions[i][b]) for i in range(self.num_rollouts)]
                for b, task in enumerate(zip(models, rngs, known, states, strict=True))
            ]  # [B, n]
            self._grow([rollout for rollouts in growing for rollout in rollouts], watch)
            for b, rollouts in enumerate(growing):
                finished[b] += [rollout.finish(self.discount) for rollout in rollouts if rollout.is_valued]

        best = [max(rollouts, key=_return, default=None) for rollouts in finished]
        is_lost = any(rollout is None or rollout.is_diverged for rollout in best)
        modes = root.mode() if is_lost else [None] * len(best)
        timing = watch.timing()
        return [
            Decision(
                action=mode if rollout is None or rollout.is_diverged else rollout.actions[0],
                rollouts=tuple(rollouts),
                num_invalid=sum(rollout.is_diverged for rollout in rollouts),
                timing=timing,
            )
            for rollout, rollouts, mode in zip(best, finished, modes, strict=True)
        ]

    def _grow(self, rollouts: list[_GrowingRollout], watch: _Watch) -> None:
        """Simulate h actions of every roll-out, or until it is over, and value its last state."""
        for depth in range(1, self.horizon + 1):
            if not watch.simulate(rollouts):
                return
            rollouts = [rollout for rollout in rollouts if rollout.is_open]
            if not rollouts or watch.is_too_late_to_guide():
                return
            scenes = [rollout.model.scene for rollout in rollouts]
            guidance = watch.guide(self.heuristic, scenes, [rollout.current for rollout in rollouts])
            for rollout, value in zip(rollouts, guidance.values.tolist(), strict=True):
                rollout.value(value)
            if depth < self.horizon:
                actions = guidance.sample([rollout.rng for rollout in rollouts])
                for rollout, action in zip(rollouts, actions, strict=True):
                    rollout.next_action = action


def _return(rollout: Rollout) -> float:
    return rollout.total_return


class _Watch:
    """Measures the parts of a decision, and keeps the deadline."""

    def __init__(self, clock: Callable[[], float], deadline_s: float | None) -> None:
        self._clock = clock
        self._start = clock()
        self._end = None if deadline_s is None else self._start + deadline_s
        self._simulation_s = self._observation_s = self._heuristic_s = 0.0
        self._longest_call_s = 0.0

    def rounds(self) -> Iterator[None]:
        """One round of roll-outs without a deadline; with one, as many as there is time for."""
        if self._end is None:
            yield
        while self._end is not None and not self.is_too_late_to_guide():
            yield

    def simulate(self, rollouts: Sequence[_GrowingRollout]) -> bool:
        """Simulate the next action of each roll-out; False if the deadline came before the last of them."""
        start = self._clock()
        for rollout in rollouts:
            if self._end is not None and self._clock() >= self._end:
                self._simulation_s += self._clock() - start
                return False
            rollout.simulate()
        self._simulation_s += self._clock() - start
        return True

    def guide(self, heuristic: Heuristic, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        """Ask the heuristic."""
        start = self._clock()
        guidance = heuristic.guide(scenes, states)
        duration = self._clock() - start
        self._longest_call_s = max(self._longest_call_s, duration)
        self._observation_s += guidance.observation_s
        self._heuristic_s += duration - guidance.observation_s
        return guidance

    def is_too_late_to_guide(self) -> bool:
        """Whether a call of the heuristic as long as the longest one would miss the deadline."""
        if self._end is None:
            return False
        now = self._clock()
        return now >= self._end or now + self._longest_call_s > self._end

    def timing(self) -> Timing:
        """What was measured, up to now."""
        total_s = self._clock() - self._start
        return Timing(total_s, self._simulation_s, self._observation_s, self._heuristic_s)


_Known = dict[tuple[State, int], Transition]


@dataclass(slots=True)
class _GrowingRollout:
    """A roll-out of Algorithm 1 under way.

    Attributes:
        known: transitions that were simulated in this decision.
        num_valued: actions after which the roll-out had the value ``value_estimate``; 0 if it has none yet.
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
        """The state that it has come to."""
        return self.transitions[-1].next_state if self.transitions else self.state

    @property
    def is_terminal(self) -> bool:
        """Whether there is nothing left to do."""
        return bool(self.transitions) and self.transitions[-1].is_terminal

    @property
    def is_open(self) -> bool:
        """Whether it can go on: neither diverged nor in a terminal state."""
        return not self.is_diverged and not self.is_terminal

    @property
    def is_valued(self) -> bool:
        """Whether it has a return, if only minus infinity; otherwise the deadline came before it had one."""
        return self.num_valued > 0 or not self.is_open

    def simulate(self) -> None:
        """s, r <- simulatePhysics(s, a). Discrete roll-outs often begin alike: what is in ``known`` is not redone."""
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
        """Note v of the state that it has come to."""
        self.value_estimate, self.num_valued = estimate, len(self.transitions)

    def finish(self, discount: float) -> Rollout:
        """Return the finished roll-out with its return (Eq. 3)."""
        if self.is_open:  # a deadline may have come after the last action and before its value
            del self.actions[self.num_valued :], self.transitions[self.num_valued :]
        states = [self.state, *(transition.next_state for transition in self.transitions)]
        rewards = [transition.reward for transition in self.transitions]
        value_estimate = math.nan if self.is_diverged else 0.0 if self.is_terminal else self.value_estimate
        return Rollout.of(self.actions, states, rewards, value_estimate, discount)
