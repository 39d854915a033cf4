"""A short video of a network's greedy policy."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from visualrhp.evaluation.films import film_episode
from visualrhp.execution import run_task
from visualrhp.heuristics.checkpoint import load_heuristic
from visualrhp.planning import Greedy
from visualrhp.rendering.video import Frame, write_video
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.simulation import Physics, TransitionModel, make_action_space
from visualrhp.streams import Split
from visualrhp.types import ActionSpaceName

_FPS, _FRAMES_PER_ACTION = 9.0, 3
"""Small, since drawing takes time; the videos of the report are better."""


def write_greedy_video(
    path: Path,
    network: Path,
    distribution: SceneDistribution,
    action_space: ActionSpaceName,
    physics: Physics,
    seed: int,
    *,
    num_scenes: int,
    size_px: int,
) -> None:
    """Write a video of the greedy policy of ``network`` on the first validation tasks."""
    planner, space = Greedy(load_heuristic(network, action_space)), make_action_space(action_space)

    def frames() -> Iterator[Frame]:
        for index in range(num_scenes):
            key = (seed, Split.VALIDATION, index)
            task = sample_task_instance(distribution, *key)
            result = run_task(planner, task, *key, action_space=space, physics=physics)
            yield from film_episode(
                result,
                TransitionModel(task.scene, space, physics),
                title=f"Greedy, {action_space}",
                size_px=size_px,
                frames_per_action=_FRAMES_PER_ACTION,
                hold=round(_FPS),
                show_observation=True,
            )

    write_video(path, frames(), _FPS)
