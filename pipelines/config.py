"""What the configuration in ``conf/`` has to look like: one dataclass per pipeline and per group.

No field has a default: the values are in ``conf/``, the library's parameters have the same names there. Ranges that can
be told from one key alone are on the field; the others are in ``__post_init__`` or in the library's own checks, which
run before any work starts. Only the standard library is imported here, so that ``--help`` answers at once.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

from pipelines.decode import Count, Fraction, Index, NonNegative, Positive, Range, suggestion

ActionSpaceName = Literal["discrete", "continuous"]
RepresentationName = Literal["image", "cartesian"]
ObjectSize = Literal["small", "mixed", "large"]
NoiseLevel = Literal["none", "low", "medium", "high"]


def _error(message: str) -> Exception:
    from visualrhp.errors import ConfigError  # imported late, see above

    return ConfigError(message)


# ---------------------------------------------------------------------------------------------- keys of every pipeline
@dataclass(frozen=True)
class ActionSpaceConfig:
    """Group ``action_space``."""

    name: ActionSpaceName


@dataclass(frozen=True)
class PathsConfig:
    """Where files go; relative paths start in the current folder (the root of the repository).

    Attributes:
        outputs: root of all artefacts.
        artefact: folder that this pipeline makes.
        sweep: folder that a job of a sweep makes instead; null for one named by the job's overrides.
    """

    outputs: str
    artefact: str
    sweep: str | None


@dataclass(frozen=True)
class ExecutorConfig:
    """Group ``executor``: who does the independent tasks of a stage; results never depend on it.

    Attributes:
        name: ``loky`` (processes on this machine) or ``dask`` (a cluster).
        num_workers: tasks that are worked on at once; null takes every core. 1 works in the calling process (loky).
        address: of the scheduler of a Dask cluster.
    """

    name: Literal["loky", "dask"]
    num_workers: Count | None
    address: str | None

    def __post_init__(self) -> None:
        if self.name == "dask" and not self.address:
            raise _error("executor.address is missing: executor=dask needs the scheduler's, such as tcp://host:8786.")


@dataclass(frozen=True)
class TrackingConfig:
    """Group ``tracking``.

    Attributes:
        name: ``mlflow`` or ``none``.
        experiment: MLflow experiment that the runs belong to.
        system_metrics: whether the load of the machine is recorded, too.
    """

    name: Literal["mlflow", "none"]
    experiment: str
    system_metrics: bool


@dataclass(frozen=True)
class PipelineConfig:
    """Keys that every pipeline has.

    Attributes:
        scale: group ``scale``: all budgets; the primary files take theirs from it.
        device: where networks are trained: ``cpu``, ``cuda``, ``cuda:<n>`` or ``mps``.
    """

    scale: dict[str, Any]
    seed: Index
    action_space: ActionSpaceConfig
    device: str
    paths: PathsConfig
    executor: ExecutorConfig
    tracking: TrackingConfig

    def __post_init__(self) -> None:
        if not re.fullmatch(r"cpu|mps|cuda(:\d+)?", self.device):
            raise _error(f"device={self.device} is not known: it should be cpu, cuda, cuda:<number> or mps.")


# -------------------------------------------------------------------------------------------------------------- groups
@dataclass(frozen=True)
class SceneConfig:
    """Group ``scene``: the fields of :class:`visualrhp.scene.sampling.SceneDistribution`.

    ``num_objects`` is one number m, or the smallest and the largest.
    """

    num_objects: Count | tuple[Count, Count]
    object_size: ObjectSize
    surface_side: Positive
    target_radius: Positive
    density: Positive
    friction: Positive
    num_vertices: tuple[Count, Count]
    clearance: NonNegative
    start_distance: tuple[float, float]
    start_angle: NonNegative

    def __post_init__(self) -> None:
        if isinstance(self.num_objects, int):
            object.__setattr__(self, "num_objects", (self.num_objects, self.num_objects))


@dataclass(frozen=True)
class PhysicsConfig:
    """Group ``physics``: the fields of :class:`visualrhp.simulation.physics.Physics`."""

    time_step: Positive
    motion_steps: Count
    settle_steps: Count
    rest_speed: Positive
    iterations: Count
    grip_steps: Index
    grip_iterations: Count
    gravity: Positive
    contact_slop: NonNegative
    overlap_correction: Fraction
    joint_correction: Fraction
    gripper_density: Positive
    gripper_friction: NonNegative
    squeezing_force: Positive


@dataclass(frozen=True)
class RepresentationConfig:
    """Group ``representation``: what the network sees.

    Attributes:
        num_objects: densities with a network of their own (Cartesian; Sec. 7.5), empty for one network for all (image).
    """

    name: RepresentationName
    num_objects: tuple[Count, ...]

    def __post_init__(self) -> None:
        if self.name == "cartesian" and not self.num_objects:
            raise _error(
                "representation.num_objects is empty: the Cartesian representation needs the numbers of objects to "
                "train networks for, such as representation.num_objects=[1,4,7]."
            )
        if self.name == "image" and self.num_objects:
            raise _error(
                "representation.num_objects has to be empty, []: one image network serves every number of objects."
            )


@dataclass(frozen=True)
class LearnedHeuristicConfig:
    """A trained network; ``temperature`` is that of the softmax of Eq. 2 (discrete action space)."""

    kind: Literal["learned"]
    representation: RepresentationName
    temperature: Positive


@dataclass(frozen=True)
class CraftedHeuristicConfig:
    """Weights of :class:`visualrhp.heuristics.crafted.CostToGo` (Sec. 7.5)."""

    kind: Literal["crafted"]
    reach: NonNegative
    turn: NonNegative
    carry: NonNegative
    align: NonNegative
    face: NonNegative
    drop: NonNegative


@dataclass(frozen=True)
class RecedingHorizonConfig:
    """Algorithm 1 with n = ``num_rollouts`` and h = ``horizon``; ``name`` is what reports call it.

    Attributes:
        deadline_s: how long a decision may take [s]; null for n roll-outs, however long they take. Results with a
            deadline depend on the machine.
    """

    algorithm: Literal["receding_horizon"]
    name: str
    num_rollouts: Count
    horizon: Count
    discount: Fraction
    deadline_s: Positive | None
    heuristic: LearnedHeuristicConfig | CraftedHeuristicConfig


@dataclass(frozen=True)
class GreedyConfig:
    """The policy of a trained network without look-ahead (Sec. 7.5)."""

    algorithm: Literal["greedy"]
    name: str
    heuristic: LearnedHeuristicConfig


@dataclass(frozen=True)
class KinodynamicRRTConfig:
    """The fields of :class:`visualrhp.planning.kinodynamic_rrt.KinodynamicRRT`."""

    algorithm: Literal["kinodynamic_rrt"]
    name: str
    num_children: Count
    num_directed: Index
    direction_noise: NonNegative
    gripper_persistence: Fraction
    goal_bias: Fraction
    robot_bias: Fraction
    standoff: NonNegative
    heading_weight: NonNegative
    object_weight: NonNegative
    obstacle_weight: NonNegative
    depth_weight: NonNegative
    max_simulations: Count
    time_limit_s: Positive | None
    shorten: bool


@dataclass(frozen=True)
class ClosedLoopKRRTConfig:
    """The fields of :class:`visualrhp.planning.closed_loop_krrt.ClosedLoopKRRT`; ``name`` is what reports call it."""

    algorithm: Literal["closed_loop_krrt"]
    name: str
    rrt: KinodynamicRRTConfig
    keep_plan: bool


@dataclass(frozen=True)
class DHRRTConfig:
    """The fields of :class:`visualrhp.planning.dhrrt.DHRRT`; ``name`` is what reports call it."""

    algorithm: Literal["dhrrt"]
    name: str
    rrt: KinodynamicRRTConfig
    progress: Positive


PlannerConfig = RecedingHorizonConfig | GreedyConfig | KinodynamicRRTConfig | ClosedLoopKRRTConfig | DHRRTConfig


@dataclass(frozen=True)
class QImitationConfig:
    """Imitation in the discrete action space (Eq. 4 and 5).

    Attributes:
        margin_actions: eta, actions that mend a mistake.
        margin_cost: r_cost of each of them.
        lr_schedule: how the learning rate goes: ``constant``, or ``cosine`` to nothing at the last epoch.
        mirror: whether every sample is mirrored left to right with probability one half.
        validation_fraction: share of the demonstrations that is held out.
    """

    algorithm: Literal["q_imitation"]
    discount: Fraction
    margin_actions: Count
    margin_cost: Positive
    l2_regularization: NonNegative
    batch_size: Count
    epochs: Count
    lr: Positive
    lr_schedule: Literal["constant", "cosine"]
    mirror: bool
    validation_fraction: Fraction


@dataclass(frozen=True)
class ActorCriticImitationConfig:
    """Imitation in the continuous action space (Eq. 6); the other keys as in :class:`QImitationConfig`.

    Attributes:
        likelihood_coefficient: Upsilon.
        value_coefficient: c1.
        entropy_coefficient: c2.
        return_unit: unit of the returns in the value's squared error.
    """

    algorithm: Literal["actor_critic_imitation"]
    discount: Fraction
    likelihood_coefficient: Positive
    value_coefficient: Positive
    entropy_coefficient: NonNegative
    return_unit: Positive
    l2_regularization: NonNegative
    batch_size: Count
    epochs: Count
    lr: Positive
    lr_schedule: Literal["constant", "cosine"]
    mirror: bool
    validation_fraction: Fraction


@dataclass(frozen=True)
class DQNLearnerConfig:
    """The fields of :class:`visualrhp.learning.dqn.DQNConfig`, the environments, and RHP's parameters (Sec. 6.3.1)."""

    algorithm: Literal["dqn"]
    iterations: Count
    num_envs: Count
    buffer_size: Count
    collected: Count
    epochs: Count
    batch_size: Count
    lr: Positive
    discount: Fraction
    epsilon: Fraction
    num_rollouts: Count
    horizon: Count
    temperature: Positive
    l2_regularization: NonNegative
    target_update_interval: Count | None
    max_grad_norm: Positive | None


