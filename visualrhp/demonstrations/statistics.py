"""Statistics of the attempts behind a demonstration set."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import numpy.typing as npt

from visualrhp.demonstrations.shards import Arrays
from visualrhp.types import IntArray


class AttemptStatistics:
    """Statistics of the attempts that make up a set."""

    def __init__(self) -> None:
        self._parts: list[Arrays] = []

    def add(self, arrays: Arrays, num_missing: int) -> None:
        """Add the attempts of a block, up to the one that completes the set."""
        needed = int(np.searchsorted(np.cumsum(arrays["solved"]), num_missing)) + 1
        names = ("solved", "length", "num_objects", "num_simulated", "num_nodes", "search_time_s")
        self._parts.append({name: arrays[name][:needed] for name in names})

    def _all(self, name: str) -> npt.NDArray[Any]:
        return np.concatenate([part[name] for part in self._parts])

    def lengths(self) -> IntArray:
        """[D] actions of each demonstration."""
        return self._all("length")[self._all("solved")]

    def metrics(self) -> dict[str, float | int]:
        """Counts and means that depend only on configuration and seed."""
        solved, simulated, lengths = self._all("solved"), self._all("num_simulated"), self.lengths()
        num_objects = self._all("num_objects")
        return {
            "demonstrations": int(solved.sum()),
            "attempts": len(solved),
            "failures": int((~solved).sum()),
            "solved_rate": float(solved.mean()),
            "transitions": int(lengths.sum()),
            "actions_mean": float(lengths.mean()),
            "actions_median": float(np.median(lengths)),
            "actions_max": int(lengths.max()),
            "action_efficiency": float((num_objects[solved] / np.maximum(lengths, 1)).mean()),
            "simulated_mean": float(simulated.mean()),
            "simulated_median": float(np.median(simulated)),
            "simulated_p95": float(np.percentile(simulated, 95)),
        }

    def timings(self) -> dict[str, float]:
        """Wall-clock times of a search [s]."""
        times = self._all("search_time_s")
        return {
            "search_time_mean_s": float(times.mean()),
            "search_time_median_s": float(np.median(times)),
            "search_time_p95_s": float(np.percentile(times, 95)),
            "search_time_total_s": float(times.sum()),
        }

    def length_table(self) -> str:
        """CSV: histogram of the number of actions, by number of objects."""
        solved = self._all("solved")
        counts = Counter(zip(self._all("num_objects")[solved].tolist(), self.lengths().tolist(), strict=True))
        rows = [f"{m},{length},{number}" for (m, length), number in sorted(counts.items())]
        return "\n".join(["num_objects,actions,demonstrations", *rows]) + "\n"
