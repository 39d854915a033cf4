"""One task within a decision of receding horizon planning: its roll-outs, and the choice among them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from visualrhp.heuristics.heuristic import Guidance, Heuristic, UniformGuidance
from visualrhp.parameters import Count, Discount, Index, NonNegative, Positive, parameters
from visualrhp.planning.candidate import Candidate, KnownTransitions
from visualrhp.planning.deadline import DecisionClock
from visualrhp.planning.episode_memory import EpisodeMemory
from visualrhp.planning.planner import Decision, PlanningModel, Rollout, RolloutOrigin, Timing
from visualrhp.scene.noise import perturb_poses
from visualrhp.simulation.rules import DISCOUNT, is_dropped
from visualrhp.types import Action, State

_ATTEMPTS = 10
"""To sample a perturbed state without an object beyond the edges."""

WIDENING = 2.0
"""Factor of the standard deviation or temperature of the policy in the first resampling."""


@parameters(kw_only=True)
class RecedingHorizonParameters:
    """Parameters of Algorithm 1; the defaults are those of VisualRHP 3x3 (Sec. 7.5), without options.

    Attributes:
        num_rollouts: n; with a deadline, the number of roll-outs per round.
        horizon: h.
        discount: gamma.
        deadline_s: time limit of a decision [s]; None for n roll-outs without a limit. The decisions of one
            :meth:`RecedingHorizon.plan_batch` share it.
        warm_start: whether the rest of the last decision's chosen roll-out, continued by the mode, competes again.
        follow_mode: whether one more roll-out follows the mode of the policy.
        max_resamplings: how often n more roll-outs are drawn, from wider distributions, while the best roll-out is bad:
            it drops an object or diverges, in a perturbed model, too, or returns to a state of the episode if these
            are avoided.
        avoid_visited: whether a bad roll-out is chosen only if there is no other one; one whose first action leads to a
            state in which the episode has been is bad, too.
        distinct_actions: whether the sampled roll-outs of a round begin with different actions, and those of
            resampling with actions that were not tried, as long as there are any (discrete action space).
        prior_weight: weight of the log-probability of the first action, which is added to the return in the comparison
            of roll-outs (discrete action space).
        stop_at_goal: whether all roll-outs of a round end as soon as one of them reaches the goal.
        num_perturbed_models: k, number of perturbed models in which roll-outs are judged, too; 0 for the nominal alone.
        perturbation: relative standard deviation of the shapes, friction and density of their objects.
        turning_perturbation: the same of the resistance of the surface to turning.
        position_perturbation: standard deviation of the objects' x and y at the start of their roll-outs [m].
        angle_perturbation: the same of the objects' angles [rad].
        tolerated_drops: in how many perturbed models a roll-out may drop an object before it is bad.
        judgement: return of a roll-out in these models and the nominal one: their ``mean``, or the ``worst``.
        name: in tables and figures; "RHP {n}x{h}" by default.

    Raises:
        ConfigError: a parameter is out of range.
    """

    num_rollouts: Count = 3
    horizon: Count = 3
    discount: Discount = DISCOUNT
    deadline_s: Positive | None = None
    warm_start: bool = False
    follow_mode: bool = False
    max_resamplings: Index = 0
    avoid_visited: bool = False
    distinct_actions: bool = False
    prior_weight: NonNegative = 0.0
    stop_at_goal: bool = False
    num_perturbed_models: Index = 0
    perturbation: NonNegative = 0.05
    turning_perturbation: NonNegative = 0.0
    position_perturbation: NonNegative = 0.0
    angle_perturbation: NonNegative = 0.0
    tolerated_drops: Index = 0
    judgement: Literal["mean", "worst"] = "mean"
    name: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", f"RHP {self.num_rollouts}x{self.horizon}")


@dataclass(slots=True)
class DecisionTask:
    """The roll-outs of one task in a decision.

    A round is a set of roll-outs that grow together; resampling and deadlines add rounds.

    Attributes:
        model, state, rng, memory: of the task.
        root: the guidance of this state alone.
        planner: the parameters.
        known: transitions that were simulated in this decision, in the nominal model and in the perturbed ones.
        perturbed_states: the state as it might be, one for each perturbed model.
        growing: the roll-outs of the current round.
        rollouts: those of the closed rounds, and whether each is bad; if visited states are avoided, a bad one is
            chosen only if all are bad.
        num_failed_rounds: number of consecutive rounds after which even the best roll-out was bad.
    """

    model: PlanningModel
    state: State
    rng: np.random.Generator
    memory: EpisodeMemory
    root: Guidance
    planner: RecedingHorizonParameters
    known: list[KnownTransitions] = field(default_factory=list)
    perturbed_states: list[State] = field(default_factory=list)
    growing: list[Candidate] = field(default_factory=list)
    rollouts: list[tuple[Rollout, bool]] = field(default_factory=list)
    num_failed_rounds: int = 0

    def __post_init__(self) -> None:
        planner, memory = self.planner, self.memory
        memory.enter(self.state)
        while len(memory.perturbed_models) < planner.num_perturbed_models:
            memory.perturbed_models.append(
                self.model.perturbed(planner.perturbation, planner.turning_perturbation, self.rng)
            )
        self.perturbed_states = [self._perturbed_state() for _ in range(planner.num_perturbed_models)]
        self.known = [{} for _ in range(1 + planner.num_perturbed_models)]

    def _perturbed_state(self) -> State:
        position_std, angle_std = self.planner.position_perturbation, self.planner.angle_perturbation
        if position_std == angle_std == 0.0:
            return self.state
        for _ in range(_ATTEMPTS):
            state = perturb_poses(self.state, position_std, angle_std, self.rng)
            if not is_dropped(self.model.scene, state):
                return state
        return self.state  # an object at the very edge

    def first_candidates(self) -> list[Candidate]:
        """Begin the roll-outs of a round."""
        parts = (self.model, self.rng, self.known[0], self.state)
        is_first_round = not self.growing
        level = min(self.num_failed_rounds, self.planner.max_resamplings)
        origin: RolloutOrigin = "resampling" if level else "policy"
        self.growing = [Candidate(*parts, action, origin) for action in self._first_actions(level)]
        if is_first_round and self.planner.follow_mode:
            self.growing.append(Candidate(*parts, self.root.mode()[0], "mode"))
        if is_first_round and self.planner.warm_start and self.memory.rest:
            self.growing.append(Candidate(*parts, self.memory.rest[0], "warm start", self.memory.rest))
        return self.growing

    def _first_actions(self, level: int) -> list[Action]:
        """Sample the first actions of a round, from a wider policy at level 1 and uniformly above."""
        count, policy = self.planner.num_rollouts, self.root
        if level == 1:
            policy = policy.widened(WIDENING)
        elif level > 1:
            policy = UniformGuidance(self.model.action_space.name, self.root.values)
        if self.planner.distinct_actions:
            tried = {action for rollout, _ in self.rollouts if isinstance(action := rollout.actions[0], int)}
            return policy.sample_distinct(count, tried if level else (), self.rng)
        return [policy.sample([self.rng])[0] for _ in range(count)]

    @property
    def open_candidates(self) -> list[Candidate]:
        """The roll-outs of this round that continue."""
        return [] if self._is_stopped else [candidate for candidate in self.growing if candidate.is_open]

    @property
    def _is_stopped(self) -> bool:
        """Whether a roll-out of this round has reached the goal: longer ones have a lower return."""
        return self.planner.stop_at_goal and any(candidate.is_goal for candidate in self.growing)

    def close_round(self) -> None:
        """Compute the returns of the roll-outs of this round, and keep them."""
        for candidate in self.growing:
            if not candidate.is_valued or (self._is_stopped and candidate.is_open):
                continue
            rollout = candidate.finish(self.planner.discount)
            if self.planner.prior_weight and isinstance(action := rollout.actions[0], int):
                prior = self.planner.prior_weight * self.root.log_probability(action)
                rollout = replace(rollout, prior=0.0 if math.isnan(prior) else prior)
            is_bad = rollout.is_diverged or candidate.is_dropped or self._is_avoided(candidate)
            self.rollouts.append((rollout, is_bad))

    def replays_of_best(self) -> list[Candidate]:
        """The replays in the perturbed models of the roll-out to choose; empty if it is bad or judged already."""
        best = self.best()
        if best is None or self.rollouts[best][1] or self.rollouts[best][0].robust_return is not None:
            return []
        actions = self.rollouts[best][0].actions
        models = self.memory.perturbed_models[: self.planner.num_perturbed_models]
        return [
            Candidate(model, self.rng, known, state, actions[0], script=actions)
            for model, known, state in zip(models, self.known[1:], self.perturbed_states, strict=True)
        ]

    def judge(self, replays: Sequence[Candidate]) -> None:
        """Judge the roll-out to choose by its replays."""
        best = self.best()
        assert best is not None
        rollout, _ = self.rollouts[best]
        finished = [replay.finish(self.planner.discount) for replay in replays]
        returns = [rollout.total_return, *(each.total_return for each in finished)]
        robust_return = min(returns) if self.planner.judgement == "worst" else sum(returns) / len(returns)
        num_drops = sum(replay.is_dropped for replay in replays)
        is_bad = num_drops > self.planner.tolerated_drops or any(each.is_diverged for each in finished)
        self.rollouts[best] = (replace(rollout, robust_return=robust_return), is_bad)

    def has_failed(self) -> bool:
        """Count this round: whether even the best roll-out so far is bad."""
        best = self.best()
        failed = best is None or self.rollouts[best][1]
        self.num_failed_rounds = self.num_failed_rounds + 1 if failed else 0
        return failed

    def best(self) -> int | None:
        """Index of the roll-out to choose, the first of the best ones; None if there is none."""
        avoids = self.planner.avoid_visited
        keys = [(avoids and not is_bad, rollout.compared) for rollout, is_bad in self.rollouts]
        return keys.index(max(keys)) if keys else None

    def _best_judged(self) -> int | None:
        """As :meth:`best`; if the deadline passed before it was judged, the best one that was and is not bad."""
        best = self.best()
        if best is None or self.rollouts[best][1] or self.rollouts[best][0].robust_return is not None:
            return best
        judged = [
            (rollout.compared, -number)
            for number, (rollout, is_bad) in enumerate(self.rollouts)
            if rollout.robust_return is not None and not is_bad
        ]
        return -max(judged)[1] if judged else best

    def _is_avoided(self, candidate: Candidate) -> bool:
        """Whether the first action leads to a state of the episode, unless the roll-out reaches the goal."""
        if not self.planner.avoid_visited or not candidate.transitions or candidate.is_goal:
            return False
        return self.memory.has_visited(candidate.transitions[0].next_state)

    def decide(self, timing: Timing) -> Decision:
        """The first action of the best roll-out; the mode of the policy if none has a return."""
        best = self._best_judged()
        rollouts = tuple(rollout for rollout, _ in self.rollouts)
        chosen = None if best is None or rollouts[best].is_diverged else best
        decision = Decision(
            action=self.root.mode()[0] if chosen is None else rollouts[chosen].actions[0],
            rollouts=rollouts,
            num_invalid=sum(rollout.is_diverged for rollout in rollouts),
            timing=timing,
            chosen=chosen,
        )
        self.memory.remember(decision)
        return decision


def choose_next(growing: Sequence[Candidate], guidance: Guidance) -> None:
    """Choose the next action of every candidate."""
    sampled = guidance.sample([candidate.rng for candidate in growing])
    modes = guidance.mode() if any(candidate.follows_mode for candidate in growing) else sampled
    for candidate, sample, mode in zip(growing, sampled, modes, strict=True):
        candidate.choose_next(sample, mode)


def judge(tasks: Sequence[DecisionTask], heuristic: Heuristic, clock: DecisionClock) -> None:
    """Replay the roll-outs to choose in the perturbed models, until every task's has been judged."""
    while waiting := [(task, replays) for task in tasks if (replays := task.replays_of_best())]:
        if not _replay([replay for _, replays in waiting for replay in replays], heuristic, clock):
            return
        for task, replays in waiting:
            task.judge(replays)


def _replay(replays: Sequence[Candidate], heuristic: Heuristic, clock: DecisionClock) -> bool:
    """Simulate the scripts of ``replays``, and value their last states; False if the deadline passed before."""
    growing = list(replays)
    while growing:
        if not clock.simulate(growing):
            return False
        growing = [candidate for candidate in growing if candidate.is_open and not candidate.is_script_done]
        for candidate in growing:
            candidate.next_action = candidate.script[len(candidate.actions)]
    unfinished = [candidate for candidate in replays if candidate.is_open]
    if unfinished:
        if clock.is_too_late_to_guide():
            return False
        scenes = [candidate.model.scene for candidate in unfinished]
        guidance = clock.guide(heuristic, scenes, [candidate.current for candidate in unfinished])
        for candidate, value in zip(unfinished, guidance.values.tolist(), strict=True):
            candidate.value(value)
    return True
