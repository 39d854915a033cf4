"""Decisions of VisualRHP against the simulated actions that they contain."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.benchmarks.timing import Effort, compare, numbered, show_title, timed
from tests.benchmarks.walks import random_walks
from visualrhp.environments.task import ObservationFunction
from visualrhp.heuristics.learned import LearnedHeuristic
from visualrhp.heuristics.networks import ActorCritic
from visualrhp.planning import RecedingHorizon
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.types import Action, State, Transition


class _Recorder(TransitionModel):
    """Remembers what it was asked to simulate."""

    calls: list[tuple[State, Action]]

    def simulate(self, state: State, action: Action) -> Transition:
        self.calls.append((state, action))
        return super().simulate(state, action)


def run(effort: Effort) -> None:
    show_title("Decision of VisualRHP, continuous actions, untrained network, one thread")
    heuristic = LearnedHeuristic(ActorCritic(ObservationFunction("image", None)))
    for num_objects in (1, 4, 7):
        walk = random_walks(num_objects, 3)[0]
        state = walk.states[-1]
        for size in (3, 6):
            planner = RecedingHorizon(heuristic, size, size)
            recorder = _Recorder(walk.scene, make_action_space("continuous"))
            recorder.calls = []
            planner.start(recorder, np.random.default_rng(0))(state)
            model = TransitionModel(walk.scene, make_action_space("continuous"))
            compare(
                f"decision {size}x{size}, {numbered(num_objects, 'object')}",
                timed(_decision(planner, model, state)),
                timed(lambda model=model, calls=recorder.calls: [model.simulate(*call) for call in calls]),
                f"its {numbered(len(recorder.calls), 'simulated action')}",
                effort.repetitions,
            )


def _decision(planner: RecedingHorizon, model: TransitionModel, state: State) -> Callable[[], object]:
    """The same decision every time."""
    return lambda: planner.start(model, np.random.default_rng(0))(state)
