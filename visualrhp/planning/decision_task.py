"""One task within a decision of receding horizon planning: its roll-outs, and the choice among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from visualrhp.heuristics.heuristic import Guidance, Heuristic
from visualrhp.parameters import Count, Discount, Index, NonNegative, Positive, parameters
from visualrhp.planning.candidate import Candidate, KnownTransitions
from visualrhp.planning.deadline import DecisionClock
from visualrhp.planning.episode_memory import EpisodeMemory
from visualrhp.planning.planner import Decision, PlanningModel, Rollout, Timing
from visualrhp.simulation.rules import DISCOUNT
from visualrhp.types import State

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
        max_resamplings: how often n more roll-outs are drawn, from wider distributions, while the best roll-out drops
            an object, diverges, or returns to a state of the episode if these are avoided.
        avoid_visited: whether roll-outs whose first action leads to a state in which the episode has been are chosen
            only if there is no other one.
        num_perturbed_models: k, number of perturbed models in which roll-outs are judged, too; 0 for the nominal alone.
        perturbation: relative standard deviation of the shapes, friction and density of their objects.
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
    num_perturbed_models: Index = 0
    perturbation: NonNegative = 0.05
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
        planner: the parameters.
        known: transitions that were simulated in this decision, in the nominal model and in the perturbed ones.
        growing: the roll-outs of the current round.
        rollouts: those of the closed rounds, and whether each is bad: chosen only if all are.
        num_failed_rounds: number of consecutive rounds after which even the best roll-out was bad.
    """

    model: PlanningModel
    state: State
    rng: np.random.Generator
    memory: EpisodeMemory
    planner: RecedingHorizonParameters
    known: list[KnownTransitions] = field(default_factory=list)
    growing: list[Candidate] = field(default_factory=list)
    finished: list[tuple[Candidate, Rollout]] = field(default_factory=list)
    rollouts: list[tuple[Rollout, bool]] = field(default_factory=list)
    num_failed_rounds: int = 0

    def __post_init__(self) -> None:
        planner, memory = self.planner, self.memory
        memory.enter(self.state)
        while len(memory.perturbed_models) < planner.num_perturbed_models:
            memory.perturbed_models.append(self.model.perturbed(planner.perturbation, self.rng))
        self.known = [{} for _ in range(1 + planner.num_perturbed_models)]

    def first_candidates(self, root: Guidance) -> list[Candidate]:
        """Begin the roll-outs of a round; ``root`` is the guidance of this task's state alone."""
        parts = (self.model, self.rng, self.known[0], self.state)
        count, level = self.planner.num_rollouts, min(self.num_failed_rounds, self.planner.max_resamplings)
        if level >= 2:
            actions = [self.model.action_space.sample(self.rng) for _ in range(count)]
        else:
            policy = root.widened(WIDENING) if level else root
            actions = [policy.sample([self.rng])[0] for _ in range(count)]
        is_first_round = not self.growing
        self.growing = [Candidate(*parts, action, "resampling" if level else "policy") for action in actions]
        if is_first_round and self.planner.follow_mode:
            self.growing.append(Candidate(*parts, root.mode()[0], "mode"))
        if is_first_round and self.planner.warm_start and self.memory.rest:
            self.growing.append(Candidate(*parts, self.memory.rest[0], "warm start", self.memory.rest))
        return self.growing

    def finish_round(self) -> list[Candidate]:
        """Compute the returns of the round's roll-outs; return their replays in the perturbed models, all of each."""
        finished = [candidate for candidate in self.growing if candidate.is_valued]
        self.finished = [(candidate, candidate.finish(self.planner.discount)) for candidate in finished]
        return [
            Candidate(model, self.rng, known, self.state, rollout.actions[0], script=rollout.actions)
            for _, rollout in self.finished
            for model, known in zip(self._perturbed_models, self.known[1:], strict=True)
        ]

    def close_round(self, replays: Sequence[Candidate]) -> None:
        """Judge the round's roll-outs by their ``replays``, and keep them."""
        k = len(self._perturbed_models)
        for number, (candidate, rollout) in enumerate(self.finished):
            own = replays[k * number : k * (number + 1)]
            is_bad = rollout.is_diverged or candidate.is_dropped or self._is_avoided(candidate)
            if own:
                returns = [rollout.total_return, *(replay.finish(self.planner.discount).total_return for replay in own)]
                robust_return = min(returns) if self.planner.judgement == "worst" else sum(returns) / len(returns)
                rollout = replace(rollout, robust_return=robust_return)
                is_bad = is_bad or any(replay.is_dropped or replay.is_diverged for replay in own)
            self.rollouts.append((rollout, is_bad))
        best = self.best()
        failed = best is None or self.rollouts[best][1]
        self.num_failed_rounds = self.num_failed_rounds + 1 if failed else 0

    @property
    def _perturbed_models(self) -> list[PlanningModel]:
        return self.memory.perturbed_models[: self.planner.num_perturbed_models]

    def best(self) -> int | None:
        """Index of the roll-out to choose, the first of the best ones; None if there is none."""
        keys = [(self.planner.avoid_visited and not is_bad, rollout.compared) for rollout, is_bad in self.rollouts]
        return keys.index(max(keys)) if keys else None

    def _is_avoided(self, candidate: Candidate) -> bool:
        """Whether the first action leads to a state of the episode, unless the roll-out reaches the goal."""
        if not self.planner.avoid_visited or not candidate.transitions or candidate.transitions[-1].is_goal:
            return False
        return self.memory.has_visited(candidate.transitions[0].next_state)

    def decide(self, root: Guidance, timing: Timing) -> Decision:
        """The first action of the best roll-out; the mode of the policy if none has a return."""
        best = self.best()
        rollouts = tuple(rollout for rollout, _ in self.rollouts)
        chosen = None if best is None or rollouts[best].is_diverged else best
        decision = Decision(
            action=root.mode()[0] if chosen is None else rollouts[chosen].actions[0],
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


def judge(replays: Sequence[Candidate], heuristic: Heuristic, clock: DecisionClock) -> bool:
    """Simulate the scripts of ``replays``, and value their last states; False if the deadline passed before."""
    growing = list(replays)
    while growing:
        if not clock.simulate(growing):
            return False
        growing = [replay for replay in growing if replay.is_open and len(replay.actions) < len(replay.script)]
        for replay in growing:
            replay.next_action = replay.script[len(replay.actions)]
    unfinished = [replay for replay in replays if replay.is_open]
    if unfinished:
        if clock.is_too_late_to_guide():
            return False
        scenes = [replay.model.scene for replay in unfinished]
        guidance = clock.guide(heuristic, scenes, [replay.current for replay in unfinished])
        for replay, value in zip(unfinished, guidance.values.tolist(), strict=True):
            replay.value(value)
    return True
