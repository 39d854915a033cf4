"""Who simulates the slots of a batched environment: this process, or worker processes that share its board.

A result is a function of the family, the seed and the actions, never of who simulated: the two crews are exchangeable.
"""

from __future__ import annotations

import mmap
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

from visualrhp.environments.slots import Board, Slots, TaskFamily
from visualrhp.errors import VisualRHPError
from visualrhp.scene.sampling import sample_task_instance
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import FloatArray, State

_SLOTS_PER_WORKER = 16
"""Fewest slots for which a process of their own pays by default: its start takes as long as thousands of actions."""

_CLOSING_TIME = 5.0
"""How long a worker may take to end [s], before it is killed."""


class Crew(ABC):
    """Simulates the tasks of a board.

    Attributes:
        board: where the tasks stand.
    """

    board: Board

    @abstractmethod
    def start(self, seed: int, slots: Sequence[int], instances: Sequence[int]) -> None:
        """Begin task instance ``instances[i]`` of ``seed`` in slot ``slots[i]``."""

    @abstractmethod
    def resume(self, seed: int, instances: Sequence[int], num_actions: Sequence[int], states: FloatArray) -> None:
        """Go on, in all slots, from ``states`` [N, 5 + 3 max m]."""

    @abstractmethod
    def act(self) -> None:
        """Take the actions on the board."""

    @property
    @abstractmethod
    def scenes(self) -> list[Scene]:
        """The N scenes that are being worked on."""

    @property
    @abstractmethod
    def states(self) -> list[State]:
        """The N current states."""

    @property
    @abstractmethod
    def models(self) -> list[TransitionModel]:
        """The N decision processes."""

    def close(self) -> None:  # noqa: B027 - a crew may have nothing to end
        """End processes of one's own; more than once does no harm."""


class LocalCrew(Crew):
    """All tasks in this process."""

    def __init__(self, family: TaskFamily, num_slots: int) -> None:
        self.board = Board.over(family, num_slots, bytearray(Board.num_bytes(family, num_slots)))
        self._slots = Slots(family, self.board, range(num_slots))

    def start(self, seed: int, slots: Sequence[int], instances: Sequence[int]) -> None:
        self._slots.start(seed, slots, instances)

    def resume(self, seed: int, instances: Sequence[int], num_actions: Sequence[int], states: FloatArray) -> None:
        self._slots.resume(seed, instances, num_actions, states)

    def act(self) -> None:
        self._slots.act()

    @property
    def scenes(self) -> list[Scene]:
        return [task.instance.scene for task in self._slots.tasks]

    @property
    def states(self) -> list[State]:
        return [task.state for task in self._slots.tasks]

    @property
    def models(self) -> list[TransitionModel]:
        return [task.model for task in self._slots.tasks]


