"""The videos of the report: every method's attempt at the same scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from visualrhp.evaluation.films import Film
from visualrhp.evaluation.methods import order_methods


@dataclass(frozen=True)
class Attempt:
    """A method's attempt at a task.

    Attributes:
        scene_index: scene of the report.
        action_space: name.
        method: label.
        description: what happens, in words; why there is no film, if there is none.
        film: None if the method cannot do this task.
    """

    scene_index: int
    action_space: str
    method: str
    description: str
    film: Film | None

    @property
    def stem(self) -> str:
        """Name of the film's file without a suffix."""
        return f"scene_{self.scene_index}_{self.action_space}_{self.method.replace(' ', '_')}"


@dataclass(frozen=True)
class VideoRow:
    """The attempts in one action space."""

    title: str
    attempts: Sequence[Attempt]


@dataclass(frozen=True)
class SceneVideos:
    """One task and all attempts at it."""

    title: str
    subtitle: str
    rows: Sequence[VideoRow]


def arrange_attempts(
    attempts: Sequence[Attempt], num_objects: Mapping[int, int], action_spaces: Sequence[str], seed: int
) -> list[SceneVideos]:
    """Arrange attempts by scene and action space, methods in the order of legends.

    Args:
        attempts: in any order.
        num_objects: index of every scene -> its number of objects.
        action_spaces: one row of videos for each.
        seed: of the task instances.
    """
    methods = order_methods([attempt.method for attempt in attempts])
    ordered = sorted(attempts, key=lambda attempt: methods.index(attempt.method))
    scenes = []
    for index, m in num_objects.items():
        rows = []
        for space in action_spaces:
            own = [attempt for attempt in ordered if (attempt.scene_index, attempt.action_space) == (index, space)]
            rows.append(VideoRow(f"{space.capitalize()} actions", own))
        title = f"{m} objects" if m > 1 else "One object"
        scenes.append(SceneVideos(title, f"mixed sizes, task {index} of seed {seed}", rows))
    return scenes
