"""Steps a Gymnasium environment with random actions, in whichever interpreter the environment is installed.

Run as a file by :mod:`tests.benchmarks.peers`, with what to make as JSON in its argument. It says on standard output
what a step simulates, then for every line of standard input (seconds) how many steps it took in that time. It needs
nothing but Gymnasium and NumPy and is the same for our environment and the peers'.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import resource
import sys
import time
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np


@contextlib.contextmanager
def _watched_spaces(substeps: list[float], spaces: list) -> Iterator[None]:
    """Notes the duration of every step of a pymunk space, and the space."""
    import pymunk

    original = pymunk.Space.step

    def step(space: pymunk.Space, duration: float) -> None:
        substeps.append(duration)
        spaces[:] = [space]
        original(space, duration)

    pymunk.Space.step = step
    try:
        yield
    finally:
        pymunk.Space.step = original


def _describe(environment: gymnasium.Env, draws: bool) -> dict[str, Any]:
    """What a step simulates and shows, as counted while it does."""
    observation: Any = environment.reset(seed=0)[0]
    substeps: list[float] = []
    spaces: list = []
    count = 4
    with _watched_spaces(substeps, spaces):
        for _ in range(count):
            observation = environment.step(environment.action_space.sample())[0]
    if draws:
        observation = environment.render()
    if isinstance(observation, dict):
        observation = observation["observation"]
    facts: dict[str, Any] = {"observation": [*np.shape(observation)], "dtype": str(np.asarray(observation).dtype)}
    if spaces:  # ours does not use pymunk's spaces, so the caller passes these
        facts["substeps"] = len(substeps) / count
        facts["time_step"] = substeps[0]
        facts["iterations"] = spaces[0].iterations
        facts["bodies"] = sum(body.body_type == body.DYNAMIC for body in spaces[0].bodies)
        facts["shapes"] = len(spaces[0].shapes)
        facts["joints"] = len(spaces[0].constraints)
    return facts


def _step_for(environment: gymnasium.Env, seconds: float, draws: bool) -> dict[str, float]:
    """Random actions until ``seconds`` of steps are over; resets are counted apart.

    Processor time: it leaves out what other processes take, and counts every thread, as a figure a core should.
    """
    steps, episodes, step_time, reset_time = 0, 0, 0.0, 0.0
    ended = True
    while step_time < seconds:
        if ended:
            start = time.process_time()
            environment.reset()
            reset_time += time.process_time() - start
            episodes += 1
        action = environment.action_space.sample()
        start = time.process_time()
        _, _, terminated, truncated, _ = environment.step(action)
        if draws:
            environment.render()
        step_time += time.process_time() - start
        ended = terminated or truncated
        steps += 1
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return {"steps": steps, "episodes": episodes, "step_time": step_time, "reset_time": reset_time, "memory": memory}


def main() -> None:
    wanted = json.loads(sys.argv[1])
    module = importlib.import_module(wanted["module"])
    if "register" in wanted:
        getattr(module, wanted["register"])()
    environment = gymnasium.make(wanted["id"], disable_env_checker=True, **wanted["arguments"])
    environment.action_space.seed(0)
    print(json.dumps(_describe(environment, wanted["draws"])), flush=True)
    for line in sys.stdin:
        print(json.dumps(_step_for(environment, float(line), wanted["draws"])), flush=True)


if __name__ == "__main__":
    main()
