"""Damaged files: every kind of file that the library reads, damaged in every way, is refused in one sentence.

:func:`run` makes a small valid file of every kind (:mod:`tests.torture.victims`), damages it, reads it and counts what
went wrong. ``python -m tests.torture`` runs it at length, ``test_damage.py`` for a moment.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.torture.victims import Victim, make_victims
from visualrhp.errors import VisualRHPError

MOST_LETTERS = 2000
MOST_SECONDS = 2.0
_GIVES_UP_S = 4
_MOST_EXAMPLES = 10


@dataclass
class Tally:
    """What happened.

    Attributes:
        counts: refused; same (accepted, nothing that is read was altered); altered_values (accepted, and no checksum
            protects the value that was altered); and the failures: tracebacks, silent, bad_messages, slow.
        slowest_s: the longest time to read a file.
        examples: of failures.
    """

    counts: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    examples: list[str] = field(default_factory=list)

    def failure(self, what: str, case: str) -> None:
        self.counts[what] += 1
        if len(self.examples) < _MOST_EXAMPLES:
            self.examples.append(f"{what}: {case}")


@dataclass(frozen=True)
class Damage:
    """A way to damage a file.

    Attributes:
        name: of the way.
        apply: damages the file at a path.
        must_fail: the file cannot be used afterwards.
    """

    name: str
    apply: Callable[[Path, bytes, np.random.Generator, Path], Any]
    must_fail: bool = True


def run(num_cases: int, seed: int) -> dict[str, Any]:
    """Damage files ``num_cases`` times.

    Returns:
        the number of cases and of each outcome (:class:`Tally`), ``failures`` among them, and examples.
    """
    rng = np.random.default_rng(seed)
    tally = Tally()
    with tempfile.TemporaryDirectory(prefix="damage-") as place:
        victims = make_victims(Path(place))
        originals = {victim.name: victim.path.read_bytes() for victim in victims}
        results = {victim.name: victim.read() for victim in victims}
        ways = [(victim, way) for victim in victims for way in ways_to_damage(victim)]
        for number in range(num_cases):
            victim, way = ways[number % len(ways)]
            content = originals[victim.name]
            replace(victim.path, content)
            way.apply(victim.path, content, rng, Path(place))
            judge(victim, way, results[victim.name], tally)
            replace(victim.path, content)
    failures = sum(tally.counts[name] for name in ("tracebacks", "silent", "bad_messages", "slow"))
    outcomes = {name: tally.counts[name] for name in _OUTCOMES}
    return {
        "cases": num_cases,
        "kinds_of_files": len(victims),
        "failures": failures,
        **outcomes,
        "slowest_s": round(tally.slowest_s, 3),
        "examples": tally.examples,
    }


_OUTCOMES = ("refused", "same", "altered_values", "tracebacks", "silent", "bad_messages", "slow")


def judge(victim: Victim, way: Damage, expected: Any, tally: Tally) -> None:
    """Read a damaged file, and count the outcome."""
    case = f"{victim.name}, {way.name}"
    started = time.process_time()
    try:
        with time_limit(_GIVES_UP_S):
            found = victim.read()
    except VisualRHPError as error:
        message = str(error)
        tally.counts["refused"] += 1
        is_named = victim.path.name in message or str(victim.path.parent) in message
        if len(message) > MOST_LETTERS or not is_named or ("\n" in message and not victim.lists_faults):
            tally.failure("bad_messages", f"{case}: {len(message)} letters: {message[:300]}")
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a panic of a library in Rust is no Exception
        where = traceback.extract_tb(error.__traceback__)[-1]
        tally.failure("tracebacks", f"{case}: {type(error).__name__}: {str(error)[:200]} ({where.name}:{where.lineno})")
    else:
        if found == expected:
            tally.counts["same"] += 1
        elif way.must_fail:
            tally.failure("silent", f"{case}: accepted")
        elif victim.has_checksum and way.name in ("flip", "truncate"):
            tally.failure("silent", f"{case}: accepted with another content")
        else:
            tally.counts["altered_values"] += 1
    taken = time.process_time() - started
    tally.slowest_s = max(tally.slowest_s, taken)
    if taken > MOST_SECONDS:
        tally.failure("slow", f"{case}: {taken:.1f} s")


# ------------------------------------------------------------------------------------------------------ ways to damage
def ways_to_damage(victim: Victim) -> list[Damage]:
    """The ways that are possible for a file."""
    ways = [
        Damage("flip", flip, must_fail=False),
        Damage("flip", flip, must_fail=False),
        Damage("truncate", truncate, must_fail=False),
        Damage("empty", lambda path, *_: path.write_bytes(b""), must_fail=not victim.may_be_empty),
        Damage("garbage", lambda path, content, rng, _: path.write_bytes(rng.bytes(1 + len(content)))),
        Damage("folder", as_folder),
        Damage("loop of links", as_loop),
        Damage("dangling link", as_dangling_link),
        Damage("pipe", as_pipe),
        *(Damage(f"other content ({name})", change, must_fail=name in victim.fatal) for name, change in victim.changes),
    ]
    if os.geteuid() != 0:  # root may read everything
        ways.append(Damage("no permission", lambda path, *_: path.chmod(0)))
    return ways


def flip(path: Path, content: bytes, rng: np.random.Generator, __: Path) -> None:
    damaged = bytearray(content)
    for _ in range(int(rng.choice([1, 1, 1, 2, 8]))):
        damaged[int(rng.integers(len(damaged)))] ^= 1 << int(rng.integers(8))
    path.write_bytes(damaged)


def truncate(path: Path, content: bytes, rng: np.random.Generator, _: Path) -> None:
    path.write_bytes(content[: int(rng.integers(1, len(content)))])


def as_folder(path: Path, *_: Any) -> None:
    path.unlink()
    path.mkdir()


def as_loop(path: Path, _: bytes, __: np.random.Generator, place: Path) -> None:
    path.unlink()
    other = place / "loop"
    other.unlink(missing_ok=True)
    other.symlink_to(path)
    path.symlink_to(other)


def as_dangling_link(path: Path, _: bytes, __: np.random.Generator, place: Path) -> None:
    path.unlink()
    path.symlink_to(place / "nowhere")


def as_pipe(path: Path, *_: Any) -> None:
    path.unlink()
    os.mkfifo(path)


def replace(path: Path, content: bytes) -> None:
    """Put a new file with this content in place of whatever is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    path.write_bytes(content)


@contextlib.contextmanager
def time_limit(seconds: int) -> Iterator[None]:
    """Interrupt the block after some time: a reader that waits for a pipe would wait for ever."""

    def give_up(*_: Any) -> None:
        raise TimeoutError(f"still reading after {seconds} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