@dataclass(frozen=True)
class C3POLearnerConfig:
    """The fields of :class:`visualrhp.learning.c3po.C3POConfig`, and the environments (Sec. 6.3.2)."""

    algorithm: Literal["c3po"]
    iterations: Count
    num_envs: Count
    buffer_size: Count
    batch_size: Count
    baseline_epochs: Count
    policy_epochs: Count
    baseline_step: bool
    lr: Positive
    discount: Fraction
    clip_epsilon: Positive
    value_coefficient: Positive
    entropy_coefficient: NonNegative
    baseline_value_coefficient: Positive
    trace_decay: Fraction
    normalize_advantage: bool
    max_grad_norm: Positive | None


@dataclass(frozen=True)
class ValidationConfig:
    """Greedy evaluation during a training, on task instances of its own.

    Attributes:
        num_instances: task instances, the same every time; 0 for no evaluation.
        every: epochs or iterations between evaluations.
    """

    num_instances: Index
    every: Count


# ----------------------------------------------------------------------------------------------------------- pipelines
@dataclass(frozen=True)
class VideoConfig:
    """The video that a stage makes of its result.

    Attributes:
        num_scenes: task instances that are filmed, one after another; 0 for no video.
        size_px: width.
    """

    num_scenes: Index
    size_px: Count


