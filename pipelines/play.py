"""Watch a planner and the roll-outs that it compares: ``python -m pipelines.play``.

Runs one planner on one task, sampled (the same as in an evaluation with the same seed, scene and index) or from a file.
The artefact is two files in one folder, named by planner, task and noise:

- ``*.webm``: the video; before each action it shows the roll-outs that the planner compared, or the rest of the
  plan that it follows;
- ``*.json``: the card: configuration, commit, outcome, and every decision with its roll-outs, returns and duration.

Where there is a screen, the episode is also shown live in a window. Not a DVC stage, since no other stage uses it.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import os
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.workflow.app import app, command_line_overrides, override_keys

if TYPE_CHECKING:
    from pipelines.config import PlayConfig
    from visualrhp.execution import EpisodeResult
    from visualrhp.planning import Planner
    from visualrhp.rendering.window import Window
    from visualrhp.scene import TaskInstance
    from visualrhp.simulation import TransitionModel

STAGE = "play"

_log = logging.getLogger(__name__)


@app(STAGE)
def main(config: PlayConfig) -> None:
    """Run the planner, and write the video and the card."""
    from pipelines.planners import build_planner, find_network, released_where_untrained
    from pipelines.workflow.artefacts import card
    from pipelines.workflow.publishing import check_files, publish_files
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work
    from visualrhp.evaluation.episode_record import episode_record
    from visualrhp.evaluation.films import film_episode
    from visualrhp.files import write_json
    from visualrhp.rendering.video import write_video

    instance = task_instance(config)
    space, num_objects = config.action_space.name, instance.scene.num_objects
    folder = released_where_untrained(config.planner, space, config.heuristics, num_objects)
    network = find_network(config.planner, space, folder, num_objects)
    planner = build_planner(config.planner, space, num_objects, network)
    stem = file_stem(config, num_objects)
    names = [f"{stem}.webm", f"{stem}.json"]
    check = functools.partial(check_files, config.paths.artefact, names, STAGE)
    inputs = {"network": str(network), "artefact": os.path.abspath(config.paths.artefact)}
    with open_work(config, STAGE, inputs, check) as work, open_run(config, STAGE, stem, work) as run:
        window = open_window(config)
        try:
            result, world_model = play(config, instance, planner, window)
        finally:
            if window is not None:
                window.close()
        _log.info(
            "%s: %s after %d actions; %.2f s of planning.",
            title_of(config),
            result.outcome,
            len(result.episode),
            result.decision_time_s,
        )
        started = time.perf_counter()
        hold = round(config.video.fps * config.video.hold_s)
        film = film_episode(result, world_model, hold=hold, **looks(config))
        num_frames = write_video(work / names[0], film, config.video.fps)
        write_json(work / names[1], card(config, STAGE, video=names[0], **episode_record(result)))
        for name in names:
            run.log_artifact(work / name)
        publish_files(work, config.paths.artefact, names, STAGE)
        path = Path(config.paths.artefact) / names[0]
        _log.info("%s: %d frames in %.1f s.", path, num_frames, time.perf_counter() - started)


def play(
    config: PlayConfig, instance: TaskInstance, planner: Planner, window: Window | None = None
) -> tuple[EpisodeResult, TransitionModel]:
    """Run the episode, and show it in ``window`` if there is one; return the result and the model of the world."""
    from visualrhp.evaluation.live_view import LiveView
    from visualrhp.execution import run_episode, simulated_task
    from visualrhp.rendering.episode_renderer import EpisodeRenderer
    from visualrhp.scene import NOISE_LEVELS
    from visualrhp.simulation import make_action_space
    from visualrhp.simulation.recording import MotionRecorder
    from visualrhp.streams import Split, Stream, generator_for

    key = (config.seed, Split.EVALUATION, config.index)
    world, model = simulated_task(
        instance,
        *key,
        action_space=make_action_space(config.action_space.name),
        physics=config.physics,
        noise=NOISE_LEVELS[config.noise_level],
    )
    view = None
    if window is not None:
        options = looks(config)
        imagined_frames = options.pop("imagined_frames")
        recorder = MotionRecorder(world.model, options.pop("frames_per_action"))
        renderer = EpisodeRenderer(
            world.model.scene,
            instance.state,
            show_imagined=imagined_frames > 0,
            imagined_frames=max(1, imagined_frames),
            believed_scene=instance.scene,
            **options,
        )
        view = LiveView(window, renderer, recorder, config.video.fps, config.video.hold_s)
    result = run_episode(planner, world, model, generator_for(*key, Stream.PLANNER), view)
    if view is not None:
        view.end(result.outcome)
    return result, world.model


def task_instance(config: PlayConfig) -> TaskInstance:
    """The task to play: from the scene file if there is one, otherwise sampled.

    Raises:
        ConfigError: a parameter of sampled scenes is given together with a file.
        SceneError: the scene file cannot be read, or its scene cannot be simulated.
    """
    from visualrhp.errors import ConfigError
    from visualrhp.scene import load_task_instance, sample_task_instance
    from visualrhp.streams import Split

    if config.scene_file is not None:
        for key in sorted(override_keys(command_line_overrides())):
            if key.partition(".")[0] == "scene":
                raise ConfigError(f"{key} is for sampled scenes only, not for scene_file={config.scene_file}.")
        return load_task_instance(config.scene_file)
    return sample_task_instance(config.scene, config.seed, Split.EVALUATION, config.index)


def title_of(config: PlayConfig) -> str:
    """The name of the planner as in the paper, with the level of noise."""
    from visualrhp.evaluation.methods import Method

    title = Method.of(config.planner).label
    return title if config.noise_level == "none" else f"{title}, {config.noise_level} noise"


def file_stem(config: PlayConfig, num_objects: int) -> str:
    """Name of the video without its suffix: ``visualrhp-3x3_continuous_m5_seed0_index3_9f2c41d0``.

    It ends with a digest of the configuration, and of the content of the scene file.
    """
    from pipelines.workflow.artefacts import content_hash, result_config
    from pipelines.workflow.names import MAX_LENGTH

    task = f"m{num_objects}" + (f"-{config.scene.object_size}" if config.scene.object_size != "mixed" else "")
    content = result_config(config)
    if config.scene_file is not None:
        task = Path(config.scene_file).stem
        content["scene_file"] = hashlib.sha256(Path(config.scene_file).read_bytes()).hexdigest()
    parts = [title_of(config), config.action_space.name, task, f"seed{config.seed}", f"index{config.index}"]
    text = "_".join(re.sub(r"[^a-z0-9_.-]+", "-", part.lower().replace("+", "-plus")).strip("-.") for part in parts)
    return f"{text[:MAX_LENGTH]}_{content_hash(content)[:8]}"


def looks(config: PlayConfig) -> dict[str, Any]:
    """Options of the frames: arguments of ``film_episode``."""
    from visualrhp.simulation import MAX_EPISODE_ACTIONS

    video = config.video
    has_rollouts = video.imagined_s > 0.0 and config.planner.algorithm != "greedy"
    return {
        "title": title_of(config),
        "max_steps": MAX_EPISODE_ACTIONS,
        "size_px": video.size_px,
        "frames_per_action": max(1, round(video.fps * video.action_s)),
        "imagined_frames": max(1, round(video.fps * video.imagined_s)) if has_rollouts else 0,
        "show_observation": video.label_image == "panel",
        "show_inset": video.label_image == "inset",
    }


def open_window(config: PlayConfig) -> Window | None:
    """Open the window for the episode, if the configuration requests it and it is possible.

    Raises:
        ConfigError: ``live=true`` and there is no screen.
    """
    from visualrhp.errors import ConfigError
    from visualrhp.rendering.window import Window, has_screen

    if config.live is False or (config.live == "auto" and not has_screen()):
        return None
    try:
        return Window(title_of(config))
    except ConfigError:
        if config.live is True:
            raise
        return None


if __name__ == "__main__":
    main()
