"""Steps per second on one core, compared with gym-pusht and a Dynamic2D environment of KinDER. ``make bench-peers``

The peers pin other versions of pymunk than ours, and than each other, so each has a virtual environment of its own,
made by the make target from ``peers/*.txt``. All environments take random actions, without Gymnasium's environment
checker, in processes that run in turn on the same core.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import gymnasium
import numpy as np

from tests.benchmarks.timing import Effort, Ratio, readable
from visualrhp.simulation.simulator import Simulator

REPOSITORY = Path(__file__).resolve().parents[2]
ENVIRONMENTS = Path(sys.prefix) / "peers"
_STEPS = """\
A step of ours is one action of the paper, from a state that is restored exactly: 0.5 s of motion at constant velocity,
then settling until the world is at rest. One of gym-pusht is a tenth of a second of a PD controller, ten substeps. One
of KinDER's Dynamic2D is a controller's target, pursued ten times for ten substeps. Images: ours is drawn at 64 x 64,
gym-pusht draws at 512 x 512 and shrinks, KinDER's environments observe a state and draw with Matplotlib on request."""
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "SDL_VIDEODRIVER": "dummy", "MPLBACKEND": "agg"}


@dataclass(frozen=True)
class Contestant:
    """An environment to be stepped.

    Attributes:
        name: in the tables.
        python: the interpreter that has it.
        module: to be imported.
        id: of the Gymnasium environment.
        arguments: for making it.
        register: function of the module that registers its environments, if importing it does not.
        draws: the image is not in the observation: ``render`` is called after each step.
    """

    name: str
    python: Path
    module: str
    id: str
    arguments: dict[str, Any] = field(default_factory=dict)
    register: str | None = None
    draws: bool = False


def _ours(observation: str, space: str, num_objects: int) -> Contestant:
    arguments = {"observation": observation, "action_space": space, "num_objects": (num_objects, num_objects)}
    name = f"ours, {observation}, {space}, m = {num_objects}"
    return Contestant(name, Path(sys.executable), "visualrhp", "visualrhp/ClutterManipulation-v0", arguments)


def _our_facts(contestant: Contestant, count: int = 100) -> dict[str, Any]:
    """Time steps that one of our steps simulates, without pymunk's objects: the mean over random actions."""
    environment = gymnasium.make(contestant.id, disable_env_checker=True, **contestant.arguments)
    environment.action_space.seed(0)
    environment.reset(seed=0)
    with mock.patch.object(Simulator, "step", autospec=True, side_effect=Simulator.step) as step:
        for _ in range(count):
            if any(environment.step(environment.action_space.sample())[2:4]):
                environment.reset()
    simulator: Simulator = environment.get_wrapper_attr("model").simulator
    world = simulator.world
    return {
        "substeps": sum(call.args[2] for call in step.call_args_list) / count,
        "time_step": simulator.physics.time_step,
        "iterations": simulator.physics.iterations,
        "bodies": len(world.bodies) - 1,  # all but the guide are dynamic
        "shapes": len(world.shapes),
        "joints": len(world.joints),
    }


def _push_t(observation: str) -> Contestant:
    python = ENVIRONMENTS / "gym-pusht" / "bin" / "python"
    arguments = {"obs_type": observation}
    return Contestant(f"gym-pusht, {observation}", python, "gym_pusht", "gym_pusht/PushT-v0", arguments)


def _kinder(task: str, draws: bool) -> Contestant:
    return Contestant(
        f"KinDER {task}, {'render' if draws else 'state'}",
        ENVIRONMENTS / "kinder" / "bin" / "python",
        "kinder",
        f"kinder/{task}-v0",
        {"render_mode": "rgb_array"},
        register="register_all_environments",
        draws=draws,
    )


IMAGE, PIXELS, RENDERED = _ours("image", "continuous", 7), _push_t("pixels"), _kinder("DynPushPullHook2D-o5", True)
CARTESIAN, STATE, HOOK = _ours("cartesian", "continuous", 7), _push_t("state"), _kinder("DynPushPullHook2D-o5", False)
ONE_OBJECT, PUSH_T = _ours("image", "continuous", 1), _kinder("DynPushT2D-t1", False)
CONTESTANTS = (
    IMAGE,
    PIXELS,
    _ours("image", "discrete", 7),
    RENDERED,
    ONE_OBJECT,
    CARTESIAN,
    STATE,
    HOOK,
    PUSH_T,
)
PAIRS = (
    (IMAGE, PIXELS),
    (ONE_OBJECT, PIXELS),
    (CARTESIAN, STATE),
    (IMAGE, RENDERED),
    (CARTESIAN, HOOK),
    (ONE_OBJECT, PUSH_T),
)


