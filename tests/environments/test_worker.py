"""A worker executes commands on its share of the arrays, sends errors back, and ends with its connection."""

from __future__ import annotations

import mmap
import os
import signal
import tempfile
import threading
from collections.abc import Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection

import numpy as np
import pytest

from visualrhp.environments.slots import SlotArrays, Slots, TaskFamily
from visualrhp.environments.worker import main, serve
from visualrhp.errors import ActionError
from visualrhp.observation import make_observation
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.streams import Split

FAMILY = TaskFamily(SceneDistribution(num_objects=(2, 2)), Split.REINFORCEMENT, "discrete", make_observation("image"))
NUM_SLOTS = 3


@pytest.fixture
def served() -> Iterator[tuple[Connection, SlotArrays]]:
    """The caller's end of the connection of a worker of all slots, which runs in a thread, and the shared arrays."""
    num_bytes = SlotArrays.num_bytes(FAMILY, NUM_SLOTS)
    with tempfile.TemporaryFile() as file:
        file.truncate(num_bytes)
        ours, theirs = Pipe()
        ended: list[type[BaseException]] = []

        def run() -> None:
            try:
                serve(theirs, file.fileno())
            except EOFError:
                ended.append(EOFError)

        thread = threading.Thread(target=run)
        thread.start()
        ours.send((FAMILY, NUM_SLOTS, range(NUM_SLOTS)))
        yield ours, SlotArrays.over(FAMILY, NUM_SLOTS, mmap.mmap(file.fileno(), num_bytes))
        ours.close()
        thread.join(10.0)
        assert ended == [EOFError]


def test_commands_change_the_shared_arrays(served: tuple[Connection, SlotArrays]) -> None:
    connection, arrays = served
    here = SlotArrays.over(FAMILY, NUM_SLOTS, bytearray(SlotArrays.num_bytes(FAMILY, NUM_SLOTS)))
    slots = Slots(FAMILY, here, range(NUM_SLOTS))
    connection.send(("start", 5, [0, 1, 2], [0, 1, 2]))
    assert connection.recv() == (None, None)
    slots.start(5, [0, 1, 2], [0, 1, 2])
    for block in (arrays, here):
        block.action[:], block.is_active[:] = [0, 4, 6], True
    connection.send(("act",))
    assert connection.recv() == (None, None)
    slots.act()
    for name, array in vars(here).items():
        np.testing.assert_array_equal(vars(arrays)[name], array, err_msg=name)
    connection.send(("scenes", [2, 0]))
    assert connection.recv() == (None, slots.scenes([2, 0]))


def test_an_error_is_the_answer_and_the_worker_continues(served: tuple[Connection, SlotArrays]) -> None:
    connection, arrays = served
    connection.send(("start", 5, [0, 1, 2], [0, 1, 2]))
    assert connection.recv() == (None, None)
    arrays.action[:], arrays.is_active[:] = 99, True
    connection.send(("act",))
    error, result = connection.recv()
    assert isinstance(error, ActionError) and result is None
    arrays.action[:] = 0
    connection.send(("act",))
    assert connection.recv() == (None, None)


def test_a_worker_whose_parent_has_ended_closes_its_memory_and_returns() -> None:
    """Ctrl-C does not end it: the parent decides."""
    handler = signal.getsignal(signal.SIGINT)
    ours, theirs = Pipe()
    with tempfile.TemporaryFile() as file:
        file.truncate(SlotArrays.num_bytes(FAMILY, NUM_SLOTS))
        memory = os.dup(file.fileno())
        ours.send((FAMILY, NUM_SLOTS, range(NUM_SLOTS)))
        ours.close()
        try:
            main([str(os.dup(theirs.fileno())), str(memory)])
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        finally:
            signal.signal(signal.SIGINT, handler)
            theirs.close()
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(memory)