@dataclass(frozen=True)
class DemonstrationsConfig:
    """Attributes: ``count`` demonstrations, of which ``shard_size`` go into one file."""

    count: Count
    shard_size: Count


@dataclass(frozen=True)
class GenerateDemosConfig(PipelineConfig):
    """``python -m pipelines.generate_demos``."""

    scene: SceneConfig
    physics: PhysicsConfig
    planner: KinodynamicRRTConfig
    demonstrations: DemonstrationsConfig
    video: VideoConfig


@dataclass(frozen=True)
class VerifyDemosConfig(PipelineConfig):
    """``python -m pipelines.verify_demos``. Attributes: ``demonstrations``, the folder of the set."""

    demonstrations: str


@dataclass(frozen=True)
class ExportDemosConfig(PipelineConfig):
    """``python -m pipelines.export_demos``.

    Attributes:
        demonstrations: folder of the set.
        format: ``parquet`` or ``minari``.
        observation: what the Minari data set shows of a state: ``image``, or ``cartesian`` features.
        num_objects: density whose demonstrations are exported; null for all (Cartesian features need one).
        dataset_id: what Minari calls the data set.
    """

    demonstrations: str
    format: Literal["parquet", "minari"]
    observation: RepresentationName
    num_objects: Count | None
    dataset_id: str

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.format == "minari" and self.observation == "cartesian" and self.num_objects is None:
            raise _error("num_objects is missing: Cartesian features need one density, such as num_objects=4.")


@dataclass(frozen=True)
class TrainILConfig(PipelineConfig):
    """``python -m pipelines.train_il``.

    Attributes:
        demonstrations: folder with the demonstrations to imitate.
        max_demonstrations: how many of them are used (Fig. 5); null for all.
    """

    scene: SceneConfig
    physics: PhysicsConfig
    representation: RepresentationConfig
    learner: QImitationConfig | ActorCriticImitationConfig
    validation: ValidationConfig
    video: VideoConfig
    demonstrations: str
    max_demonstrations: Count | None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_learner(self.learner.algorithm, self.action_space.name)


