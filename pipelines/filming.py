"""Videos of planners on tasks: composed and checked before any work starts, then filmed in parallel."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.config import EvaluateConfig, ReportConfig
from pipelines.workflow.app import compose

if TYPE_CHECKING:
    from visualrhp.evaluation.report_videos import Attempt, SceneVideos

_ACTION_S = 0.5
_IMAGINED_S = 0.5


@dataclass(frozen=True)
class VideoTask:
    """A planner on a task, to be run and filmed.

    Attributes:
        config: planner, action space, scene, physics, noise and networks.
        scene_index: scene of the page, and index of the task instance.
        fps: frames per second.
        size_px: width.
        network: file of its network; None if it needs none, or has none for this number of objects.
        is_missing: whether it needs a network that does not exist.
    """

    config: EvaluateConfig = field(repr=False)
    scene_index: int
    fps: int
    size_px: int
    network: Path | None = None
    is_missing: bool = False


def video_tasks(config: ReportConfig, work: Path) -> list[VideoTask]:
    """The tasks to film: every planner in every action space on every scene; networks are copied to ``work``.

    Raises:
        ConfigError: a planner is unknown.
        CheckpointError: a network for any number of objects is missing, or a network is damaged.
    """
    from pipelines.networks import NetworkFile
    from pipelines.planners import build_planner, find_network, fixes_num_objects, needed_network

    videos = config.videos
    tasks = []
    for scene_index, num_objects in scene_sizes(config).items():
        for space in videos.action_spaces:
            for planner in videos.planners:
                overrides = [f"planner={planner}", f"action_space={space}", f"scene.num_objects={num_objects}"]
                composed = compose("evaluate", EvaluateConfig, overrides)
                point = replace(composed, seed=config.seed, heuristics=config.heuristics, paths=config.paths)
                path = needed_network(point.planner, space, config.heuristics, num_objects)
                if not fixes_num_objects(point.planner):
                    find_network(point.planner, space, config.heuristics, num_objects)
                is_missing = path is not None and not os.path.lexists(path)
                network = None
                if not is_missing:
                    build_planner(point.planner, space, num_objects, path)
                    network = path and NetworkFile.read(path, path.name).store(work / "networks")
                tasks.append(VideoTask(point, scene_index, videos.fps, videos.size_px, network, is_missing))
    return tasks


def scene_sizes(config: ReportConfig) -> dict[int, int]:
    """Index of each scene of the page -> its number of objects."""
    sizes = config.videos.num_objects
    return {index: sizes[index % len(sizes)] for index in range(config.videos.num_scenes)}


def film_task(task: VideoTask) -> Attempt:
    """Run a planner on a task, and encode its video."""
    from pipelines.planners import build_planner
    from visualrhp.evaluation.films import encode_film, film_episode
    from visualrhp.evaluation.methods import Method
    from visualrhp.evaluation.report_videos import Attempt
    from visualrhp.execution import run_episode, simulated_task
    from visualrhp.scene import NOISE_LEVELS, sample_task_instance
    from visualrhp.simulation import MAX_EPISODE_ACTIONS, make_action_space
    from visualrhp.streams import Split, Stream, generator_for

    config, index = task.config, task.scene_index
    space, method = config.action_space.name, Method.of(config.planner).label
    if task.is_missing:
        missing = f"{method}: no network for {config.scene.num_objects[0]} objects"
        return Attempt(index, space, method, missing, None)
    key, action_space = (config.seed, Split.EVALUATION, index), make_action_space(space)
    instance = sample_task_instance(config.scene, *key)
    world, model = simulated_task(
        instance, *key, action_space=action_space, physics=config.physics, noise=NOISE_LEVELS[config.noise_level]
    )
    planner = build_planner(config.planner, space, instance.scene.num_objects, task.network)
    result = run_episode(planner, world, model, generator_for(*key, Stream.PLANNER))
    frames = film_episode(
        result,
        world.model,
        title=method,
        max_steps=MAX_EPISODE_ACTIONS,
        size_px=task.size_px,
        frames_per_action=max(1, round(task.fps * _ACTION_S)),
        imagined_frames=max(1, round(task.fps * _IMAGINED_S)),  # of every planner: all films have one size
        hold=task.fps // 2,
    )
    description = f"{method}, {space} actions: {result.outcome}, {result.num_actions} actions"
    return Attempt(index, space, method, description, encode_film(frames, task.fps))


def evaluated_task(
    point: Mapping[str, Any], seed: int, num_objects: int, index: int, fps: int, size_px: int, work: Path
) -> VideoTask:
    """An episode of an evaluation, to be run again and filmed.

    Args:
        point: its setting on the card of the evaluation (:attr:`pipelines.points.Point.card`).
        seed: of the evaluation.
        num_objects: m of its scene.
        index: of the task instance.
        fps, size_px: of the film.
        work: folder to which its network is copied.

    Raises:
        CheckpointError: its network is missing or damaged.
        ConfigError: the card is of another version.
    """
    from pipelines.networks import NetworkFile
    from pipelines.planners import find_network
    from visualrhp.parameters import validated

    space = point["action_space"]
    composed = asdict(compose("evaluate", EvaluateConfig, [f"action_space={space}"]))
    evaluated = {
        "planner": point["planner_config"],
        "scene": point["scene"],
        "physics": point["physics"],
        "noise_level": point["noise_level"],
        "heuristics": point["heuristics"],
        "seed": seed,
    }
    config = validated(EvaluateConfig, composed | evaluated)
    path = find_network(config.planner, config.action_space.name, config.heuristics, num_objects)
    network = path and NetworkFile.read(path, path.name).store(work / "networks")
    return VideoTask(config, index, fps, size_px, network)


def film(config: ReportConfig, tasks: Sequence[VideoTask], folder: Path) -> list[SceneVideos]:
    """Film all tasks in parallel; write the videos and side-by-side comparisons to ``folder``."""
    from tqdm import tqdm

    from pipelines.workflow.executor import run_tasks
    from visualrhp.evaluation.films import write_comparison
    from visualrhp.evaluation.report_videos import arrange_attempts
    from visualrhp.files import atomic_path

    results = run_tasks(film_task, tasks, config.executor)
    attempts = list(tqdm(results, total=len(tasks), desc="videos", unit="video", disable=not tasks))
    for attempt in attempts:
        if attempt.film is not None:
            with atomic_path(folder / f"{attempt.stem}.webm") as path:
                path.write_bytes(attempt.film.data)
    scenes = arrange_attempts(attempts, scene_sizes(config), config.videos.action_spaces, config.seed)
    compared = scenes[0].rows[0].attempts if scenes and scenes[0].rows else ()
    films = [attempt.film for attempt in compared if attempt.film is not None]
    if films:
        write_comparison(films, folder / "comparison.webm", config.videos.fps)
    return scenes
