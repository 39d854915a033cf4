"""Independent tasks on several workers: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar, cast

if TYPE_CHECKING:
    from distributed import Client

    from pipelines.config import ExecutorConfig

Item = TypeVar("Item")
Result = TypeVar("Result")

CONNECTION_TIMEOUT_S = 30.0
"""Time limit for the answer of a scheduler, and for its first worker."""

_IDLE_TIME_S = 7 * 24 * 3600
"""Idle time after which a worker process ends. A call at that moment would wait forever, so it is longer than any pause
between two calls; processes end with the one that started them."""


def run_tasks(function: Callable[[Item], Result], items: Iterable[Item], executor: ExecutorConfig) -> Iterator[Result]:
    """Yield ``function(item)`` of every item, in the order of completion.

    A result must be a function of its item only, and contain the index of the item if needed. ``function`` and the
    items are sent to the workers, so they must be small and picklable. Each worker computes on one thread, so results
    do not depend on the number of workers. If a task raises an exception, it is raised here, and the other tasks are
    cancelled, as when the iterator is closed. If a Dask worker dies, its tasks are given to other workers.

    Worker processes of this machine start in the first call, which takes seconds, and serve all later ones; a single
    task runs in this process.

    Raises:
        ConfigError: the Dask cluster cannot be reached, or has no worker.
    """
    num_workers = worker_count(executor)
    if num_workers is None or executor.name == "dask":
        yield from _on_cluster(function, items, executor)
    elif num_workers == 1:
        yield from _in_this_process(function, items)
    else:
        yield from _in_processes(function, items, num_workers)


def worker_count(executor: ExecutorConfig) -> int | None:
    """Number of tasks that run at the same time; None for all threads of a cluster."""
    if executor.num_workers is not None or executor.name == "dask":
        return executor.num_workers
    from joblib import cpu_count

    return cpu_count()


@contextmanager
def single_threaded() -> Iterator[None]:
    """Run networks on one thread within this block: small batches are faster, and the order of sums is fixed."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _in_this_process(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    for item in items:
        with single_threaded():
            result = function(item)
        yield result


def _in_processes(function: Callable[[Item], Result], items: Iterable[Item], num_workers: int) -> Iterator[Result]:
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky import get_reusable_executor

    remaining = iter(items)
    first = list(itertools.islice(remaining, 2))
    if len(first) < 2:
        yield from _in_this_process(function, first)
        return
    # Tasks are sent one by one: they take milliseconds to minutes, and slow ones should not be in one batch.
    with parallel_config("loky", n_jobs=num_workers, inner_max_num_threads=1, idle_worker_timeout=_IDLE_TIME_S):
        parallel = Parallel(n_jobs=num_workers, return_as="generator_unordered")
        task = delayed(_while_parent_lives)
        results = parallel(task(os.getpid(), function, item) for item in itertools.chain(first, remaining))
        try:
            yield from cast("Iterator[Result]", results)
        except BaseException:  # of a task, or this iterator was closed: tasks that have begun are not waited for
            cast("Any", get_reusable_executor)(reuse=True).shutdown(wait=True, kill_workers=True)
            raise


def _while_parent_lives(parent: int, function: Callable[[Item], Result], item: Item) -> Result:
    """Run a task in a process of this machine."""
    _watch(parent)
    return function(item)


@lru_cache(maxsize=1)
def _watch(parent: int) -> None:
    """End this process within a second after its parent is killed; otherwise loky keeps it waiting for minutes for the
    next task, with all its memory."""

    def end_with_parent() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _on_cluster(
    function: Callable[[Item], Result], items: Iterable[Item], executor: ExecutorConfig
) -> Iterator[Result]:
    """Keep twice as many tasks on the cluster as it has threads, so that no worker waits for the next task."""
    from distributed import as_completed

    waiting = iter(items)
    with _dask_client(executor) as client:
        completed: Any = as_completed()
        num_sent = num_done = 0

        def send() -> None:
            nonlocal num_sent
            cores: Any = client.ncores()  # not a coroutine, since the client is synchronous
            room = executor.num_workers or 2 * max(1, sum(cores.values()))
            while num_sent - num_done < room:
                try:
                    item = next(waiting)
                except StopIteration:
                    return
                # Not "pure": otherwise the result of an equal earlier task would be reused.
                completed.add(client.submit(_on_one_thread, function, item, pure=False))
                num_sent += 1

        send()
        while num_done < num_sent:
            future = next(completed)
            num_done += 1
            result = future.result()
            future.release()
            send()
            yield result


@contextmanager
def _dask_client(executor: ExecutorConfig) -> Iterator[Client]:
    from visualrhp.errors import ConfigError

    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError(
            "executor=dask needs the package distributed, which is not installed: pip install '.[dask]', or choose "
            "executor=loky."
        ) from error
    try:
        client = Client(executor.address, timeout=CONNECTION_TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"no Dask scheduler answers at executor.address={executor.address} ({error}); start one with dask "
            "scheduler, or choose executor=loky."
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECTION_TIMEOUT_S)
        except TimeoutError as error:
            raise ConfigError(
                f"the Dask scheduler at executor.address={executor.address} has no worker; start some with dask worker "
                f"{executor.address} --nthreads 1, in the checkout and with the same environment."
            ) from error
        yield client


def _on_one_thread(function: Callable[[Item], Result], item: Item) -> Result:
    """Run a task on the cluster. Workers may run several at once, so the number of threads is not restored."""
    import torch

    torch.set_num_threads(1)
    return function(item)
