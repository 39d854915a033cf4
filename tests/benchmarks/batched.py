"""The batched torchrl environment: what it adds to physics and drawing, and what more processes bring."""

from __future__ import annotations

import os
import time

import numpy as np
import psutil
from torchrl.envs.utils import step_mdp

from tests.benchmarks.timing import Effort, numbered, show, show_time, show_title
from tests.benchmarks.walks import SEED, SPLIT, distribution
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.rendering import label_image

_BATCH = 64


def _make(num_envs: int, num_workers: int) -> BatchedClutterEnv:
    return BatchedClutterEnv(distribution(7), "continuous", "image", num_envs, SEED, SPLIT, num_workers=num_workers)


def _overhead(num_envs: int, repetitions: int) -> None:
    """Every step of a roll-out of random actions, and its parts done again by hand straight after."""
    environment = _make(num_envs, 0)
    data = environment.reset()
    steps, physics, decisions, drawings = [], [], [], []
    for _ in range(repetitions + 1):
        models, before = environment.models, environment.states
        data = environment.rand_action(data)
        actions = list(data["action"].numpy().astype(np.float64))
        motions = [model.action_space.motion(action) for model, action in zip(models, actions, strict=True)]
        marks = [time.process_time()]
        data = environment.step(data)
        marks.append(time.process_time())
        after = [
            model._simulator.advance(state, motion)
            for model, state, motion in zip(models, before, motions, strict=True)
        ]
        marks.append(time.process_time())
        for model, state, action in zip(models, before, actions, strict=True):
            model.simulate(state, action)
        marks.append(time.process_time())
        for model, state in zip(models, after, strict=True):
            label_image(model.scene, state)
        marks.append(time.process_time())
        for times, seconds in zip((steps, physics, decisions, drawings), np.diff(marks), strict=True):
            times.append(seconds / num_envs)
        data = environment.maybe_reset(step_mdp(data))
    # The first step fills the caches.
    steps, physics, decisions, drawings = (np.array(times[1:]) for times in (steps, physics, decisions, drawings))
    show(f"an environment's step in a batch of {num_envs}", steps, physics + drawings, "physics + drawing")
    show_time("  physics (Simulator.advance)", physics)
    show_time("  drawing (label_image)", drawings)
    show_time("  action, goal, drop and reward (rest of simulate)", decisions - physics)
    show_time("  added over physics and drawing", steps - physics - drawings)
    show_time("  added over simulate and drawing", steps - decisions - drawings)
    environment.close()


def _workers(num_workers: int, repetitions: int) -> None:
    """Steps without workers and with, taken in turn, by the clock on the wall."""
    environments = [_make(_BATCH, workers) for workers in (num_workers, 0)]
    data = [environment.reset() for environment in environments]
    times = np.empty((repetitions + 1, 2))
    for repetition in range(repetitions + 1):
        for number, environment in enumerate(environments):
            chosen = environment.rand_action(data[number])
            start = time.perf_counter()
            stepped = environment.step(chosen)
            times[repetition, number] = (time.perf_counter() - start) / _BATCH
            data[number] = environment.maybe_reset(step_mdp(stepped))
    words = numbered(num_workers, "worker")
    show(f"a batch of {_BATCH} with {words}", times[1:, 0], times[1:, 1], "that in this process")
    memory = max(process.memory_info().rss for process in psutil.Process().children(recursive=True))
    print(f"  memory of a worker: {memory / 2**20:.0f} MiB", flush=True)
    for environment in environments:
        environment.close()


def run(effort: Effort) -> None:
    show_title("Batched torchrl environment, 7 objects, image, random actions (times of one of its N environments)")
    for num_envs in (1, _BATCH):
        _overhead(num_envs, 2 * effort.repetitions)
    for num_workers in (1, len(os.sched_getaffinity(0))):
        _workers(num_workers, effort.repetitions)
