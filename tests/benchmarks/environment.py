"""A step of the Gymnasium environment against the bare Chipmunk loop that it contains."""

from __future__ import annotations

import time

import gymnasium

import visualrhp  # noqa: F401  (registers the environment)
from tests.benchmarks import walks as w
from tests.benchmarks.timing import Effort, compare, numbered, show_title
from visualrhp.types import ActionSpaceName


def _step_seconds(environment: gymnasium.Env, walks: list[w.Walk]) -> float:
    """Time of a step [s], the mean over ``walks``; resets are not counted."""
    total = 0.0
    for walk in walks:
        environment.reset(seed=w.SEED, options={"instance": walk.index})
        start = time.process_time()
        for action in walk.actions:
            environment.step(action)
        total += time.process_time() - start
    return total / w.count(walks)


def run(effort: Effort) -> None:
    show_title("Gymnasium environment (noisy walks towards the objects; without Gymnasium's environment checker)")
    spaces: tuple[ActionSpaceName, ...] = ("continuous", "discrete")
    for num_objects in (1, 4, 7):
        for space in spaces:
            walks = w.random_walks(num_objects, effort.motions, space)
            simulators = w.simulators(walks)
            for observation in ("image", "cartesian"):
                environment = gymnasium.make(
                    "visualrhp/ClutterManipulation-v0",
                    disable_env_checker=True,
                    action_space=space,
                    observation=observation,
                    num_objects=(num_objects, num_objects),
                    split=w.SPLIT,
                )
                compare(
                    f"step, {numbered(num_objects, 'object')}, {space}, {observation}",
                    lambda e=environment, walks=walks: _step_seconds(e, walks),
                    lambda walks=walks, of=simulators: w.bare_seconds(walks, of),
                    "the bare Chipmunk loop",
                    effort.repetitions,
                )
                environment.close()
