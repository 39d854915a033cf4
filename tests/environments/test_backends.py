"""Worker processes: results do not depend on them, when they start and end, and what they survive."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest
import torch

from tests.environments.rollouts import FEW, random_policy, run
from visualrhp.environments.backends import WorkerBackend, available_cores, default_workers
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.errors import VisualRHPError
from visualrhp.scene.sampling import SceneDistribution


@pytest.mark.parametrize(("action_space", "observation"), [("continuous", "image"), ("discrete", "cartesian")])
def test_results_do_not_depend_on_the_number_of_workers(action_space, observation):
    distribution = FEW if observation == "image" else SceneDistribution(num_objects=(2, 2))
    alone, crowd = (
        BatchedClutterEnv(distribution, action_space, observation, num_envs=5, seed=3, num_workers=workers)
        for workers in (0, 2)
    )
    begun = [env.reset() for env in (alone, crowd)]
    assert [model.scene for model in crowd.models] == alone.scenes
    expected, current = run(alone, random_policy(0, alone), 55, begun[0])
    found, _ = run(crowd, random_policy(0, crowd), 55, begun[1])
    assert expected["next", "done"].any() and (expected == found).all()
    assert (alone.instances, alone.num_actions) == (crowd.instances, crowd.num_actions)
    assert alone.states == crowd.states and alone.scenes == crowd.scenes
    action = random_policy(0, alone)(current)["action"][4]
    action = action.item() if action_space == "discrete" else action.double().numpy()
    assert [model.scene for model in crowd.models] == alone.scenes  # other ones than at first
    ours, theirs = (env.models[4].simulate(env.states[4], action) for env in (alone, crowd))
    assert ours.next_state == theirs.next_state
    crowd.close()
    snapshot = alone.snapshot()
    expected, _ = run(alone, random_policy(1, alone), 5, current)
    found, _ = run(crowd, random_policy(1, crowd), 5, crowd.restore(snapshot))  # starts new workers
    assert (expected == found).all()
    crowd.close()
    crowd.close()


@pytest.mark.parametrize("num_workers", [0, 3])
def test_a_snapshot_is_restored_with_another_number_of_workers(num_workers):
    env, other = (
        BatchedClutterEnv(FEW, "continuous", num_envs=5, seed=2, num_workers=workers) for workers in (2, num_workers)
    )
    _, current = run(env, random_policy(0, env), 30)
    snapshot = env.snapshot()
    expected, _ = run(env, random_policy(1, env), 55, current)
    found, _ = run(other, random_policy(1, other), 55, other.restore(snapshot))
    assert expected["next", "done"].any() and (expected == found).all()
    assert all(torch.equal(tensor, other.snapshot()[name]) for name, tensor in env.snapshot().items())
    assert env.scenes == other.scenes and env.states == other.states
    env.close()
    other.close()


def processes_of(env: BatchedClutterEnv) -> list[subprocess.Popen]:
    assert isinstance(env.backend, WorkerBackend)
    return list(env.backend.processes)


def test_workers_start_late_and_end_with_the_environment():
    env = BatchedClutterEnv(FEW, "discrete", num_envs=2, num_workers=2)
    assert env.backend is None
    env.reset()
    processes = processes_of(env)
    assert len(processes) == 2 and all(process.poll() is None for process in processes)
    del env
    gc.collect()  # a torchrl environment refers to itself
    assert all(process.wait(10) == 0 for process in processes)


def test_by_default_few_slots_stay_in_this_process():
    def num_workers(num_envs: int) -> int:
        env = BatchedClutterEnv(FEW, "discrete", num_envs=num_envs)
        env.reset()
        count = len(processes_of(env)) if isinstance(env.backend, WorkerBackend) else 0
        env.close()
        return count

    others = available_cores() - 1
    assert [num_workers(num_envs) for num_envs in (3, 4, 10)] == [0, min(others, 1), min(others, 4)]
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:  # the cores are left to its siblings
        assert pool.submit(default_workers, 64).result() == 0


def test_an_interrupt_from_the_keyboard_reaches_no_worker():
    env = BatchedClutterEnv(FEW, "discrete", num_envs=2, num_workers=1)
    env.reset()
    assert [os.getpgid(process.pid) for process in processes_of(env)] == [p.pid for p in processes_of(env)]
    env.close()


def test_reports_that_a_worker_has_ended():
    env = BatchedClutterEnv(FEW, "discrete", num_envs=2, num_workers=2)
    current = random_policy(0, env)(env.reset())
    processes_of(env)[1].kill()
    with pytest.raises(VisualRHPError, match="worker process 1"):
        env.step(current)
    env.close()


ORPHANS = """
import os, sys
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.scene.sampling import SceneDistribution
env = BatchedClutterEnv(SceneDistribution(), "discrete", num_envs=2, num_workers=1)  # no main guard
env.reset()
print(env.backend.processes[0].pid, flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="looks at processes in /proc")
def test_workers_do_not_outlive_a_killed_parent(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(ORPHANS)
    with subprocess.Popen([sys.executable, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as parent:
        worker = int(parent.stdout.readline())
        assert os.path.exists(f"/proc/{worker}")
        parent.send_signal(signal.SIGKILL)
    for _ in range(100):
        if not os.path.exists(f"/proc/{worker}") or is_zombie(worker):
            return
        time.sleep(0.1)
    pytest.fail("the worker still runs ten seconds after its parent was killed")


def is_zombie(process: int) -> bool:
    """Whether it is a zombie process."""
    with open(f"/proc/{process}/stat") as stat:
        return stat.read().rsplit(")", 1)[1].split()[0] == "Z"
