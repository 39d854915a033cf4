"""A real Dask cluster on the loopback interface: the same bytes, also when a worker dies in the middle."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from pipelines import evaluate, generate_demos
from pipelines.cells import Cells
from pipelines.config import EvaluateConfig, ExecutorConfig, GenerateDemosConfig
from pipelines.points import compose_points, prepare
from pipelines.workflow import executor as workflow_executor
from pipelines.workflow.app import compose
from pipelines.workflow.executor import run_tasks
from pipelines.workflow.tracking import open_run
from visualrhp.errors import ConfigError, SimulationError

REPOSITORY = Path(__file__).resolve().parents[2]
SETTINGS = (
    "scale=smoke",
    "tracking=none",
    "scene.num_objects=[1,4]",
    "demonstrations.count=60",
    "demonstrations.shard_size=25",
)
TIMES = ["decision_time_s", "mean_decision_time_s", "max_decision_time_s", "simulation_time_s", "execution_time_s"]


class Cluster:
    """A scheduler and its workers, each a process of its own.

    Attributes:
        address: of the scheduler.
        workers: their processes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file = folder / "scheduler.json"
        self.workers: list[subprocess.Popen[bytes]] = []
        options = ["--scheduler-file", str(self._file), "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
        self._scheduler = self._start("scheduler", *options)
        deadline = time.monotonic() + 60.0
        while not self._file.is_file() and time.monotonic() < deadline:
            time.sleep(0.05)
        self.address = str(json.loads(self._file.read_text())["address"])

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        with (self._folder / "log.txt").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments],
                cwd=REPOSITORY,
                env=os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(REPOSITORY)},
                stdout=log,
                stderr=log,
            )

    def add_worker(self) -> None:
        """One thread, and no nanny that would start it again."""
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self._folder)]
        self.workers.append(self._start("worker", self.address, *options))

    def wait_for_workers(self) -> None:
        from distributed import Client

        with Client(self.address) as client:
            client.wait_for_workers(sum(worker.poll() is None for worker in self.workers), timeout=60)

    def close(self) -> None:
        for process in [*self.workers, self._scheduler]:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    running = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        running.add_worker()
        running.add_worker()
        running.wait_for_workers()
        yield running
    finally:
        running.close()


def generate(work: Path, *executor: str) -> dict[str, bytes]:
    config = compose("generate_demos", GenerateDemosConfig, [*SETTINGS, *executor])
    with pytest.MonkeyPatch.context() as patch, open_run(config, "generate_demos", "test") as run:
        patch.setattr(generate_demos, "write_pictures", lambda *_: None)
        folder = generate_demos.generate(config, work, run)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return generate(tmp_path_factory.mktemp("reference"), "executor.num_workers=1")


def on(cluster: Cluster) -> list[str]:
    return ["executor=dask", f"executor.address={cluster.address}"]


@pytest.mark.parametrize("num_workers", [1, 2, 4])
def test_one_two_and_four_tasks_at_once_make_the_same_bytes(
    tmp_path: Path, cluster: Cluster, reference: dict[str, bytes], num_workers: int
) -> None:
    assert generate(tmp_path, *on(cluster), f"executor.num_workers={num_workers}") == reference


def test_evaluation_gives_the_same_rows(tmp_path: Path, cluster: Cluster) -> None:
    settings = ["scale=smoke", "tracking=none", "planner=crafted_heuristic_rhp", "planner.num_rollouts=2"]
    settings += ["planner.horizon=1", "num_episodes=4", "scene.num_objects=[1,3]"]
    tables = []
    for name, executor in {"here": ["executor.num_workers=1"], "cluster": on(cluster)}.items():
        config = compose("evaluate", EvaluateConfig, [*settings, *executor])
        (tmp_path / name).mkdir()
        with open_run(config, "evaluate", "test") as run:
            folder = evaluate.evaluate(
                config, prepare(compose_points(config)), tmp_path / name, Cells(tmp_path / name / "cells"), run
            )
        tables.append(pd.read_parquet(folder / "episodes.parquet").drop(columns=TIMES))
    pd.testing.assert_frame_equal(*tables)


def process_of(item: int) -> tuple[int, int, int]:
    import torch

    time.sleep(0.05)
    return item, os.getpid(), torch.get_num_threads()


def fail(item: int) -> int:
    if item == 3:
        raise SimulationError(f"task {item} diverged")
    return item


def test_tasks_run_on_all_workers_on_one_thread_each(cluster: Cluster) -> None:
    executor = ExecutorConfig("dask", None, cluster.address)
    results = list(run_tasks(process_of, range(12), executor))
    assert sorted(item for item, *_ in results) == list(range(12))
    assert {process for _, process, _ in results} == {worker.pid for worker in cluster.workers}
    assert {threads for *_, threads in results} == {1}
    assert list(run_tasks(process_of, [], executor)) == []


def test_an_error_of_a_task_is_raised(cluster: Cluster) -> None:
    with pytest.raises(SimulationError, match="task 3 diverged"):
        list(run_tasks(fail, range(8), ExecutorConfig("dask", 2, cluster.address)))


def test_a_worker_that_dies_in_the_middle_changes_no_byte(
    tmp_path: Path, cluster: Cluster, reference: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last test here: it leaves one worker."""
    undisturbed = workflow_executor.run_tasks
    victim = cluster.workers[0]

    def with_a_death(function: Callable[[Any], Any], items: Any, executor: ExecutorConfig) -> Iterator[Any]:
        for number, result in enumerate(undisturbed(function, items, executor)):
            if number == 1:  # two tasks for each worker are on the cluster now
                victim.send_signal(signal.SIGKILL)
                assert victim.wait() == -signal.SIGKILL
            yield result

    monkeypatch.setattr(workflow_executor, "run_tasks", with_a_death)
    assert generate(tmp_path, *on(cluster)) == reference
    assert victim.poll() is not None
    assert cluster.workers[1].poll() is None


def test_a_scheduler_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{unused.getsockname()[1]}"
    monkeypatch.setattr(workflow_executor, "CONNECTION_TIMEOUT_S", 1.0)
    with pytest.raises(ConfigError, match=f"no Dask scheduler answers at .*{address}"):
        list(run_tasks(fail, range(3), ExecutorConfig("dask", None, address)))


def test_a_scheduler_without_workers_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(workflow_executor, "CONNECTION_TIMEOUT_S", 1.0)
    empty = Cluster(tmp_path)
    try:
        with pytest.raises(ConfigError, match=r"has no worker; start some with dask"):
            list(run_tasks(fail, range(3), ExecutorConfig("dask", None, empty.address)))
    finally:
        empty.close()
