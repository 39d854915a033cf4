"""A worker process of :class:`~visualrhp.environments.backends.WorkerBackend`.

Started as ``python -m visualrhp.environments.worker``.

Its arguments are the descriptors of a socket, which carries the commands, and of the file that holds the arrays.
"""

from __future__ import annotations

import mmap
import os
import signal
import sys
from multiprocessing.connection import Connection

from visualrhp.environments.slots import SlotArrays, Slots


def serve(connection: Connection, memory: int) -> None:
    """Execute commands until the other end is closed.

    The first message is (family, N, rows); every other one names a method of :class:`Slots` and holds its arguments.
    The answer is (None, its result), or (the exception that was raised, None).
    """
    family, num_slots, rows = connection.recv()
    mapped = mmap.mmap(memory, SlotArrays.num_bytes(family, num_slots))
    slots = Slots(family, SlotArrays.over(family, num_slots, mapped), rows)
    while True:
        command, *arguments = connection.recv()
        try:
            result = getattr(slots, command)(*arguments)
        except Exception as error:
            connection.send((error, None))
        else:
            connection.send((None, result))


def main(arguments: list[str]) -> None:
    """Serve until the parent closes the connection or ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole process group; the parent decides
    connection, memory = Connection(int(arguments[0])), int(arguments[1])
    try:
        serve(connection, memory)
    except (EOFError, ConnectionError):
        pass
    finally:
        os.close(memory)


if __name__ == "__main__":
    main(sys.argv[1:])