@dataclass(frozen=True)
class TrainRLConfig(PipelineConfig):
    """``python -m pipelines.train_rl``.

    Attributes:
        heuristic: folder with the networks to start from, made by ``train_il``.
        demonstrations: folder with the demonstrations that the replay buffer starts with (discrete).
    """

    scene: SceneConfig
    physics: PhysicsConfig
    representation: RepresentationConfig
    learner: DQNLearnerConfig | C3POLearnerConfig
    validation: ValidationConfig
    video: VideoConfig
    heuristic: str
    demonstrations: str

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_learner(self.learner.algorithm, self.action_space.name)


@dataclass(frozen=True)
class EvaluateConfig(PipelineConfig):
    """``python -m pipelines.evaluate``: one planner in one setting, or a ``suite`` of them.

    Attributes:
        noise_level: how wrong the planner's model of shapes, friction and density is (Sec. 8.2).
        num_episodes: task instances, the same for every planner.
        heuristics: folder with the trained networks, ``<action space>/<representation>/heuristic*.safetensors``.
        suite: blocks of settings by name: a key of the configuration -> the values it takes; every combination of a
            block is evaluated. Null for the one setting that the other keys describe.
    """

    scene: SceneConfig
    physics: PhysicsConfig
    planner: PlannerConfig
    noise_level: NoiseLevel
    num_episodes: Count
    heuristics: str
    suite: dict[str, dict[str, Any]] | None


@dataclass(frozen=True)
class VideosConfig:
    """Videos of the methods on the same scenes.

    Attributes:
        planners: files of the group ``planner``.
        action_spaces: in which each of them is filmed.
        num_scenes: scenes.
        num_objects: m of these scenes, taken in turn.
        fps: frames a second.
        size_px: width and height.
    """

    planners: tuple[str, ...]
    action_spaces: tuple[ActionSpaceName, ...]
    num_scenes: Index
    num_objects: tuple[Count, ...]
    fps: Count
    size_px: Count


@dataclass(frozen=True)
class SweepsConfig:
    """Folders made by the sweeps behind figures, null to leave a figure out.

    Attributes:
        demonstrations: of ``experiment=fig5_evaluation``.
        stability: of ``experiment=fig6``.
    """

    demonstrations: str | None
    stability: str | None


@dataclass(frozen=True)
class ReportConfig(PipelineConfig):
    """``python -m pipelines.report``.

    Attributes:
        title: of the page.
        evaluation: folder made by ``evaluate``.
        heuristics: folder with the trained networks, for the videos.
        training: folders with the training curves to show, made by ``train_il`` and ``train_rl``; those of other
            pipelines are passed over.
    """

    title: str
    evaluation: str
    heuristics: str
    training: tuple[str, ...]
    sweeps: SweepsConfig
    videos: VideosConfig


@dataclass(frozen=True)
class PlayVideoConfig:
    """What is seen of an episode.

    Attributes:
        size_px: height and width of the picture of the scene, from 64.
        fps: frames a second.
        action_s: how long the motion of an action takes [s].
        imagined_s: how long the roll-outs of a planner are shown before each action [s]; 0 leaves them out.
        hold_s: how long the end is shown [s].
        observation: where the abstract label image goes: ``none``, ``panel`` (beside the picture) or ``inset`` (in it).
    """

    size_px: Annotated[int, Range(at_least=64, at_most=4096)]
    fps: Annotated[int, Range(at_least=1, at_most=120)]
    action_s: Positive
    imagined_s: NonNegative
    hold_s: NonNegative
    observation: Literal["none", "panel", "inset"]


@dataclass(frozen=True)
class PlayConfig(PipelineConfig):
    """``python -m pipelines.play``: one planner on one task, to look at.

    Attributes:
        index: of the task instance; those of an evaluation with the same seed and scene.
        scene_file: a scene to play instead of a sampled one (``scene`` is not read then); null to sample.
        noise_level: how wrong the planner's model of shapes, friction and density is (Sec. 8.2).
        heuristics: folder with the trained networks, ``<action space>/<representation>/heuristic*.safetensors``.
        live: whether the episode is shown in a window, too: ``auto`` for where there is a screen.
    """

    scene: SceneConfig
    physics: PhysicsConfig
    planner: PlannerConfig
    index: Index
    scene_file: str | None
    noise_level: NoiseLevel
    heuristics: str
    video: PlayVideoConfig
    live: Literal["auto", True, False]