class WorkerCrew(Crew):
    """Equal shares of the tasks in worker processes, one exchange with each a batch step.

    Observations, states and actions pass through memory that all map; only the words "act", "start" and so on pass
    through sockets. A worker ends when its socket is closed, so it outlives neither :meth:`close` nor the parent,
    whatever ends it. Workers are interpreters of their own rather than children of :mod:`multiprocessing`: they inherit
    no thread or lock, do not import the main module, and may be started from a daemon.

    Scenes and models for planners are made in this process when they are asked for.

    Args:
        family: what the tasks have in common.
        num_slots: N.
        num_workers: processes, at most N of them are of use.
    """

    def __init__(self, family: TaskFamily, num_slots: int, num_workers: int) -> None:
        num_bytes = Board.num_bytes(family, num_slots)
        num_workers = min(num_workers, num_slots)
        bounds = [num_slots * worker // num_workers for worker in range(num_workers + 1)]
        self._shares = [range(low, high) for low, high in pairwise(bounds)]
        self._family = family
        self._seeds = [0] * num_slots
        self._instances: list[tuple[tuple[int, int], TaskInstance] | None] = [None] * num_slots
        self._models: list[TransitionModel | None] = [None] * num_slots
        with tempfile.TemporaryFile(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as file:
            file.truncate(num_bytes)
            self.board = Board.over(family, num_slots, mmap.mmap(file.fileno(), num_bytes))
            self._connections, processes = zip(*(_start_worker(file.fileno()) for _ in self._shares), strict=True)
        self._processes: tuple[subprocess.Popen[bytes], ...] = processes
        self.close = weakref.finalize(self, _end_workers, os.getpid(), self._connections, processes)
        self._busy: list[int] = []
        for worker, share in enumerate(self._shares):
            self._send(worker, (family, num_slots, share))

    def start(self, seed: int, slots: Sequence[int], instances: Sequence[int]) -> None:
        of_slot = dict(zip(slots, instances, strict=True))
        for slot in slots:
            self._seeds[slot] = seed
        orders: list[tuple | None] = []
        for share in self._shares:
            mine = [slot for slot in share if slot in of_slot]
            orders.append(("start", seed, mine, [of_slot[slot] for slot in mine]) if mine else None)
        self._order(orders)

    def resume(self, seed: int, instances: Sequence[int], num_actions: Sequence[int], states: FloatArray) -> None:
        self._seeds = [seed] * len(self._seeds)
        self._order([("resume", seed, instances, num_actions, states)] * len(self._shares))

    def act(self) -> None:
        self._order([("act",)] * len(self._shares))

    def _order(self, orders: Sequence[tuple | None]) -> None:
        """Give each worker its order (or none), and wait until all are carried out.

        Raises:
            VisualRHPError: a worker has ended, or raised this error.
        """
        self._answers()  # of orders that the user interrupted
        for worker, order in enumerate(orders):
            if order is not None:
                self._send(worker, order)
                self._busy.append(worker)
        errors = self._answers()
        if errors:
            raise errors[0]

    def _send(self, worker: int, message: object) -> None:
        try:
            self._connections[worker].send(message)
        except OSError as error:
            raise self._ended(worker) from error

    def _answers(self) -> list[Exception]:
        """Wait for every worker that has an order; what went wrong."""
        errors = []
        while self._busy:
            worker = self._busy[0]
            try:
                error = self._connections[worker].recv()
            except (EOFError, OSError):
                error = self._ended(worker)
            del self._busy[0]
            if error is not None:
                errors.append(error)
        return errors

    def _ended(self, worker: int) -> VisualRHPError:
        code = self._processes[worker].poll()
        return VisualRHPError(
            f"worker process {worker} of the environment has ended"
            + (f" with exit code {code}" if code is not None else "")
            + "; what it said is on stderr. Close the environment and restore a snapshot in a new one"
        )

    @property
    def scenes(self) -> list[Scene]:
        return [self._instance(slot).scene for slot in range(len(self._instances))]

    @property
    def states(self) -> list[State]:
        return [self.board.state_of(slot) for slot in range(len(self._instances))]

    @property
    def models(self) -> list[TransitionModel]:
        scenes = self.scenes  # forgets the models of scenes that are over
        for slot, scene in enumerate(scenes):
            if self._models[slot] is None:
                action_space = make_action_space(self._family.action_space)
                self._models[slot] = TransitionModel(scene, action_space, self._family.physics)
        return [model for model in self._models if model is not None]

    def _instance(self, slot: int) -> TaskInstance:
        key = (self._seeds[slot], int(self.board.instance[slot]))
        known = self._instances[slot]
        if known is None or known[0] != key:
            self._models[slot] = None
            instance = sample_task_instance(self._family.distribution, key[0], self._family.split, key[1])
            known = self._instances[slot] = key, instance
        return known[1]


def make_crew(family: TaskFamily, num_slots: int, num_workers: int | None) -> Crew:
    """A crew of ``num_workers`` processes; None: one a core if each gets enough slots to pay; 0: this process."""
    if num_workers is None:
        num_workers = min(available_cores(), num_slots // _SLOTS_PER_WORKER)
        num_workers = 0 if num_workers < 2 else num_workers  # a single worker does nothing that this process cannot
    return WorkerCrew(family, num_slots, num_workers) if num_workers else LocalCrew(family, num_slots)


def available_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def _start_worker(memory: int) -> tuple[Connection, subprocess.Popen[bytes]]:
    """A worker process that maps the file ``memory`` and takes orders from the connection."""
    ours, theirs = socketpair()
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "visualrhp.environments.worker", str(theirs.fileno()), str(memory)],
            pass_fds=(theirs.fileno(), memory),
            stdin=subprocess.DEVNULL,
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
