"""The card of an evaluation (``evaluation.json``): what is read of it."""

from __future__ import annotations

from typing import Any, Final

from visualrhp.documents import FileKind, document
from visualrhp.parameters import Count, Index, NonNegative
from visualrhp.scene.noise import NoiseLevel
from visualrhp.types import ActionSpaceName, ObjectSize

EVALUATION_CARD: Final = FileKind(
    "the card of an evaluation (a JSON file)", "make the evaluation again with python -m pipelines.evaluate"
)


@document
class EvaluatedPoint:
    """A setting on the card: the attributes of :class:`visualrhp.evaluation.episodes.Setting` and its episodes."""

    experiment: str
    planner: str
    action_space: ActionSpaceName
    num_rollouts: Index | None
    horizon: Index | None
    scene_num_objects: str
    object_size: ObjectSize
    layout: str
    noise_level: NoiseLevel
    seed: int
    num_episodes: Index
    num_skipped: Index


@document
class EvaluationCard:
    """What is read of the card of an evaluation."""

    scale: str
    seed: int
    commit: str | None
    versions: dict[str, str | None]
    config: dict[str, Any]
    points: tuple[EvaluatedPoint, ...]
    networks: dict[str, str]
    num_episodes: Index
    wall_time_s: NonNegative
    num_workers: Count | None
    machine: str
    date: str

    def __post_init__(self) -> None:
        if (total := sum(point.num_episodes for point in self.points)) != self.num_episodes:
            raise ValueError(f"num_episodes={self.num_episodes}, but its points have {total}")
