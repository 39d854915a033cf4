"""The configuration of each pipeline."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pipelines.config.common import PipelineConfig, Seed
from pipelines.config.groups import (
    ActorCriticImitationLearnerConfig,
    C3POLearnerConfig,
    DQNLearnerConfig,
    ExpertIterationLearnerConfig,
    KinodynamicRRTConfig,
    ObservationConfig,
    PlannerConfig,
    QImitationLearnerConfig,
    RecedingHorizonConfig,
    RoundValidationConfig,
    ValidationConfig,
    VideoConfig,
)
from visualrhp.evaluation.weight_search import CheckConfig, SearchConfig, SelectionConfig
from visualrhp.observation import observation_class
from visualrhp.parameters import Count, Field, Index, NonNegative, Positive, parameters
from visualrhp.scene.noise import NoiseLevel
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.simulation.physics import Physics
from visualrhp.types import ActionSpaceName


def check_name(planner: PlannerConfig) -> None:
    """Check that tables and titles can show the name of a planner."""
    if not planner.name.strip() or not planner.name.isprintable():
        raise ValueError(
            f"planner.name={planner.name!r:.80} cannot be shown in tables; it should have letters, and no line breaks."
        )


@parameters
class DemonstrationsConfig:
    """Attributes: ``count``, the number of demonstrations, and ``shard_size``, their number per file."""

    count: Count
    shard_size: Count


@parameters
class GenerateDemosConfig(PipelineConfig):
    """``python -m pipelines.generate_demos``."""

    scene: SceneDistribution
    physics: Physics
    planner: KinodynamicRRTConfig
    demonstrations: DemonstrationsConfig
    video: VideoConfig


@parameters
class VerifyDemosConfig(PipelineConfig):
    """``python -m pipelines.verify_demos``. Attributes: ``demonstrations``, the folder of the set."""

    demonstrations: str


@parameters
class ExportDemosConfig(PipelineConfig):
    """``python -m pipelines.export_demos``.

    Attributes:
        demonstrations: folder of the set.
        format: ``parquet`` or ``minari``.
        observation: of the Minari data set.
        num_objects: number of objects whose demonstrations are exported; null for all (Cartesian features need one).
        dataset_id: name of the Minari data set.
    """

    demonstrations: str
    format: Literal["parquet", "minari"]
    observation: ObservationConfig
    num_objects: Count | None
    dataset_id: str

    def __post_init__(self) -> None:
        super().__post_init__()
        is_fixed = observation_class(self.observation.name).fixes_num_objects
        if self.format == "minari" and is_fixed and self.num_objects is None:
            raise ValueError(
                f"num_objects is missing: {self.observation.name.capitalize()} features need one number of objects, "
                "such as num_objects=4."
            )
        if not re.fullmatch(r"([\w-]+/)*[\w-]+-v\d+", self.dataset_id, flags=re.ASCII) or len(self.dataset_id) > 120:
            raise ValueError(
                f"dataset_id={self.dataset_id} is not a name of a Minari data set: it should be like clutter/demos-v0, "
                "of letters, digits, dashes and underscores, and end with a version."
            )


@parameters
class TrainILConfig(PipelineConfig):
    """``python -m pipelines.train_il``.

    Attributes:
        demonstrations: folder with the demonstrations to imitate.
        max_demonstrations: number of demonstrations to use (Fig. 5); null for all.
    """

    scene: SceneDistribution
    physics: Physics
    observation: ObservationConfig
    learner: Annotated[QImitationLearnerConfig | ActorCriticImitationLearnerConfig, Field(discriminator="algorithm")]
    validation: ValidationConfig
    video: VideoConfig
    demonstrations: str
    max_demonstrations: Count | None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_learner(self.learner.algorithm, self.action_space.name)


@parameters
class TrainRLConfig(PipelineConfig):
    """``python -m pipelines.train_rl``.

    Attributes:
        heuristic: folder with the initial networks, made by ``train_il``.
        demonstrations: folder with the initial demonstrations of the replay buffer (discrete).
    """

    scene: SceneDistribution
    physics: Physics
    observation: ObservationConfig
    learner: Annotated[DQNLearnerConfig | C3POLearnerConfig, Field(discriminator="algorithm")]
    validation: ValidationConfig
    video: VideoConfig
    heuristic: str
    demonstrations: str

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_learner(self.learner.algorithm, self.action_space.name)


@parameters
class ExpertIterationConfig(PipelineConfig):
    """``python -m pipelines.expert_iteration``.

    Attributes:
        planner: the expert, guided by the network in training (``planner.heuristic`` gives its temperature).
        heuristic: folder with the initial networks.
    """

    scene: SceneDistribution
    physics: Physics
    planner: RecedingHorizonConfig
    observation: ObservationConfig
    learner: ExpertIterationLearnerConfig
    validation: RoundValidationConfig
    video: VideoConfig
    heuristic: str

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_learner(self.learner.imitation.algorithm, self.action_space.name)
        if self.planner.deadline_s is not None:
            raise ValueError(
                f"planner.deadline_s={self.planner.deadline_s:g}: the result would depend on the speed of the machine; "
                "it must be null."
            )


@parameters
class EvaluateConfig(PipelineConfig):
    """``python -m pipelines.evaluate``: one planner in one setting, or a ``suite`` of them.

    Attributes:
        noise_level: of shapes, friction and density in the world (Sec. 8.2).
        num_episodes: number of task instances, the same for every planner.
        heuristics: folder with the networks of all planners (see :class:`LearnedHeuristicConfig`); null for those of
            the planner.
        suite: blocks of settings by name: a key of the configuration -> its values; every combination of a block is
            evaluated. Null for the single setting of the other keys.
        reuse: whether episodes that were run before with the same configuration, code and networks are not run again.
    """

    scene: SceneDistribution
    physics: Physics
    planner: PlannerConfig
    noise_level: NoiseLevel
    num_episodes: Count
    heuristics: str | None
    suite: dict[str, dict[str, Any]] | None
    reuse: bool

    def __post_init__(self) -> None:
        super().__post_init__()
        check_name(self.planner)


@parameters
class VideosConfig:
    """Videos of the methods on the same scenes.

    Attributes:
        planners: files of the group ``planner``.
        action_spaces: action spaces in which each planner is filmed.
        num_scenes: number of scenes.
        num_objects: m of these scenes, repeated cyclically.
        fps: frames per second.
        size_px: width and height.
    """

    planners: tuple[str, ...]
    action_spaces: tuple[ActionSpaceName, ...]
    num_scenes: Index
    num_objects: tuple[Count, ...]
    fps: Count
    size_px: Count


@parameters
class SweepsConfig:
    """Folders of the sweeps for figures; null omits a figure.

    Attributes:
        demonstrations: of ``experiment=fig5_evaluation``.
        stability: of ``experiment=fig6``.
    """

    demonstrations: str | None
    stability: str | None


@parameters
class ReportConfig(PipelineConfig):
    """``python -m pipelines.report``.

    Attributes:
        title: of the page.
        evaluation: folder made by ``evaluate``.
        heuristics: as in evaluate, for the videos.
        training: folders with the training curves to show, made by ``train_il`` and ``train_rl``; others are
            ignored.
    """

    title: str
    evaluation: str
    heuristics: str | None
    training: tuple[str, ...]
    sweeps: SweepsConfig
    videos: VideosConfig

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [Path(folder).absolute().name for folder in self.training]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(
                f"training={list(self.training)} has several folders called {twice[0]}, whose figures would have one "
                "name; it should have one of each name."
            )


@parameters
class ReportAblationConfig(PipelineConfig):
    """``python -m pipelines.report_ablation``.

    Attributes:
        evaluation: folder made by ``evaluate``.
        fps: frames per second of the films.
        size_px: their width and height.
    """

    evaluation: str
    fps: Count
    size_px: Count


@parameters
class PlayVideoConfig:
    """Appearance of the video of an episode.

    Attributes:
        size_px: height and width of the picture of the scene, at least 64.
        fps: frames per second.
        action_s: duration of the commanded motion of an action [s]; 0.5 is real time (see ``physics``). The time until
            the world is at rest comes in addition.
        imagined_s: duration of the roll-outs before each action [s]; 0 for no roll-outs.
        hold_s: duration of the end [s].
        label_image: position of the abstract label image: ``none``, ``panel`` (next to the picture) or ``inset`` (in
            it).
    """

    size_px: Annotated[int, Field(ge=64, le=4096)]
    fps: Annotated[int, Field(ge=1, le=120)]
    action_s: Positive
    imagined_s: NonNegative
    hold_s: NonNegative
    label_image: Literal["none", "panel", "inset"]


@parameters
class PlayConfig(PipelineConfig):
    """``python -m pipelines.play``: one planner on one task, to watch.

    Attributes:
        index: of the task instance; the same as in an evaluation with the same seed and scene.
        scene_file: a scene to play instead of a sampled one (``scene`` is ignored then); null to sample.
        noise_level: of shapes, friction and density in the world (Sec. 8.2).
        heuristics: folder with the networks of all planners (see :class:`LearnedHeuristicConfig`); null for those of
            the planner.
        live: whether to show the episode in a window; ``auto``: if there is a screen.
    """

    scene: SceneDistribution
    physics: Physics
    planner: PlannerConfig
    index: Seed
    scene_file: str | None
    noise_level: NoiseLevel
    heuristics: str | None
    video: PlayVideoConfig
    live: Literal["auto", True, False]

    def __post_init__(self) -> None:
        super().__post_init__()
        check_name(self.planner)


@parameters
class TuneCraftedConfig(PipelineConfig):
    """``python -m pipelines.tune_crafted``.

    Attributes:
        action_spaces: action spaces in which every trial is run, with the same weights.
    """

    scene: SceneDistribution
    physics: Physics
    planner: PlannerConfig
    action_spaces: tuple[ActionSpaceName, ...]
    search: SearchConfig
    selection: SelectionConfig
    check: CheckConfig

    def __post_init__(self) -> None:
        super().__post_init__()
        planner = self.planner
        if planner.algorithm != "receding_horizon" or planner.heuristic.kind != "crafted":
            raise ValueError(
                f"planner.name={planner.name} has no handcrafted heuristic, whose weights are searched: "
                "choose planner=crafted_heuristic_rhp."
            )
        if planner.deadline_s is not None:
            raise ValueError(
                f"planner.deadline_s={planner.deadline_s:g}: trials cannot be compared if they depend on the speed "
                "of the machine; it must be null."
            )
        if not self.action_spaces or len(set(self.action_spaces)) < len(self.action_spaces):
            raise ValueError(
                f"action_spaces={list(self.action_spaces)} should name one action space or several different ones."
            )
        for name, (low, high) in self.search.ranges.items():
            start = getattr(planner.heuristic, name)
            if not low <= start <= high:
                raise ValueError(
                    f"planner.heuristic.{name}={start:g}, the first weight, is not in search.ranges.{name}="
                    f"[{low:g}, {high:g}]."
                )


def _check_learner(algorithm: str, action_space: str) -> None:
    needed = {"q_imitation": "discrete", "dqn": "discrete"}.get(algorithm, "continuous")
    if needed != action_space:
        raise ValueError(
            f"learner.algorithm={algorithm} learns in the {needed} action space, but action_space={action_space}; "
            f"remove the override of the learner, or set action_space={needed}."
        )
