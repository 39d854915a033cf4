"""How fast the parts are on this machine, one thread. ``python -m tests.benchmarks``, or ``make bench``.

Every figure is the best of several repetitions, which other work on the machine disturbs least.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from visualrhp.environments.task import ObservationFunction
from visualrhp.heuristics.learned import LearnedHeuristic
from visualrhp.heuristics.networks import ActorCritic
from visualrhp.planning import RecedingHorizon
from visualrhp.rendering import label_image
from visualrhp.scene import SceneDistribution, Split, sample_task_instance
from visualrhp.simulation import TransitionModel, make_action_space

REPOSITORY = Path(__file__).resolve().parents[2]
PIPELINES = ("generate_demos", "train_il", "train_rl", "evaluate", "report")


def best(function: Callable[[], object], calls: int = 1, repetitions: int = 5) -> float:
    """Least time of a call [s]."""
    function()
    times = []
    for _ in range(repetitions):
        start = time.perf_counter()
        for _ in range(calls):
            function()
        times.append((time.perf_counter() - start) / calls)
    return min(times)


def show(what: str, seconds: float) -> None:
    number, unit = (seconds * 1e3, "ms") if seconds < 1.0 else (seconds, "s")
    print(f"{what:<64} {number:9.3f} {unit}", flush=True)


def measure_simulation_and_planning() -> None:
    space = make_action_space("continuous")
    observation = ObservationFunction("image", None)
    heuristic = LearnedHeuristic(ActorCritic(observation))
    for num_objects in (1, 4, 7):
        task = sample_task_instance(SceneDistribution((num_objects, num_objects)), 0, Split.TUNING, 0)
        model = TransitionModel(task.scene, space)
        action = np.array([0.3, 0.0, 0.1, -1.0])
        words = f"{num_objects} object{'s' if num_objects > 1 else ''}"
        show(f"simulate an action, {words}", best(lambda m=model, s=task.state, a=action: m.simulate(s, a), 50))
        show(f"label image, {words}", best(lambda s=task.state, scene=task.scene: label_image(scene, s), 50))
        for size in (3, 6):
            policy = RecedingHorizon(heuristic, size, size).start(model, np.random.default_rng(0))
            show(f"decision of VisualRHP {size}x{size}, {words}", best(lambda p=policy, s=task.state: p(s), 5))


def measure_training() -> None:
    network = ActorCritic(ObservationFunction("image", None))
    size = 500
    images = torch.randint(0, 6, (size, 64, 64), dtype=torch.uint8)
    closed = torch.zeros(size)

    def step() -> None:
        mean, std, value = network(images, closed)
        (mean.sum() + std.sum() + value.sum()).backward()

    show(f"forward and backward pass of the image network, a sample of {size}", best(step, repetitions=3) / size)


def measure_command_line() -> None:
    for pipeline in PIPELINES:
        for question in (["--help"], ["--cfg", "job"]):
            command = [sys.executable, "-m", f"pipelines.{pipeline}", *question]
            answer = best(lambda c=command: subprocess.run(c, cwd=REPOSITORY, check=True, capture_output=True))
            show(f"python {' '.join(command[1:])}", answer)


if __name__ == "__main__":
    torch.set_num_threads(1)
    measure_command_line()
    measure_simulation_and_planning()
    measure_training()
