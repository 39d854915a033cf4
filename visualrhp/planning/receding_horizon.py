"""Receding horizon planning guided by a heuristic (Sec. 5.2, Algorithm 1), and options beyond the paper."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.parameters import SkipValidation, parameters
from visualrhp.planning.deadline import DecisionClock
from visualrhp.planning.decision_task import DecisionTask, RecedingHorizonParameters, choose_next, judge
from visualrhp.planning.episode_memory import EpisodeMemory
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.types import State

PLUS_OPTIONS: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "warm_start": True,
        "follow_mode": True,
        "max_resamplings": 4,
        "avoid_visited": True,
        "distinct_actions": True,
        "prior_weight": 0.3,
        "stop_at_goal": True,
        "num_perturbed_models": 2,
        "perturbation": 0.15,
    }
)
"""The best setting of the options beyond the paper (docs/planning.md), as in ``conf/planner/visual_rhp_plus.yaml``."""


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

    **Options**, which are not in the paper and off by default (docs/planning.md has the reasons and measurements):

    - *warm start*: the rest of the last decision's chosen roll-out, continued by the mode of the policy, competes
      again, so that a good plan is not lost;
    - *mode*: one more roll-out follows the mode of the policy, which is better than its samples in easy states;
    - *resampling*: if even the best roll-out drops an object, n more are drawn, up to ``max_resamplings`` times: first
      actions from a policy with twice the standard deviation or temperature, then uniformly;
    - *visited states*: in the discrete action space, episodes run out of actions going round in circles; first actions
      that lead to a state of the episode are avoided;
    - *distinct actions*: in the discrete action space most samples of a peaked policy are the same roll-out; the n
      samples begin with different actions instead;
    - *prior*: with more different actions, the highest return is more often that of an overrated state; in the
      discrete action space, a multiple of the log-probability of the first action is added to the return;
    - *stop at the goal*: roll-outs end when another one has reached the goal, since longer ones have a lower return;
    - *robust look-ahead*: the world differs from the model, so roll-outs are judged by their mean or worst return over
      the nominal model and k perturbed ones. They are drawn once per episode: roll-outs and decisions are compared in
      the same ones. The best roll-out is judged first, and others only as long as they compare better, so that most
      are simulated in the nominal model alone.

    The sampled roll-outs come first in a decision, then that of the mode, the warm start, and those of resampling.

    **With a deadline**, a decision chooses the best of as many roll-outs as fit, in rounds of n; it holds all of them.
    The heuristic evaluates all roll-outs at every depth, so a roll-out that the deadline stops is equivalent to one
    with a shorter horizon: it ends in the last state with a value, or in its terminal state. A decision is late by at
    most one simulated action (:class:`~visualrhp.planning.deadline.DecisionClock`). If there is no time for a roll-out,
    the action is the mode of the heuristic's policy, as of Greedy. The number of roll-outs depends on the machine and
    its load, so **decisions with a deadline are not reproducible**; those without one are.

    Attributes:
        heuristic: the stochastic policy and the value estimate.
        clock: returns the time [s].
        others: see :class:`RecedingHorizonParameters`.
    """

    heuristic: SkipValidation[Heuristic]
    clock: SkipValidation[Callable[[], float]] = field(default=time.perf_counter, kw_only=True, repr=False)

    @classmethod
    def plus(cls, heuristic: Heuristic, **options: Any) -> RecedingHorizon:
        """VisualRHP+: with :data:`PLUS_OPTIONS`, and other parameters as given."""
        return cls(heuristic, **{"name": "VisualRHP+", **PLUS_OPTIONS, **options})

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        memory = EpisodeMemory()

        def policy(state: State) -> Decision:
            return self.plan(model, state, rng, memory)

        return policy

    def plan(
        self, model: PlanningModel, state: State, rng: np.random.Generator, memory: EpisodeMemory | None = None
    ) -> Decision:
        """Choose an action in ``state`` (Algorithm 1), the first one of an episode without a ``memory``."""
        return self.plan_batch([model], [state], [rng], [EpisodeMemory() if memory is None else memory])[0]

    def plan_batch(
        self,
        models: Sequence[PlanningModel],
        states: Sequence[State],
        rngs: Sequence[np.random.Generator],
        memories: Sequence[EpisodeMemory] | None = None,
    ) -> list[Decision]:
        """Choose an action in each of B independent tasks; their roll-outs share the calls of the heuristic.

        Args:
            models: B models, one per task.
            states: B current states s_cur, none terminal.
            rngs: B generators, one per task, so that a decision does not depend on the other tasks.
            memories: B memories of the episodes, which are updated; None for first decisions.

        Returns:
            B decisions.
        """
        clock = DecisionClock(self.clock, self.deadline_s)
        memories = [EpisodeMemory() for _ in models] if memories is None else memories
        guidance = clock.guide(self.heuristic, [model.scene for model in models], states)
        roots = [guidance.take([b]) for b in range(len(models))]
        tasks = [DecisionTask(*task, self) for task in zip(models, states, rngs, memories, roots, strict=True)]
        pending = tasks
        while pending and not clock.is_too_late_to_guide():  # one round, without a deadline and resampling
            # FirstAction: a ~ pi(.|s_cur), n samples in every task
            growing = [candidate for task in pending for candidate in task.first_candidates()]
            for depth in range(1, self.horizon + 1):
                # s <- simulatePhysics(s, a), r <- receiveRewards
                if not clock.simulate(growing):
                    break
                # if isTerminal(s): break
                growing = [candidate for task in pending for candidate in task.open_candidates]
                if not growing or clock.is_too_late_to_guide():
                    break
                # v(s), and a ~ pi(.|s) for the next action
                scenes = [candidate.model.scene for candidate in growing]
                guidance = clock.guide(self.heuristic, scenes, [candidate.current for candidate in growing])
                for candidate, value in zip(growing, guidance.values.tolist(), strict=True):
                    candidate.value(value)
                if depth < self.horizon:
                    choose_next(growing, guidance)
            # R <- R + gamma^h v(s), unless isTerminal(s) (Eq. 3)
            for task in pending:
                task.close_round()
            if self.num_perturbed_models:
                judge(pending, self.heuristic, clock)
            failed = [task for task in pending if task.has_failed()]
            if self.deadline_s is None:
                pending = [task for task in failed if task.num_failed_rounds <= self.max_resamplings]
        # FirstAction[argmax(RolloutsReturn)]
        timing = clock.timing()
        return [task.decide(timing) for task in tasks]
