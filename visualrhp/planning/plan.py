"""A plan that is being followed, action by action."""

from __future__ import annotations

from collections.abc import Sequence

from visualrhp.planning.planner import Decision, Rollout
from visualrhp.types import Action, Episode, State


class Plan:
    """The remaining actions of a plan, and its predicted states.

    Args:
        episode: the plan as it was simulated; None for no plan.
    """

    def __init__(self, episode: Episode | None = None) -> None:
        self._episode = episode
        self._num_done = 0

    @property
    def actions(self) -> Sequence[Action]:
        """The remaining actions."""
        return self._episode.actions[self._num_done :] if self._episode else ()

    def predicts(self, state: State) -> bool:
        """Whether ``state`` equals the predicted state for the next action, bit for bit."""
        return bool(self.actions) and self._episode is not None and self._episode.states[self._num_done] == state

    def follow(self) -> Decision:
        """Return a decision with the next action; with None at the end of the plan.

        The decision holds one roll-out, the rest of the plan as predicted. Its first state is the predicted current
        state, which differs from the actual one if the world differs from the model.
        """
        if self._episode is None or not self.actions:
            return Decision(action=None)
        rest = slice(self._num_done, None)
        parts = self._episode.actions[rest], self._episode.states[rest], self._episode.rewards[rest]
        rollout = Rollout.of(*parts, origin="plan")
        self._num_done += 1
        return Decision(rollout.actions[0], (rollout,), chosen=0)
