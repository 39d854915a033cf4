"""Independent tasks on several workers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar, cast

from pipelines.config import ExecutorConfig

Item = TypeVar("Item")
Result = TypeVar("Result")


def run_tasks(function: Callable[[Item], Result], items: Iterable[Item], executor: ExecutorConfig) -> Iterator[Result]:
    """Yield ``function(item)`` of every item, in the order in which they are done.

    A result has to be a function of its item alone, and carry the item's index if that matters. ``function`` and the
    items are sent to the workers, so they are small and can be pickled; each worker computes on one thread, so that
    results do not depend on the number of workers. An exception of a task is raised here, and the other tasks are
    abandoned; so they are when the iterator is closed.
    """
    with _workers(executor) as num_workers:
        if num_workers == 1:
            yield from _in_this_process(function, items)
            return
        from joblib import Parallel, delayed

        parallel = Parallel(n_jobs=num_workers, return_as="generator_unordered")
        results = parallel(delayed(function)(item) for item in items)
        yield from cast("Iterator[Result]", results)


def worker_count(executor: ExecutorConfig) -> int:
    """Number of tasks that are worked on at once."""
    if executor.num_workers is not None:
        return executor.num_workers
    if executor.name == "dask":
        return -1
    from joblib import cpu_count

    return cpu_count()


@contextmanager
def single_threaded() -> Iterator[None]:
    """Let the networks compute on one thread within this block: tiny batches are faster, and sums keep their order."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def _workers(executor: ExecutorConfig) -> Iterator[int]:
    """Have joblib use the executor's workers within this block."""
    num_workers = worker_count(executor)
    if num_workers == 1 and executor.name == "local":
        yield 1
        return
    from joblib import parallel_config

    if executor.name == "local":
        # Tasks are sent one by one: they take from milliseconds to minutes, and the slow ones should not queue up.
        with parallel_config(backend="loky", n_jobs=num_workers, inner_max_num_threads=1):
            yield num_workers
        return
    with _dask_client(executor), parallel_config(backend="dask", n_jobs=num_workers):
        yield num_workers


@contextmanager
def _dask_client(executor: ExecutorConfig) -> Iterator[None]:
    from visualrhp.errors import ConfigError

    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ConfigError(
            "executor=dask needs the package distributed, which is not installed: pip install '.[dask]', or choose "
            "executor=local."
        ) from error
    with Client(executor.address):
        yield


def _in_this_process(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    for item in items:
        with single_threaded():
            result = function(item)
        yield result
