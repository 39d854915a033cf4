"""A plan that is being followed, action by action."""

from __future__ import annotations

from collections.abc import Sequence

from visualrhp.planning.planner import Decision, Rollout
from visualrhp.types import Action, Episode, State


class Plan:
    """What is still to be done of a plan, and what was foreseen of it.

    Args:
        episode: the plan as it was simulated; None for no plan.
    """

    def __init__(self, episode: Episode | None = None) -> None:
        self._episode = episode
        self._num_done = 0

    @property
    def actions(self) -> Sequence[Action]:
        """The actions that are left."""
        return self._episode.actions[self._num_done :] if self._episode else ()

    def foresees(self, state: State) -> bool:
        """Whether ``state`` is, to the bit, the one in which the next action was to be taken."""
        return bool(self.actions) and self._episode is not None and self._episode.states[self._num_done] == state

    def follow(self) -> Decision:
        """The next action; None once nothing is left.

        The decision holds one roll-out, what is left of the plan as it was foreseen. Its states begin with the one that
        the plan expected to be in now, which in a world that departs from the model is not the current one.
        """
        if self._episode is None or not self.actions:
            return Decision(action=None)
        rest = slice(self._num_done, None)
        rollout = Rollout.of(self._episode.actions[rest], self._episode.states[rest], self._episode.rewards[rest])
        self._num_done += 1
        return Decision(rollout.actions[0], (rollout,))