class _Worker:
    """A process that steps one environment when it is told to."""

    def __init__(self, contestant: Contestant, core: int) -> None:
        wanted = {key: value for key, value in asdict(contestant).items() if value is not None}
        wanted = {key: wanted[key] for key in ("module", "id", "arguments", "register", "draws") if key in wanted}
        self.process = subprocess.Popen(
            [
                str(contestant.python),
                "-P",
                "-W",
                "ignore",
                str(Path(__file__).with_name("steps.py")),
                json.dumps(wanted),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=REPOSITORY,
            env=os.environ | _ONE_THREAD | {"PYTHONPATH": str(REPOSITORY)},
        )
        os.sched_setaffinity(self.process.pid, {core})
        self.facts = self._answer()
        if contestant.python == Path(sys.executable):
            self.facts |= _our_facts(contestant)

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("{"):  # some packages print a banner
                return json.loads(line)
        raise RuntimeError(f"the process that steps an environment ended with {self.process.wait()}")

    def step_for(self, seconds: float) -> dict[str, float]:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{seconds}\n")
        self.process.stdin.flush()
        return self._answer()

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()


def _show_facts(name: str, facts: dict[str, Any]) -> None:
    shape = " x ".join(str(length) for length in facts["observation"]) + f" {facts['dtype']}"
    print(
        f"{name:<40} {facts['substeps'] * facts['time_step']:8.2f} {facts['substeps']:9.1f} {facts['time_step']:8.3f} "
        f"{facts['iterations']:11} {facts['bodies']:7} {facts['shapes']:7} {facts['joints']:7}  {shape}"
    )


def _show_speed(name: str, facts: dict[str, Any], rounds: list[dict[str, float]]) -> None:
    rate = float(np.median([r["steps"] / r["step_time"] for r in rounds]))
    steps, episodes = (sum(r[key] for r in rounds) for key in ("steps", "episodes"))
    step_time, reset_time = (sum(r[key] for r in rounds) for key in ("step_time", "reset_time"))
    print(
        f"{name:<40} {rate:8.0f} {readable(1.0 / rate):>10} {rate * facts['substeps']:11.0f} "
        f"{rate * facts['substeps'] * facts['time_step']:11.0f} {readable(reset_time / episodes):>10} "
        f"{steps / episodes:12.1f} {steps / (step_time + reset_time):12.0f} {rounds[-1]['memory']:8.0f}"
    )


def _show_ratio(ours: str, peer: str, rate_of: dict[str, np.ndarray], facts: dict[str, dict[str, Any]]) -> None:
    ratio = Ratio.of(1.0 / rate_of[peer], 1.0 / rate_of[ours])
    substeps = facts[ours]["substeps"] / facts[peer]["substeps"]
    seconds = substeps * facts[ours]["time_step"] / facts[peer]["time_step"]
    print(
        f"{ours:<34} over {peer:<36} {ratio.median:8.2f} {ratio.least:8.2f} {ratio.median * substeps:9.2f} "
        f"{ratio.median * seconds:9.2f}"
    )


def run(effort: Effort) -> None:
    print(f"\nPeers, random actions, one core\n{_STEPS}")
    missing = sorted({c.python.parents[1].name for c in CONTESTANTS if not c.python.exists()})
    if missing:
        print(f"left out, not installed: {', '.join(missing)} (make bench-peers installs them)")
    contestants = [contestant for contestant in CONTESTANTS if contestant.python.exists()]
    core = max(os.sched_getaffinity(0))
    workers = {contestant.name: _Worker(contestant, core) for contestant in contestants}
    try:
        _measure(workers, effort)
    finally:
        for worker in workers.values():
            worker.close()


def _measure(workers: dict[str, _Worker], effort: Effort) -> None:
    print(f"\n{'a step simulates':<40} {'seconds':>8} {'substeps':>9} {'s each':>8} {'iterations':>11}", end="")
    print(f" {'dynamic':>7} {'shapes':>7} {'joints':>7}  observation or picture")
    facts = {name: worker.facts for name, worker in workers.items()}
    for name in workers:
        _show_facts(name, facts[name])
    for worker in workers.values():
        worker.step_for(effort.seconds / 5.0)
    rounds: dict[str, list[dict[str, float]]] = {name: [] for name in workers}
    for _ in range(max(1, effort.repetitions // 2)):
        for name, worker in workers.items():
            rounds[name].append(worker.step_for(effort.seconds))
    print(f"\n{'':<40} {'steps/s':>8} {'a step':>10} {'substeps/s':>11} {'simulated s':>11} {'a reset':>10}", end="")
    print(f" {'steps/episode':>12} {'with resets':>12} {'peak MiB':>8}")
    for name in workers:
        _show_speed(name, facts[name], rounds[name])
    print(f"\n{'':<75} {'steps/s':>8} {'best':>8} {'substeps':>9} {'simulated'}")
    rate_of = {name: np.array([r["steps"] / r["step_time"] for r in rounds[name]]) for name in workers}
    for ours, peer in PAIRS:
        if ours.name in workers and peer.name in workers:
            _show_ratio(ours.name, peer.name, rate_of, facts)
