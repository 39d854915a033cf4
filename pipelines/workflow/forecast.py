"""How long the remaining tasks of a stage will take."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping


class Forecast:
    """The time that remains, where tasks of some kinds take much longer than those of others.

    The cost of a kind is the mean of its finished tasks; a kind without any costs as much as the mean of the others.

    Args:
        counts: number of tasks of each kind.
    """

    def __init__(self, counts: Mapping[str, int]) -> None:
        self._remaining = Counter(counts)
        self._costs: dict[str, list[float]] = defaultdict(list)

    def finished(self, kind: str, cost: float) -> None:
        """A task is finished; ``cost`` is in any unit, such as the seconds that it took on its worker."""
        self._remaining[kind] -= 1
        self._costs[kind].append(cost)

    def remaining_s(self, elapsed_s: float) -> float:
        """Time for the remaining tasks, from that for the finished ones; NaN before any is finished."""
        spent = sum(map(sum, self._costs.values()))
        if not self._costs or not spent:
            return math.nan
        known = {kind: _mean(costs) for kind, costs in self._costs.items()}
        default = _mean(known.values())
        cost = sum(count * known.get(kind, default) for kind, count in self._remaining.items())
        return elapsed_s * cost / spent


def _mean(values: Iterable[float]) -> float:
    numbers = list(values)
    return sum(numbers) / len(numbers)
