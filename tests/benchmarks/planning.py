"""Decisions of VisualRHP against the sum of the parts that cannot be left out."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from tests.benchmarks.timing import Effort, Stopwatch, compare, numbered, readable, show_title, timed
from tests.benchmarks.walks import Walk, random_walks
from visualrhp.heuristics.checkpoint import load_heuristic
from visualrhp.heuristics.conversion import heuristic_of
from visualrhp.heuristics.heuristic import Guidance, Heuristic
from visualrhp.heuristics.learned import LearnedHeuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.observation import make_observation
from visualrhp.planning import RecedingHorizon
from visualrhp.scene import Scene
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.types import Action, ActionSpaceName, State, Transition

_TRAINED = Path(__file__).resolve().parents[2] / "outputs" / "train_rl"
_DECISIONS = 6
"""Number of different states, so that the parts do not profit from a warm processor cache."""

_DEADLINES = (0.005, 0.02, 0.1)
"""[s]"""


class _RecordingModel(TransitionModel):
    """Records the simulated actions."""

    calls: list[tuple[State, Action]]

    def simulate(self, state: State, action: Action) -> Transition:
        self.calls.append((state, action))
        return super().simulate(state, action)


class _TimedModel(TransitionModel):
    """Records the duration of the longest action [s]."""

    longest_s: float = 0.0

    def simulate(self, state: State, action: Action) -> Transition:
        start = time.perf_counter()
        transition = super().simulate(state, action)
        self.longest_s = max(self.longest_s, time.perf_counter() - start)
        return transition


class _RecordingHeuristic(Heuristic):
    """Records the evaluated states."""

    def __init__(self, heuristic: LearnedHeuristic) -> None:
        self.heuristic = heuristic
        self.action_space = heuristic.action_space
        self.calls: list[list[State]] = []

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        self.calls.append(list(states))
        return self.heuristic.guide(scenes, states)


class _Decision:
    """A decision, the same every time, and its parts: each a list of calls that a planner cannot do without.

    Args:
        heuristic: of the planner.
        walk: whose scene it is.
        state: to decide in.
        space: of the actions.
        size: n and h.
        shared: whether what discrete roll-outs have in common is simulated, drawn and asked once, as the planner does;
            otherwise once for every roll-out, as Algorithm 1 is written. Continuous roll-outs have nothing in common.
    """

    def __init__(
        self, heuristic: LearnedHeuristic, walk: Walk, state: State, space: ActionSpaceName, size: int, shared: bool
    ) -> None:
        self.model = TransitionModel(walk.scene, make_action_space(space))
        self.planner = RecedingHorizon(heuristic, num_rollouts=size, horizon=size)
        self.state = state
        self.rng = np.random.default_rng(0)
        self.start = self.rng.bit_generator.state
        self.network = heuristic.network
        self.observe = heuristic.observation
        model = _RecordingModel(walk.scene, make_action_space(space))
        recorder = _RecordingHeuristic(heuristic)
        model.calls = []
        rollouts = (
            RecedingHorizon(recorder, num_rollouts=size, horizon=size)
            .plan(model, state, np.random.default_rng(0))
            .rollouts
        )
        if shared:
            self.actions = model.calls
            self.batches = [list(dict.fromkeys(states)) for states in recorder.calls]
        else:
            steps = itertools.zip_longest(*[zip(rollout.states, rollout.actions, strict=False) for rollout in rollouts])
            self.actions = [call for step in steps for call in step if call is not None]
            self.batches = recorder.calls
        self.seen = [np.stack([self.observe(walk.scene, s) for s in states]) for states in self.batches]
        self.closed = [np.array([s.gripper_closed for s in states]) for states in self.batches]

    def decide(self) -> None:
        self.rng.bit_generator.state = self.start
        self.planner.plan(self.model, self.state, self.rng)

    def simulate(self) -> None:
        for action in self.actions:
            self.model.simulate(*action)

    def draw(self) -> None:
        for states in self.batches:
            for state in states:
                self.observe(self.model.scene, state)

    def ask(self) -> None:
        for observations, closed in zip(self.seen, self.closed, strict=True):
            self.network(observations, closed)

    def parts(self) -> None:
        """All parts, in the order in which the decision has need of them: simulate, draw, ask."""
        actions = iter(self.actions)
        for states, observations, closed in zip(self.batches, self.seen, self.closed, strict=True):
            for state in states:
                self.observe(self.model.scene, state)
            self.network(observations, closed)
            for action in itertools.islice(actions, len(self.actions) // max(1, len(self.batches) - 1)):
                self.model.simulate(*action)
        for action in actions:
            self.model.simulate(*action)


def run(effort: Effort) -> None:
    for space in ("continuous", "discrete"):
        for observation in ("image", "cartesian"):
            show_title(f"Decision, {space}, {observation}, {_origin(space, observation)}, one thread, against")
            for num_objects in (1, 4, 7):
                heuristic = _heuristic(space, observation, num_objects)
                for size in (3, 6):
                    _show_decision(effort, heuristic, num_objects, size)
    _show_deadlines(effort)


def _show_decision(effort: Effort, heuristic: LearnedHeuristic, num_objects: int, size: int) -> None:
    walks = random_walks(num_objects, 2 * _DECISIONS, heuristic.action_space)
    pairs = [(walk, state) for walk in walks for state in walk.states[:-1]][::2][:_DECISIONS]
    space = heuristic.action_space
    for shared in (True, False) if space == "discrete" else (True,):
        decisions = [_Decision(heuristic, walk, state, space, size, shared) for walk, state in pairs]

        def each(part: Callable[[_Decision], None], decisions: list[_Decision] = decisions) -> Stopwatch:
            def run_all() -> None:
                for decision in decisions:
                    part(decision)

            stopwatch = timed(run_all)
            return lambda: stopwatch() / len(decisions)

        def least(part: Stopwatch) -> str:
            return readable(min(part() for _ in range(effort.repetitions)))

        simulated = sum(len(decision.actions) for decision in decisions) / len(decisions)
        looked_at = sum(len(states) for decision in decisions for states in decision.batches) / len(decisions)
        compare(
            f"decision {size}x{size}, {numbered(num_objects, 'object')}",
            each(_Decision.decide),
            each(_Decision.parts),
            f"{'its parts' if shared else 'Algorithm 1 as written'}: "
            f"{simulated:.1f} actions {least(each(_Decision.simulate))}, "
            f"{looked_at:.1f} observations {least(each(_Decision.draw))}, network {least(each(_Decision.ask))}",
            effort.repetitions,
        )


def _show_deadlines(effort: Effort) -> None:
    """Lateness (wall clock) of decisions with a deadline, and the number of roll-outs that fit."""
    heuristic = _heuristic("continuous", "image", 7)
    walk = random_walks(7, 3)[0]
    print(f"\nDecisions with a deadline, {numbered(7, 'object')}, continuous, image, wall clock")
    for deadline_s in _DEADLINES:
        planner = RecedingHorizon(heuristic, deadline_s=deadline_s)
        model = _TimedModel(walk.scene, make_action_space("continuous"))
        late, counts = [], []
        for seed in range(4 * effort.repetitions):
            start = time.perf_counter()
            decision = planner.plan(model, walk.states[-1], np.random.default_rng(seed))
            late.append(time.perf_counter() - start - deadline_s)
            counts.append(len(decision.rollouts))
        print(
            f"deadline {readable(deadline_s)}: {np.median(counts):.0f} roll-outs; late by {readable(np.median(late))}, "
            f"at most {readable(max(late))} in {len(late)}; the longest action simulated took "
            f"{readable(model.longest_s)}",
            flush=True,
        )


def _file(space: ActionSpaceName, observation: str, num_objects: int) -> Path:
    stem = "heuristic" if observation == "image" else f"heuristic_m{num_objects}"
    return _TRAINED / space / observation / f"{stem}.safetensors"


def _origin(space: ActionSpaceName, observation: str) -> str:
    return "trained network" if _file(space, observation, 7).is_file() else "untrained network"


def _heuristic(space: ActionSpaceName, observation: str, num_objects: int) -> LearnedHeuristic:
    """The trained one if there is one; the time of a decision depends on it only in how long roll-outs live."""
    path = _file(space, observation, num_objects)
    if path.is_file():
        return load_heuristic(path)
    torch.manual_seed(0)
    reads = make_observation("image") if observation == "image" else make_observation("cartesian", num_objects)
    return heuristic_of(make_network(space, reads))
