"""Replay of stored demonstrations in the simulator: every state and reward is compared bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.shards import Arrays, Shard, between
from visualrhp.documents import brief, shown_path
from visualrhp.errors import ActionError, ConfigError, DataError, SceneError, SimulationError
from visualrhp.scene.scene import TaskInstance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import ActionSpaceName, Episode


def replay_difference(task: TaskInstance, episode: Episode, model: TransitionModel) -> str | None:
    """The first difference when the actions are simulated from the first state: a state or reward that is not equal bit
    for bit, or a last state that is not a goal; None if the demonstration replays exactly."""
    state = task.state
    if state != episode.states[0]:
        return "state 0 is not that of the task instance"
    is_goal = False
    steps = zip(episode.actions, episode.rewards, episode.states[1:], strict=True)
    for step, (action, reward, expected) in enumerate(steps, start=1):
        try:
            transition = model.simulate(state, action)
        except (ActionError, SceneError, SimulationError) as error:
            return f"action {step} of {len(episode)} cannot be simulated: {error}"
        if transition.next_state != expected:
            distance = np.abs(transition.next_state.vector - expected.vector).max()
            return f"state {step} of {len(episode)} differs by {distance:.3g}"
        if transition.reward != reward:
            return f"reward {step} of {len(episode)} is {transition.reward:g}, not {reward:g}"
        state, is_goal = transition.next_state, transition.is_goal
    return None if is_goal else f"the last of {len(episode)} states is not a goal"


@dataclass(frozen=True)
class ReplayBlock:
    """Attempts to replay: a unit of parallel work. It holds the data, so workers on other machines need no files.

    Attributes:
        shard: name of their file.
        arrays: their part of the shard.
        physics: parameters with which they were generated.
    """

    shard: str
    arrays: Arrays = field(repr=False)
    physics: Physics = field(repr=False)


@dataclass
class ReplaySummary:
    """Result of replaying a set.

    Attributes:
        num_exact: number of demonstrations that replay exactly.
        num_transitions: number of their transitions.
        differences: (shard, index of the task instance, difference) of the others.
    """

    num_exact: int = 0
    num_transitions: int = 0
    differences: list[tuple[str, int, str]] = field(default_factory=list)

    @property
    def num_replayed(self) -> int:
        """Number of replayed demonstrations."""
        return self.num_exact + len(self.differences)

    def add(self, other: ReplaySummary) -> None:
        """Add the result of further demonstrations."""
        self.num_exact += other.num_exact
        self.num_transitions += other.num_transitions
        self.differences += other.differences


def replay(block: ReplayBlock) -> ReplaySummary:
    """Replay the demonstrations of a block."""
    shard = Shard(block.arrays)
    space: ActionSpaceName = "discrete" if block.arrays["actions"].ndim == 1 else "continuous"
    summary = ReplaySummary()
    for position in shard.demonstrations:
        episode = shard.episode(position)
        assert episode is not None  # only solved attempts have a position
        try:
            task = shard.task(position)
            model = TransitionModel(task.scene, make_action_space(space), block.physics)
            difference = replay_difference(task, episode, model)
        except SceneError as error:
            difference = f"the scene cannot be simulated: {error}"
        if difference is None:
            summary.num_exact += 1
            summary.num_transitions += len(episode)
        else:
            summary.differences.append((block.shard, int(block.arrays["index"][position]), difference))
    return summary


def replay_blocks(demonstrations: DemonstrationSet, physics: Physics, size: int = 32) -> Iterator[ReplayBlock]:
    """Divide the set into blocks of ``size`` attempts."""
    for number, shard in enumerate(demonstrations.card["shards"]):
        arrays = demonstrations.shard(number).arrays
        for start in range(0, shard["num_attempts"], size):
            part = between(arrays, start, min(start + size, shard["num_attempts"]))
            yield ReplayBlock(shard["file"], {name: np.array(array) for name, array in part.items()}, physics)


def generation_physics(demonstrations: DemonstrationSet, folder: str | Path) -> Physics:
    """The parameters of the simulator that generated the set in ``folder``, from its card.

    Raises:
        DataError: the card lacks them, or the parameters of the simulator have changed.
    """
    try:
        return Physics(**demonstrations.card["config"]["physics"])
    except (KeyError, TypeError, ConfigError) as error:
        raise DataError(
            f"the card in {shown_path(folder)} does not have the parameters of the simulator that generated the set, "
            f"or they do not match this version ({brief(error)}); generate the set again."
        ) from error
