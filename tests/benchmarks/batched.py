"""The batched torchrl environment: what it adds to physics and drawing, and what more processes bring.

Its workers are compared with the vectorised environments that torchrl and Gymnasium come with, on the same tasks.
"""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import psutil
import torch
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from torchrl.envs import EnvBase, ParallelEnv
from torchrl.envs.utils import step_mdp

import visualrhp  # noqa: F401  (registers the environment)
from tests.benchmarks.timing import Effort, numbered, readable, show, show_time, show_title
from tests.benchmarks.walks import SEED, SPLIT, distribution
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.observation.label_image import label_image
from visualrhp.scene import SceneDistribution

_BATCH = 64
_MIXED = SceneDistribution(num_objects=(1, 7))
_SHARES = ((4, 2), (10, 2), (32, 2))
"""(slots, processes) that the vectorised environments are compared at."""


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
            model.simulator.advance(state, motion) for model, state, motion in zip(models, before, motions, strict=True)
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
    """Steps with and without workers, interleaved; wall clock."""
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


class _Contestant(NamedTuple):
    """One way to step many tasks side by side.

    Attributes:
        name: in the table.
        num_slots: tasks.
        num_processes: that simulate.
        make: starts it, up to the first observations; returns ``step(actions [slots, 4])``, which includes the reset
            of the episodes that are over, and ``close()``.
    """

    name: str
    num_slots: int
    num_processes: int
    make: Callable[[], tuple[Callable[[np.ndarray], Any], Callable[[], Any]]]


def _torchrl(make: Callable[[], EnvBase]) -> tuple[Callable[[np.ndarray], Any], Callable[[], Any]]:
    """The loop of a torchrl collector."""
    environment = make()
    current = environment.reset()
    shape = (*environment.batch_size, 4)

    def step(actions: np.ndarray) -> None:
        nonlocal current
        _, current = environment.step_and_maybe_reset(current.set("action", torch.from_numpy(actions).view(shape)))

    return step, environment.close


def _share(num_slots: int, seed: int, num_workers: int = 0) -> BatchedClutterEnv:
    return BatchedClutterEnv(_MIXED, "continuous", "image", num_slots, seed, SPLIT, num_workers=num_workers)


def _parallel(num_slots: int, num_processes: int) -> ParallelEnv:
    """Shares of equal size, forked (spawned processes would each import torchrl, which takes seconds)."""
    size = num_slots // num_processes
    makers = [functools.partial(_share, size, SEED + process) for process in range(num_processes)]
    return ParallelEnv(num_processes, makers, mp_start_method="fork")


def _async(num_slots: int) -> tuple[Callable[[np.ndarray], Any], Callable[[], Any]]:
    """Forked, with shared memory, as by default (torchrl changes that). Resets in the step, as torchrl does."""
    make = functools.partial(
        gymnasium.make, "visualrhp/ClutterManipulation-v0", disable_env_checker=True, num_objects=(1, 7), split=SPLIT
    )
    environments = AsyncVectorEnv([make] * num_slots, context="fork", autoreset_mode=AutoresetMode.SAME_STEP)
    environments.reset(seed=SEED)
    return environments.step, environments.close


def _contestants(slots: int, processes: int) -> list[_Contestant]:
    """Ours with workers is the first."""
    return [
        _Contestant(
            "BatchedClutterEnv, with workers",
            slots,
            processes,
            lambda: _torchrl(lambda: _share(slots, SEED, processes - 1)),
        ),
        _Contestant("BatchedClutterEnv, this process", slots, 1, lambda: _torchrl(lambda: _share(slots, SEED))),
        _Contestant(
            "ParallelEnv, a batch per process", slots, processes, lambda: _torchrl(lambda: _parallel(slots, processes))
        ),
        _Contestant("ParallelEnv, a task per process", slots, slots, lambda: _torchrl(lambda: _parallel(slots, slots))),
        _Contestant("AsyncVectorEnv, a task per process", slots, slots, lambda: _async(slots)),
        _Contestant("AsyncVectorEnv, a task per process", processes, processes, lambda: _async(processes)),
    ]


def _vectorised(num_slots: int, num_processes: int, effort: Effort) -> None:
    """Steps per second of all contestants, taken in turn, by the clock on the wall."""
    contestants = _contestants(num_slots, num_processes)
    rng = np.random.default_rng(SEED)
    running, starts = [], []
    try:
        for contestant in contestants:
            start = time.perf_counter()
            running.append(contestant.make())
            starts.append(time.perf_counter() - start)
        rates = np.empty((effort.repetitions + 1, len(contestants)))
        for repetition in range(effort.repetitions + 1):
            for number, (contestant, (step, _)) in enumerate(zip(contestants, running, strict=True)):
                # Few tasks take more steps: a round of each sees about as many tasks.
                length = max(1, 10 * effort.motions // contestant.num_slots)
                actions = rng.uniform(-1.0, 1.0, (length, contestant.num_slots, 4)).astype(np.float32)
                start = time.perf_counter()
                for action in actions:
                    step(action)
                rates[repetition, number] = length * contestant.num_slots / (time.perf_counter() - start)
    finally:
        for _, close in running:
            close()
    rates = rates[1:]  # the first round fills the caches
    print(f"\n{f'{num_slots} tasks side by side':<40} {'tasks':>6} {'processes':>10} {'start':>10}", end="")
    print(f" {'steps/s':>9} {'ours over it':>13} {'best':>6}")
    for number, contestant in enumerate(contestants):
        ratio = float(np.median(rates[:, 0] / rates[:, number]))
        best = rates[:, 0].max() / rates[:, number].max()
        print(
            f"{contestant.name:<40} {contestant.num_slots:6} {contestant.num_processes:10} "
            f"{readable(starts[number]):>10} {np.median(rates[:, number]):9.0f} {ratio:13.2f} {best:6.2f}",
            flush=True,
        )


def run(effort: Effort) -> None:
    show_title("Batched torchrl environment, 7 objects, image, random actions (times of one of its N environments)")
    for num_envs in (1, _BATCH):
        _overhead(num_envs, 2 * effort.repetitions)
    for num_workers in sorted({1, max(1, len(os.sched_getaffinity(0)) - 1)}):
        _workers(num_workers, effort.repetitions)
    print("\nVectorised environments, 1 to 7 objects, image, random actions, resets included (load average ", end="")
    print(f"{os.getloadavg()[0]:.1f}): steps of one task per second, and those of our workers over them")
    for num_slots, num_processes in _SHARES:
        _vectorised(num_slots, num_processes, effort)
