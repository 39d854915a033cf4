"""Backends that step the slots of a batched environment: this process, alone or with workers that share its arrays.

A result is a function of the family, the seed and the actions, and never of the backend.
"""

from __future__ import annotations

import mmap
import multiprocessing
import os
import subprocess
import sys
import tempfile
import weakref
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from multiprocessing.connection import Connection
from socket import socketpair
from typing import Any, cast

from visualrhp.environments.slots import SlotArrays, Slots, TaskFamily
from visualrhp.errors import VisualRHPError
from visualrhp.execution.world import SimulatedWorld
from visualrhp.scene.scene import Scene
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import FloatArray, State

_SLOTS_PER_PROCESS = 2
"""Fewest slots per process by default: with 2 each, two processes are 1.15 to 1.2 times as fast as one."""

_CLOSING_TIME = 5.0
"""How long a worker may take to end [s], before it is killed."""


class Backend(ABC):
    """Simulates the tasks in the slots.

    Attributes:
        arrays: the states of the tasks.
    """

    arrays: SlotArrays

    @abstractmethod
    def start(self, seed: int, slots: Sequence[int], instances: Sequence[int]) -> None:
        """Begin task instance ``instances[i]`` of ``seed`` in slot ``slots[i]``."""

    @abstractmethod
    def resume(
        self, seeds: int | Sequence[int], instances: Sequence[int], num_actions: Sequence[int], states: FloatArray
    ) -> None:
        """Resume all slots from ``states`` [N, 5 + 3 max m]; the task instances are of one seed, or of one per slot."""

    @abstractmethod
    def act(self) -> None:
        """Take the actions in the arrays."""

    @property
    @abstractmethod
    def scenes(self) -> list[Scene]:
        """The N scenes of the running episodes."""

    @property
    @abstractmethod
    def states(self) -> list[State]:
        """The N current states."""

    @property
    @abstractmethod
    def models(self) -> list[TransitionModel]:
        """The N decision processes."""

    def close(self) -> None:  # noqa: B027 - a backend may have nothing to end
        """End the worker processes; calling it again has no effect."""


class LocalBackend(Backend):
    """Tasks in this process.

    Args:
        family: shared parameters of the tasks.
        arrays: of all slots.
        rows: the slots of these tasks.
    """

    def __init__(self, family: TaskFamily, arrays: SlotArrays, rows: range) -> None:
        self.arrays = arrays
        self._slots = Slots(family, arrays, rows)

    def start(self, seed: int, slots: Sequence[int], instances: Sequence[int]) -> None:
        self._slots.start(seed, slots, instances)

    def resume(
        self, seeds: int | Sequence[int], instances: Sequence[int], num_actions: Sequence[int], states: FloatArray
    ) -> None:
        if self._slots.rows:
            self._slots.resume(seeds, instances, num_actions, states)

    def act(self) -> None:
        self._slots.act()

    @property
    def scenes(self) -> list[Scene]:
        return [episode.scene for episode in self._slots.episodes]

    @property
    def states(self) -> list[State]:
        return [episode.state for episode in self._slots.episodes]

    @property
    def models(self) -> list[TransitionModel]:
        return [cast(SimulatedWorld, episode.world).model for episode in self._slots.episodes]


