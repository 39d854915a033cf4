"""One episode of a robot, in a simulated or a real cell, with the latency of every part."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

if TYPE_CHECKING:
    from pipelines.config import EvaluateExecutionConfig, ExecutionVideoConfig, RobotConfig
    from pipelines.robots import Robot
    from visualrhp.embodiment.dry_run import DryRunWorld, PlannedMotion
    from visualrhp.embodiment.film import FilmedCell, FilmRecorder
    from visualrhp.embodiment.looking import SeenScene
    from visualrhp.embodiment.planar_world import PlanarWorld
    from visualrhp.embodiment.robot_world import RobotWorld
    from visualrhp.execution import EpisodeResult
    from visualrhp.rendering.video import Frame


@dataclass(frozen=True)
class RobotEpisode:
    """An episode, and what was measured.

    Attributes:
        result: of the episode.
        actions: times of every action (:class:`visualrhp.embodiment.looking.StepLatency`), with ``decision_s``.
        true_end: what is true at the end, in a simulated cell (:meth:`pipelines.robots.Robot.true_end`).
        motions: of a dry run.
        wall_time_s: of the episode.
        cell_time_s: the same on the clock of the cell.
        frames: of the video, if one was asked for.
    """

    result: EpisodeResult
    actions: list[dict[str, Any]]
    true_end: dict[str, Any] | None
    motions: tuple[PlannedMotion, ...]
    wall_time_s: float
    cell_time_s: float
    frames: Iterable[Frame] = ()

    @property
    def latency_summary(self) -> dict[str, float]:
        """Mean time of each part [s], and of perception (one image) and decision together also the largest."""
        steps = [step for step in self.actions if "decision_s" in step and step["num_looks"]]
        if not steps:
            return {}
        perception = [step["perception_s"] / step["num_looks"] for step in steps]
        decision = [step["decision_s"] for step in steps]
        both = np.add(perception, decision)
        return {
            "mean_perception_s": float(np.mean(perception)),
            "mean_decision_s": float(np.mean(decision)),
            "mean_perception_and_decision_s": float(both.mean()),
            "max_perception_and_decision_s": float(both.max()),
            "mean_model_s": float(np.mean([step["model_s"] for step in steps])),
            "mean_path_s": float(np.mean([step["path_s"] for step in steps])),
            "mean_looks": float(np.mean([step["num_looks"] for step in steps])),
        }


def run_robot(
    config: RobotConfig, index: int, *, dry_run: bool = False, video: ExecutionVideoConfig | None = None
) -> RobotEpisode:
    """Run the planner of ``config`` in its cell; the robot ends at rest.

    Args:
        config: of the robot.
        index: of the task of a simulated cell.
        dry_run: whether nothing is commanded.
        video: makes the frames of a video; None for none.

    Raises:
        ConfigError, CheckpointError, DataError: the cell, its perception or the planner cannot be made.
        CellFault, PerceptionError: the first look fails; the robot is at rest.
    """
    from pipelines.robots import open_robot

    robot = open_robot(config, index, read_only=dry_run, render=video is not None)
    try:
        return _run(config, index, robot, dry_run, video)
    finally:
        robot.cell.close()


def _run(
    config: RobotConfig, index: int, robot: Robot, dry_run: bool, video: ExecutionVideoConfig | None
) -> RobotEpisode:
    from pipelines.planners import build_planner, find_network, released_where_untrained
    from pipelines.robots import make_dry_run, make_model, make_planar_world, make_world
    from visualrhp.embodiment.dry_run import DryRunWorld
    from visualrhp.embodiment.guarded_planner import GuardedPlanner
    from visualrhp.embodiment.planar_world import PlanarWorld
    from visualrhp.embodiment.robot_world import RobotWorld
    from visualrhp.execution import run_episode
    from visualrhp.simulation.action_spaces import make_action_space
    from visualrhp.streams import Split, Stream, generator_for

    space = make_action_space(config.action_space.name)
    filmed = None if video is None else _filmed(robot, video.fps)
    if filmed is not None:
        robot = replace(robot, cell=filmed)
    if getattr(config, "world", "cell") != "cell":
        world = make_planar_world(cast("EvaluateExecutionConfig", config), robot, space)
    else:
        world = make_dry_run(config, robot, space) if dry_run else make_world(config, robot, space)
    begun, cell_begun = time.perf_counter(), robot.cell.now()
    model = make_model(config, robot, world, space)
    num_objects = model.scene.num_objects
    folder = released_where_untrained(config.planner, space.name, config.heuristics, num_objects)
    network = find_network(config.planner, space.name, folder, num_objects)
    planner = build_planner(config.planner, space.name, num_objects, network)
    if isinstance(world, RobotWorld):
        planner = GuardedPlanner(planner, world.stop)
    rng = generator_for(config.seed, Split.EVALUATION, index, Stream.PLANNER)
    recorder = None
    if video is not None and filmed is not None and not isinstance(world, PlanarWorld):
        recorder = _recorder(config, robot, filmed, world, video)
    result = run_episode(planner, world, model, rng, recorder)
    actions = [asdict(latency) for latency in world.latencies]
    for step, timed in zip(actions, result.decisions, strict=False):
        step["decision_s"] = timed.time_s
    if recorder is not None:
        recorder.end(result.outcome)
    return RobotEpisode(
        result,
        actions,
        None if dry_run else true_end(world) if isinstance(world, PlanarWorld) else robot.true_end(),
        tuple(world.motions) if isinstance(world, DryRunWorld) else (),
        time.perf_counter() - begun,
        robot.cell.now() - cell_begun,
        () if recorder is None else recorder.frames,
    )


def true_end(world: PlanarWorld) -> dict[str, Any]:
    """As :meth:`pipelines.robots.Robot.true_end`, of a task in the planner's simulator."""
    from visualrhp.simulation import rules

    scene, state = world.observe()
    return {
        "success": rules.is_goal(scene, state) and not rules.is_dropped(scene, state),
        "distance_to_target": float(np.hypot(*(state.desired_position - scene.target.position))),
        "fallen": rules.dropped_objects(scene, state),
    }


