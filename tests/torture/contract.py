"""The model of an episode that the torture of the environments compares them with."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import Scene
from visualrhp.simulation import TransitionModel
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.streams import Split
from visualrhp.types import State

LIMIT = 49
"""Actions after which an episode is truncated."""

_MOST_CHARACTERS = 2000


class Surprise(Exception):
    """Something else happened than the contract says."""


class Tasks(Protocol):
    """What task instances and their models are a function of."""

    distribution: SceneDistribution
    split: Split
    action_space: ActionSpace


@dataclass
class Slot:
    """An episode: how it stands by the model."""

    scene: Scene
    state: State
    model: TransitionModel
    index: int
    seed: int = 0
    num_actions: int = 0
    reward: float = 0.0
    is_goal: bool = False
    is_dropped: bool = False

    @classmethod
    def sample(cls, tasks: Tasks, seed: int, index: int) -> Slot:
        """The start of a task instance."""
        task = sample_task_instance(tasks.distribution, seed, tasks.split, index)
        return cls(task.scene, task.state, TransitionModel(task.scene, tasks.action_space), index, seed)

    def step(self, action: Any) -> None:
        """Take a valid action; numbers of any size are clipped."""
        clipped = action if isinstance(action, int) else np.clip(action, -1.0, 1.0)
        transition = self.model.simulate(self.state, clipped)
        self.state, self.reward = transition.next_state, transition.reward
        self.is_goal, self.is_dropped = transition.is_goal, transition.is_dropped
        self.num_actions += 1

    @property
    def is_terminal(self) -> bool:
        """Goal or drop."""
        return self.is_goal or self.is_dropped

    @property
    def is_truncated(self) -> bool:
        """The limit of actions, without goal or drop."""
        return self.num_actions >= LIMIT and not self.is_terminal

    @property
    def is_over(self) -> bool:
        """Whether the last action ended the episode."""
        return self.is_terminal or self.is_truncated


def bits(array: Any) -> tuple[Any, ...]:
    """Shape, type and bytes of an array."""
    array = np.asarray(array)
    return array.shape, array.dtype, array.tobytes()


def call(
    function: Callable[[], Any], errors: type[Exception] | tuple[type[Exception], ...] = (), warns: bool = False
) -> Any:
    """Call ``function``: it has to raise one of ``errors``, if there are any, and to warn if ``warns``.

    Raises:
        Surprise: it did something else.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            result = function()
        except errors as error:
            if len(str(error)) >= _MOST_CHARACTERS:
                raise Surprise(f"the message is long: {str(error)[:300]}") from error
            result = errors
        else:
            if errors:
                raise Surprise(f"no error, and {errors} was expected")
    if any("after the end" in str(warning.message) for warning in caught) != warns:
        raise Surprise(f"a warning was {'' if warns else 'not '}due, and there were {[str(w.message) for w in caught]}")
    return result
