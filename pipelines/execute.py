"""Run a robot: perceive, decide, execute, again: ``python -m pipelines.execute``.

One episode in a simulated cell (``index``, or a named ``scenario``), or with ``cell=ur_rtde`` in a real one, until the
camera sees the goal reached, a drop, or 49 actions; or until a fault stops the robot, which the outcome names. The
artefact is two files in one folder, as of :mod:`pipelines.play`:

- ``*.webm``: the video, of what the camera saw, the roll-outs that were compared, and the cell from the side;
- ``*.json``: the card: configuration, outcome, every decision, and the latency of every part.

``dry_run=true`` computes, checks and shows every motion, and commands none. Not a DVC stage.
"""

from __future__ import annotations

import functools
import logging
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import ExecuteConfig
    from pipelines.robot_episode import RobotEpisode

STAGE = "execute"

_log = logging.getLogger(__name__)


@app(STAGE)
def main(config: ExecuteConfig) -> None:
    """Run the robot, and write the video and the card."""
    from pipelines.robot_episode import run_robot
    from pipelines.workflow.artefacts import card
    from pipelines.workflow.publishing import check_files, publish_files
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work
    from visualrhp.evaluation.episode_record import episode_record
    from visualrhp.files import write_json
    from visualrhp.rendering.video import write_video

    stem = file_stem(config)
    names = [f"{stem}.webm", f"{stem}.json"]
    check = functools.partial(check_files, config.paths.artefact, names, STAGE)
    inputs = {"artefact": os.path.abspath(config.paths.artefact)}
    with open_work(config, STAGE, inputs, check) as work, open_run(config, STAGE, stem, work) as run:
        episode = run_robot(config, config.index, dry_run=config.dry_run, video=config.video)
        result = episode.result
        for number, motion in enumerate(episode.motions):
            print(f"{number:2d}  {motion.describe()}")
        _log.info("%s", description(config, episode))
        write_video(work / names[0], episode.frames, config.video.fps)
        content = {
            "video": names[0],
            "truth": episode.true_end,
            "wall_time_s": episode.wall_time_s,
            "cell_time_s": episode.cell_time_s,
            "latencies": {"summary": episode.latency_summary, "actions": episode.actions},
            **episode_record(result),
        }
        write_json(work / names[1], card(config, STAGE, **content))
        for name in names:
            run.log_artifact(work / name)
        publish_files(work, config.paths.artefact, names, STAGE)
        _log.info("%s", Path(config.paths.artefact) / names[0])


def description(config: ExecuteConfig, episode: RobotEpisode) -> str:
    """The end of an episode, and its latencies, in a sentence each."""
    from pipelines.robot_episode import title_of

    result, latency, truth = episode.result, episode.latency_summary, episode.true_end
    text = f"{title_of(config)}: {result.outcome} after {len(result.episode)} actions"
    if result.fault is not None:
        text += f" ({result.fault})"
    if truth is not None:
        text += f"; in truth {'success' if truth['success'] else 'no success'}"
    if latency:
        text += (
            f". Perception {1e3 * latency['mean_perception_s']:.0f} ms an image, decision "
            f"{1e3 * latency['mean_decision_s']:.0f} ms, both at most "
            f"{1e3 * latency['max_perception_and_decision_s']:.0f} ms, path {1e3 * latency['mean_path_s']:.1f} ms"
        )
    return text + "."


def file_stem(config: ExecuteConfig) -> str:
    """Name of the files without suffix: ``visualrhp-plus-3x3-network_continuous_simulated_seed0_index3_9f2c41d0``."""
    from pipelines.robot_episode import title_of
    from pipelines.workflow.artefacts import content_hash, result_config
    from pipelines.workflow.names import MAX_LENGTH

    task = [f"seed{config.seed}", f"index{config.index}"] if config.scenario is None else [config.scenario]
    parts = [title_of(config), config.action_space.name, config.cell.name, *task]
    text = "_".join(re.sub(r"[^a-z0-9_.-]+", "-", part.lower().replace("+", "-plus")).strip("-.") for part in parts)
    return f"{text[:MAX_LENGTH]}_{content_hash(result_config(config))[:8]}"


if __name__ == "__main__":
    main()