class WorkerBackend(Backend):
    """Equal shares of the tasks in this process and in worker processes.

    There is one exchange per batch step and worker, and this process steps its own share in the meantime. Observations,
    states and actions are in shared memory; only commands pass through sockets. A worker ends when its socket is
    closed, so it outlives neither :meth:`close` nor the parent, whatever ends it. Workers are separate interpreters
    rather than children of :mod:`multiprocessing`: they inherit no thread or lock, do not import the main module, and
    may be started from a daemon.

    Scenes of the workers' tasks are requested from them lazily, for planners in this process, which has its own models.

    Args:
        family: shared parameters of the tasks.
        num_slots: N.
        num_workers: worker processes, at most N (with N workers, this process has no share).

    Attributes:
        processes: of the workers.
    """

    def __init__(self, family: TaskFamily, num_slots: int, num_workers: int) -> None:
        num_bytes = SlotArrays.num_bytes(family, num_slots)
        num_workers = min(num_workers, num_slots)
        num_processes = num_workers + 1
        bounds = [num_slots * process // num_processes for process in range(num_processes + 1)]
        self._shares = [range(low, high) for low, high in pairwise(bounds)]
        self._family = family
        self._remote_slots = range(self._shares[0].stop, num_slots)
        self._models: dict[int, TransitionModel] = {}  # of the running episodes in remote slots, so far
        with tempfile.TemporaryFile(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as file:
            file.truncate(num_bytes)
            self.arrays = SlotArrays.over(family, num_slots, mmap.mmap(file.fileno(), num_bytes))
            self._connections, processes = zip(*(_start_worker(file.fileno()) for _ in self._shares[1:]), strict=True)
        self._own = LocalBackend(family, self.arrays, self._shares[0])
        self.processes: tuple[subprocess.Popen[bytes], ...] = processes
        self.close = weakref.finalize(self, _end_workers, os.getpid(), self._connections, processes)
        self._busy: list[int] = []
        for worker, share in enumerate(self._shares[1:]):
            self._send(worker, (family, num_slots, share))

    def start(self, seed: int, slots: Sequence[int], instances: Sequence[int]) -> None:
        of_slot = dict(zip(slots, instances, strict=True))
        for slot in slots:
            self._models.pop(slot, None)

        def begin(share: range) -> tuple[str, int, list[int], list[int]] | None:
            chosen = [slot for slot in share if slot in of_slot]
            return ("start", seed, chosen, [of_slot[slot] for slot in chosen]) if chosen else None

        self._command([begin(share) for share in self._shares])

    def resume(
        self, seeds: int | Sequence[int], instances: Sequence[int], num_actions: Sequence[int], states: FloatArray
    ) -> None:
        self._models.clear()
        self._command([("resume", seeds, instances, num_actions, states)] * len(self._shares))

    def act(self) -> None:
        self._command([("act",)] * len(self._shares))

    def _command(self, commands: Sequence[tuple[Any, ...] | None]) -> dict[int, Any]:
        """Give each process its command (or none), this one's first, and wait until all are done.

        Returns:
            The results of the workers, by their number.

        Raises:
            VisualRHPError: a worker has ended, or a process raised this error.
        """
        self._answers()  # of commands that the user interrupted
        own, *others = commands
        for worker, command in enumerate(others):
            if command is not None:
                self._send(worker, command)
                self._busy.append(worker)
        errors: list[Exception] = []
        if own is not None:
            name, *arguments = own
            try:
                getattr(self._own, name)(*arguments)
            except Exception as error:  # the workers are waited for first, as for an error of theirs
                errors.append(error)
        results, failures = self._answers()
        errors += failures
        if errors:
            raise errors[0]
        return results

    def _send(self, worker: int, message: object) -> None:
        try:
            self._connections[worker].send(message)
        except OSError as error:
            raise self._ended(worker) from error

    def _answers(self) -> tuple[dict[int, Any], list[Exception]]:
        """Wait for every busy worker; return their results, by their number, and their errors."""
        results: dict[int, Any] = {}
        errors: list[Exception] = []
        while self._busy:
            worker = self._busy[0]
            try:
                error, result = self._connections[worker].recv()
            except (EOFError, OSError):
                error, result = self._ended(worker), None
            del self._busy[0]
            if error is None:
                results[worker] = result
            else:
                errors.append(error)
        return results, errors

    def _ended(self, worker: int) -> VisualRHPError:
        code = self.processes[worker].poll()
        return VisualRHPError(
            f"worker process {worker} of the environment has ended"
            + (f" with exit code {code}" if code is not None else "")
            + "; its messages are on stderr. Close the environment and restore a snapshot in a new one"
        )

    @property
    def scenes(self) -> list[Scene]:
        return [*self._own.scenes, *(model.scene for model in self._remote_models())]

    @property
    def states(self) -> list[State]:
        return [self.arrays.state_of(slot) for slot in range(self._remote_slots.stop)]

    @property
    def models(self) -> list[TransitionModel]:
        return [*self._own.models, *self._remote_models()]

    def _remote_models(self) -> list[TransitionModel]:
        """Models of the workers' tasks, with scenes that their workers have sampled."""
        missing = [[slot for slot in share if slot not in self._models] for share in self._shares[1:]]
        if any(missing):
            scenes = self._command([None, *(("scenes", slots) if slots else None for slots in missing)])
            for worker, found in scenes.items():
                self._models |= {
                    slot: self._family.model(scene) for slot, scene in zip(missing[worker], found, strict=True)
                }
        return [self._models[slot] for slot in self._remote_slots]


def make_backend(family: TaskFamily, num_slots: int, num_workers: int | None) -> Backend:
    """A backend of this process and ``num_workers`` workers; None: :func:`default_workers`."""
    if num_workers is None:
        num_workers = default_workers(num_slots)
    if num_workers:
        return WorkerBackend(family, num_slots, num_workers)
    arrays = SlotArrays.over(family, num_slots, bytearray(SlotArrays.num_bytes(family, num_slots)))
    return LocalBackend(family, arrays, range(num_slots))


def default_workers(num_slots: int) -> int:
    """Workers for ``num_slots`` slots: one per core, except that of this process, as long as each process has 2 slots.

    None in a child process of :mod:`multiprocessing` or joblib: its siblings use the other cores, and processes that
    compete for a core take longer than one.
    """
    if multiprocessing.parent_process() is not None:
        return 0
    return max(0, min(available_cores(), num_slots // _SLOTS_PER_PROCESS) - 1)


def available_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def _start_worker(memory: int) -> tuple[Connection, subprocess.Popen[bytes]]:
    """A worker process that maps the file ``memory`` and takes commands from the connection."""
    ours, theirs = socketpair()
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "visualrhp.environments.worker", str(theirs.fileno()), str(memory)],
            pass_fds=(theirs.fileno(), memory),
            stdin=subprocess.DEVNULL,
            process_group=0,  # Ctrl-C reaches the parent alone, also while the worker still imports
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"},
        )
    return Connection(ours.detach()), process


def _end_workers(owner: int, connections: Sequence[Connection], processes: Sequence[subprocess.Popen[bytes]]) -> None:
    if os.getpid() != owner:  # a fork of the owner, whose workers these are not
        return
    for connection in connections:
        connection.close()
    for process in processes:
        try:
            process.wait(_CLOSING_TIME)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