@dataclass(frozen=True)
class SearchConfig:
    """The search for weights of the handcrafted heuristic.

    Attributes:
        num_trials: sets of weights that are tried, the first of them those of the planner.
        num_random_trials: of which are drawn at random before the model of the objective proposes.
        num_instances: task instances of a trial, per action space.
        block: instances between two looks of the pruner.
        action_cost: share of a success that a full episode of actions costs.
        ranges: smallest and largest value of every weight that is searched.
    """

    num_trials: Count
    num_random_trials: Count
    num_instances: Count
    block: Count
    action_cost: NonNegative
    ranges: dict[str, tuple[Positive, Positive]]

    def __post_init__(self) -> None:
        weights = [item.name for item in fields(CraftedHeuristicConfig) if item.name != "kind"]
        if not self.ranges:
            raise _error("search.ranges is empty: no weight would be searched.")
        for name, (low, high) in self.ranges.items():
            if name not in weights:
                raise _error(f"search.ranges.{name} is no weight. {suggestion(name, weights)}")
            if not low < high:
                raise _error(f"search.ranges.{name}=[{low:g}, {high:g}]: the smaller bound comes first.")


@dataclass(frozen=True)
class SelectionConfig:
    """Attributes: the ``num_finalists`` best trials, and the first, are compared on ``num_instances`` others."""

    num_finalists: Count
    num_instances: Count


@dataclass(frozen=True)
class CheckConfig:
    """Attributes: the best and the first weights are compared on ``num_instances`` further task instances."""

    num_instances: Count


@dataclass(frozen=True)
class TuneCraftedConfig(PipelineConfig):
    """``python -m pipelines.tune_crafted``.

    Attributes:
        action_spaces: in which every trial is run; the weights are one set for all of them.
    """

    scene: SceneConfig
    physics: PhysicsConfig
    planner: PlannerConfig
    action_spaces: tuple[ActionSpaceName, ...]
    search: SearchConfig
    selection: SelectionConfig
    check: CheckConfig

    def __post_init__(self) -> None:
        super().__post_init__()
        heuristic = getattr(self.planner, "heuristic", None)
        if not isinstance(self.planner, RecedingHorizonConfig) or not isinstance(heuristic, CraftedHeuristicConfig):
            raise _error(
                f"planner.name={self.planner.name} has no handcrafted heuristic whose weights could be searched: "
                "choose planner=crafted_heuristic_rhp."
            )
        if self.planner.deadline_s is not None:
            raise _error(
                f"planner.deadline_s={self.planner.deadline_s:g}: trials cannot be compared where the speed of the "
                "machine counts; it has to be null."
            )
        if not self.action_spaces or len(set(self.action_spaces)) < len(self.action_spaces):
            raise _error(
                f"action_spaces={list(self.action_spaces)} should name one action space or several different ones."
            )
        for name, (low, high) in self.search.ranges.items():
            start = getattr(heuristic, name)
            if not low <= start <= high:
                raise _error(
                    f"planner.heuristic.{name}={start:g}, the first to be tried, is not in search.ranges.{name}="
                    f"[{low:g}, {high:g}]."
                )


def _check_learner(algorithm: str, action_space: str) -> None:
    needed = {"q_imitation": "discrete", "dqn": "discrete"}.get(algorithm, "continuous")
    if needed != action_space:
        raise _error(
            f"learner.algorithm={algorithm} learns in the {needed} action space, but action_space={action_space}; "
            f"leave the learner out to get the one that fits, or say action_space={needed}."
        )


def suite_overrides(suite: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Overrides of every setting of a suite, in order: the product of the values within each block.

    A value that is a list stands for alternatives; a value that is itself a list is written [[1, 7]].

    >>> suite_overrides({"sizes": {"planner": ["greedy"], "scene.num_objects": [[1, 7]], "seed": [0, 1]}})
    [['planner=greedy', 'scene.num_objects=[1,7]', 'seed=0'], ['planner=greedy', 'scene.num_objects=[1,7]', 'seed=1']]
    """
    points: list[list[str]] = []
    for block in suite.values():
        alternatives = [
            [f"{key}={_override_value(value)}" for value in (values if isinstance(values, list | tuple) else [values])]
            for key, values in block.items()
        ]
        points += [list(combination) for combination in itertools.product(*alternatives)]
    return points


def _override_value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{','.join(_override_value(item) for item in value)}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(value)
