"""Roll-outs of receding horizon planning while they grow, and the origin of their actions."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from visualrhp.errors import SimulationError
from visualrhp.planning.planner import PlanningModel, Rollout, RolloutOrigin
from visualrhp.types import Action, State, Transition

KnownTransitions = dict[tuple[State, int], Transition]
"""Transitions of discrete actions that were simulated in a decision."""


@dataclass(slots=True)
class Candidate:
    """A roll-out of Algorithm 1 in progress.

    Attributes:
        model: simulates it.
        rng: of the task.
        known: discrete roll-outs often share their first actions, so known transitions are reused.
        state: its first state.
        next_action: the action to simulate next.
        origin: of its actions.
        script: actions that it takes first, the first of them ``next_action``.
        num_valued: number of actions before the state with value ``value_estimate``; 0 if there is no value yet.
    """

    model: PlanningModel
    rng: np.random.Generator
    known: KnownTransitions
    state: State
    next_action: Action
    origin: RolloutOrigin = "policy"
    script: tuple[Action, ...] = ()
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
    def is_goal(self) -> bool:
        """Whether it has reached the goal."""
        return bool(self.transitions) and self.transitions[-1].is_goal

    @property
    def is_dropped(self) -> bool:
        """Whether it ends with a dropped object."""
        return bool(self.transitions) and self.transitions[-1].is_dropped

    @property
    def is_open(self) -> bool:
        """Whether it continues: neither diverged nor in a terminal state."""
        return not self.is_diverged and not self.is_terminal

    @property
    def is_valued(self) -> bool:
        """Whether it has a return, possibly minus infinity; otherwise the deadline passed before it had one."""
        return self.num_valued > 0 or not self.is_open

    @property
    def is_script_done(self) -> bool:
        """Whether it has taken all actions of its script."""
        return len(self.actions) >= len(self.script)

    @property
    def follows_mode(self) -> bool:
        """Whether its actions after the script are the mode of the policy; otherwise they are sampled."""
        return self.origin in ("mode", "warm start")

    def simulate(self) -> None:
        """s, r <- simulatePhysics(s, a)."""
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

    def choose_next(self, sampled: Action, mode: Action) -> None:
        """Choose the next action: of the script, the mode of the policy, or the sample."""
        if not self.is_script_done:
            self.next_action = self.script[len(self.actions)]
        else:
            self.next_action = mode if self.follows_mode else sampled

    def finish(self, discount: float) -> Rollout:
        """Return the finished roll-out with its return (Eq. 3)."""
        if self.is_open:  # the deadline may have passed between the last action and its value
            del self.actions[self.num_valued :], self.transitions[self.num_valued :]
        states = [self.state, *(transition.next_state for transition in self.transitions)]
        rewards = [transition.reward for transition in self.transitions]
        value_estimate = math.nan if self.is_diverged else 0.0 if self.is_terminal else self.value_estimate
        return Rollout.of(self.actions, states, rewards, value_estimate, discount, self.origin)