def title_of(config: RobotConfig) -> str:
    """The name of the planner as in the paper, and what finds the objects."""
    from visualrhp.evaluation.methods import Method

    title = f"{Method.of(config.planner).label}, {config.segmenter.name.replace('_', ' ')}"
    return f"{title}, dry run" if getattr(config, "dry_run", False) else title


def _filmed(robot: Robot, fps: float) -> FilmedCell:
    """The cell of ``robot``, which is filmed."""
    from visualrhp.embodiment.film import FilmedCell

    simulated = robot.simulated
    if simulated is None:
        return FilmedCell(robot.cell, fps)
    return FilmedCell(robot.cell, fps, simulated.picture, simulated.side_view)


def _recorder(
    config: RobotConfig,
    robot: Robot,
    cell: FilmedCell,
    world: RobotWorld | DryRunWorld,
    video: ExecutionVideoConfig,
) -> FilmRecorder:
    from visualrhp.embodiment.film import FilmRecorder
    from visualrhp.evaluation.films import imagined_paths
    from visualrhp.simulation import MAX_EPISODE_ACTIONS

    def view() -> SeenScene:
        assert world.last_sight is not None  # the episode begins with a look
        return world.last_sight.view

    return FilmRecorder(
        cell,
        view,
        getattr(robot.perception, "camera", None),
        title_of(config),
        MAX_EPISODE_ACTIONS,
        lambda timed: imagined_paths(timed.decision),
        size_px=video.size_px,
        decision_frames=max(1, round(video.fps * video.decision_s)),
        hold=max(1, round(video.fps * video.hold_s)),
    )
