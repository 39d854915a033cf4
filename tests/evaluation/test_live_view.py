"""What is shown live is what the video shows."""

from __future__ import annotations

import numpy as np

from tests.rendering.fake_window import FakeTime, FakeToolkit
from visualrhp.evaluation.films import film_episode
from visualrhp.evaluation.live_view import LiveView
from visualrhp.execution import run_episode, simulated_task
from visualrhp.heuristics.crafted import CraftedHeuristic
from visualrhp.planning import RecedingHorizon
from visualrhp.rendering.episode_renderer import EpisodeRenderer
from visualrhp.rendering.window import Window, ppm
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.simulation import make_action_space
from visualrhp.simulation.recording import MotionRecorder
from visualrhp.streams import Split


def test_the_frames_are_those_of_the_video() -> None:
    task = sample_task_instance(SceneDistribution(num_objects=2), 0, Split.TUNING, 1)
    world, model = simulated_task(task, 0, Split.TUNING, 1, action_space=make_action_space("continuous"))
    toolkit, passing = FakeToolkit(), FakeTime()
    renderer = EpisodeRenderer(task.scene, task.state, size_px=64, imagined_frames=1, show_imagined=True)
    window = Window("", toolkit, passing.clock, passing.sleep)
    view = LiveView(window, renderer, MotionRecorder(world.model, 2), fps=5.0, hold_s=1.0)
    planner = RecedingHorizon(CraftedHeuristic("continuous"), num_rollouts=2, horizon=2)
    result = run_episode(planner, world, model, np.random.default_rng(0), view)
    view.end(result.outcome)
    frames = list(film_episode(result, world.model, size_px=64, frames_per_action=2, imagined_frames=1, hold=0))
    assert toolkit.pictures[:-2] == [ppm(frame) for frame in frames]
    assert toolkit.pictures[-1] == ppm(frames[-1])
    assert len(frames) >= 1 + 3 * len(result.episode) > 1
