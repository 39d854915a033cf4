"""The time of a decision: measures its parts and enforces its deadline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from visualrhp.heuristics.heuristic import Guidance, Heuristic
from visualrhp.planning.planner import Timing
from visualrhp.scene.scene import Scene
from visualrhp.types import State


class Simulated(Protocol):
    """Something that can be simulated action by action."""

    def simulate(self) -> None:
        """Simulate the next action."""
        ...


class DecisionClock:
    """Measures the parts of a decision and enforces its deadline.

    No action is simulated after the deadline. The heuristic is not called if a call as long as the longest one in this
    decision would end after the deadline; only the first call is always made.

    Args:
        clock: returns the time [s].
        deadline_s: largest duration of the decision [s]; None for no limit.
    """

    def __init__(self, clock: Callable[[], float], deadline_s: float | None) -> None:
        self._clock = clock
        self._start = clock()
        self._end = None if deadline_s is None else self._start + deadline_s
        self._simulation_s = self._observation_s = self._heuristic_s = 0.0
        self._longest_call_s = 0.0

    def simulate(self, rollouts: Sequence[Simulated]) -> bool:
        """Simulate the next action of each roll-out; False if the deadline passed before the last of them."""
        start = self._clock()
        for rollout in rollouts:
            if self._end is not None and self._clock() >= self._end:
                self._simulation_s += self._clock() - start
                return False
            rollout.simulate()
        self._simulation_s += self._clock() - start
        return True

    def guide(self, heuristic: Heuristic, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        """Call the heuristic."""
        start = self._clock()
        guidance = heuristic.guide(scenes, states)
        duration = self._clock() - start
        self._longest_call_s = max(self._longest_call_s, duration)
        self._observation_s += guidance.observation_s
        self._heuristic_s += duration - guidance.observation_s
        return guidance

    def is_too_late_to_guide(self) -> bool:
        """Whether a call of the heuristic as long as the longest one would miss the deadline."""
        if self._end is None:
            return False
        now = self._clock()
        return now >= self._end or now + self._longest_call_s > self._end

    def timing(self) -> Timing:
        """The durations measured so far."""
        total_s = self._clock() - self._start
        return Timing(total_s, self._simulation_s, self._observation_s, self._heuristic_s)
