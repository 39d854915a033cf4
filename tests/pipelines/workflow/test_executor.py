"""Tasks on one worker and on several."""

from __future__ import annotations

import ast
import functools
import os
from pathlib import Path

import numpy as np
import pytest

from pipelines.config import ExecutorConfig
from pipelines.workflow import executor as executor_module
from pipelines.workflow.executor import run_tasks, single_threaded, worker_count
from visualrhp.errors import SimulationError

PIPELINES = Path(executor_module.__file__).parents[1]
ONE = ExecutorConfig(name="loky", num_workers=1, address=None)
TWO = ExecutorConfig(name="loky", num_workers=2, address=None)


def draw(seed: int, index: int) -> tuple[int, bytes, int]:
    """A result that would show a dependence on the worker, the order or the number of threads."""
    import torch

    rng = np.random.default_rng([seed, index])
    matrix = torch.from_numpy(rng.standard_normal((64, 64)))
    return index, (matrix @ matrix).numpy().tobytes(), torch.get_num_threads()


def fail(index: int) -> int:
    if index == 3:
        raise SimulationError(f"task {index} diverged")
    return index


def test_results_do_not_depend_on_the_number_of_workers() -> None:
    results = [sorted(run_tasks(functools.partial(draw, 1), range(12), executor)) for executor in (ONE, TWO)]
    assert results[0] == results[1]
    assert [index for index, *_ in results[0]] == list(range(12))
    assert {threads for *_, threads in results[0]} == {1}


@pytest.mark.parametrize("executor", [ONE, TWO], ids=["one", "two"])
def test_an_error_of_a_task_is_raised_and_the_next_call_works(executor: ExecutorConfig) -> None:
    with pytest.raises(SimulationError, match="task 3 diverged"):
        list(run_tasks(fail, range(20), executor))
    assert sorted(run_tasks(fail, range(3), executor)) == [0, 1, 2]


@pytest.mark.parametrize("executor", [ONE, TWO], ids=["one", "two"])
def test_no_task_is_no_result(executor: ExecutorConfig) -> None:
    assert list(run_tasks(fail, [], executor)) == []


def process_of(index: int) -> int:
    return os.getpid()


def test_workers_serve_later_calls() -> None:
    processes = {process for _ in range(3) for process in run_tasks(process_of, range(8), TWO)}
    assert len(processes) <= 2
    assert os.getpid() not in processes


def test_a_single_task_starts_no_worker() -> None:
    assert list(run_tasks(process_of, iter(range(1)), TWO)) == [os.getpid()]


def test_one_worker_works_as_results_are_asked_for() -> None:
    done = []

    def record(index: int) -> int:
        done.append(index)
        return index

    results = run_tasks(record, range(3), ONE)
    assert next(results) == 0
    assert done == [0]


def test_threads_are_as_before_afterwards() -> None:
    import torch

    before = torch.get_num_threads()
    with single_threaded():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before


def test_worker_count() -> None:
    assert worker_count(TWO) == 2
    assert (worker_count(ExecutorConfig("loky", None, None)) or 0) >= 1


def test_pipelines_cache_nothing_in_the_modules_that_they_run_as() -> None:
    """What is in ``__main__`` is sent to workers by its source, but cached functions are looked up there by name."""
    for path in PIPELINES.glob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "@app(" in text:
            decorators = [
                ast.unparse(decorator)
                for node in ast.parse(text).body
                if isinstance(node, ast.FunctionDef)
                for decorator in node.decorator_list
            ]
            assert not [name for name in decorators if "cache" in name], path.name
