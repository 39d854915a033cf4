"""Two things timed side by side, and the table they are printed in."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

Stopwatch = Callable[[], float]
"""Does its work once and says how long the part that counts took [s]."""

_WIDTH = 58


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        repetitions: of everything that is timed.
        motions: different (state, motion) pairs that a figure of the simulation is the mean of.
        seconds: how long a peer's environment is stepped at a time.
        instances: task instances per number of objects for K.RRT and Box2D.
        time_limit_s: after which a search counts as unsolved; the paper's is 180 s (Sec. 7.5).
    """

    repetitions: int = 15
    motions: int = 50
    seconds: float = 0.5
    instances: int = 10
    time_limit_s: float = 180.0


FULL = Effort()
QUICK = Effort(repetitions=1, motions=4, seconds=0.05, instances=1, time_limit_s=2.0)


class Ratio(NamedTuple):
    """Ours over the reference: the median over the repetitions, and that of the least times."""

    median: float
    least: float

    @classmethod
    def of(cls, ours: np.ndarray, reference: np.ndarray) -> Ratio:
        return cls(float(np.median(ours / reference)), float(ours.min() / reference.min()))


def timed(function: Callable[[], object], calls: int = 1, clock: Callable[[], float] = time.process_time) -> Stopwatch:
    """A stopwatch of one call of ``function``, the mean of ``calls``.

    By default it counts the processor's time: with one thread that is what the call takes on an idle machine.
    """

    def stopwatch() -> float:
        start = clock()
        for _ in range(calls):
            function()
        return (clock() - start) / calls

    return stopwatch


def side_by_side(stopwatches: Sequence[Stopwatch], repetitions: int) -> list[np.ndarray]:
    """Times [repetitions] of each stopwatch: taken in turn, so that other work on the machine disturbs all alike."""
    for stopwatch in stopwatches:
        stopwatch()  # caches fill
    times = np.array([[stopwatch() for stopwatch in stopwatches] for _ in range(repetitions)])
    return list(times.T)


def readable(seconds: float) -> str:
    """A duration in the unit that suits it."""
    for unit, size in (("us", 1e-6), ("ms", 1e-3)):
        if abs(seconds) < 1000.0 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.2f} s"


def show_title(title: str) -> None:
    """Head of a table of :func:`show`."""
    print(f"\n{title}\n{'':<{_WIDTH}} {'ours':>10} {'reference':>10} {'median':>8} {'least':>8}", flush=True)


def show(what: str, ours: np.ndarray, reference: np.ndarray, name: str) -> None:
    """One row: median times, their ratio, and what the reference is."""
    ratio = Ratio.of(ours, reference)
    print(
        f"{what:<{_WIDTH}} {readable(float(np.median(ours))):>10} {readable(float(np.median(reference))):>10} "
        f"{ratio.median:8.2f} {ratio.least:8.2f}  of {name}",
        flush=True,
    )


def show_time(what: str, ours: np.ndarray) -> None:
    """One row without a reference."""
    print(f"{what:<{_WIDTH}} {readable(float(np.median(ours))):>10}", flush=True)


def compare(what: str, ours: Stopwatch, reference: Stopwatch, name: str, repetitions: int) -> None:
    """Measure two stopwatches side by side and show the row."""
    times = side_by_side((ours, reference), repetitions)
    show(what, times[0], times[1], name)


def numbered(count: int, noun: str) -> str:
    """``1 object``, ``4 objects``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
