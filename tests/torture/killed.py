"""Run a pipeline whose process group is killed before its n-th file operation: ``python -m tests.torture.killed N STAGE
ARGUMENTS``. With N = 0 it is not killed, and the number of operations is written to the file in ``COUNT_FILE``."""

from __future__ import annotations

import atexit
import os
import runpy
import signal
import sys
from pathlib import Path
from typing import Any

COUNT_FILE = "VISUALRHP_COUNT_FILE"
_CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.truncate", "sqlite3.connect"}


def is_change(event: str, arguments: tuple[Any, ...]) -> bool:
    """Whether an audit event changes a file: its content, its name or its existence."""
    if event == "open":
        flags = arguments[2]
        return isinstance(flags, int) and bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
    return event in _CHANGES


def main() -> None:
    limit, stage = int(sys.argv[1]), sys.argv[2]
    sys.argv = [stage, *sys.argv[3:]]
    main_process, count = os.getpid(), 0

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal count
        if is_change(event, arguments) and os.getpid() == main_process:
            count += 1
            if count == limit:
                os.killpg(os.getpgid(0), signal.SIGKILL)

    sys.addaudithook(audit)
    if counted := os.environ.get(COUNT_FILE):
        atexit.register(lambda: Path(counted).write_text(str(count)))
    runpy.run_module(f"pipelines.{stage}", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
