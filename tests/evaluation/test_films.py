"""Films of episodes: what is shown, and that they can be played."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.evaluation.samples import sample_scene, sample_state
from visualrhp.errors import DataError
from visualrhp.evaluation.films import (
    encode_film,
    film_episode,
    imagined_paths,
    write_comparison,
)
from visualrhp.execution.episode import EpisodeResult, TimedDecision
from visualrhp.planning.planner import Decision, Rollout
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.panels import observation_panel
from visualrhp.rendering.pictures import encode_picture
from visualrhp.rendering.video import read_video
from visualrhp.scene import ObjectShape, Scene
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.simulation.recording import MotionRecorder
from visualrhp.types import Episode, Outcome

SPACE = make_action_space("discrete")


def model_of(result: EpisodeResult) -> TransitionModel:
    return TransitionModel(result.scene, SPACE)


def pushing(num_actions: int = 3, model: TransitionModel | None = None) -> EpisodeResult:
    """An episode in the simulator: the gripper moves forward, and pushes the desired object."""
    scene = sample_scene(2)
    model = model or TransitionModel(scene, SPACE)
    states = [sample_state((-0.1, 0.0), (0.0, 0.0), 2)]
    for _ in range(num_actions):
        states.append(model.advance(states[-1], 0))
    episode = Episode(tuple(states), (0,) * num_actions, (-1.0,) * num_actions, Outcome.SUCCESS)
    return EpisodeResult(scene, episode, (), 0.0)


RESULT = pushing()
MODEL = model_of(RESULT)


def rollout(total_return: float) -> Rollout:
    return Rollout((0,), RESULT.episode.states[:2], (-1.0,), total_return, total_return)


def imagining(result: EpisodeResult) -> EpisodeResult:
    """The same episode with two roll-outs in every decision."""
    decisions = tuple(
        TimedDecision(state, Decision(0, (rollout(-2.0), rollout(-1.0))), 0.1) for state in result.episode.states[:-1]
    )
    return EpisodeResult(result.scene, result.episode, decisions, 0.0)


def test_an_episode_is_filmed_from_its_start_to_its_end() -> None:
    frames = list(film_episode(RESULT, MODEL, size_px=64, frames_per_action=4, hold=5))
    motions = MotionRecorder(MODEL, 4).record_episode(RESULT.episode)
    assert len(frames) == 1 + sum(len(motion) - 1 for motion in motions) + 5 >= 1 + 3 * 4 + 5
    assert all(frame.shape == (64, 64, 3) for frame in frames)
    for frame in frames[-5:]:
        np.testing.assert_array_equal(frame, frames[-6])


def test_what_the_planner_imagined_is_shown_before_each_action() -> None:
    plain = list(film_episode(imagining(RESULT), MODEL, size_px=64, frames_per_action=1, hold=0))
    shown = list(film_episode(imagining(RESULT), MODEL, size_px=64, frames_per_action=1, hold=0, imagined_frames=2))
    assert len(shown) == len(plain) + 3 * 2
    assert shown[0].shape[0] > plain[0].shape[0], "a bar for the legend"


def test_the_world_is_drawn_as_it_is_and_the_label_image_as_the_planner_believes() -> None:
    small = ObjectShape.centred([[0.0, 0.0], [0.02, 0.0], [0.02, 0.02], [0.0, 0.02]])
    truth = TransitionModel(Scene(RESULT.scene.target, (small, *RESULT.scene.objects[1:])), SPACE)
    noisy = pushing(model=truth)
    options: dict[str, Any] = {"size_px": 128, "frames_per_action": 3, "show_observation": True}
    frames = list(film_episode(noisy, truth, **options))
    motions = MotionRecorder(truth, 3).record_episode(noisy.episode)
    number = len(motions[0])  # the first picture of the second motion
    shown = render_frame(truth.scene, motions[1][1], size_px=128, trail=noisy.episode.states[:2])
    np.testing.assert_array_equal(frames[number][:128, :128], shown)
    believed = observation_panel(truth.scene, noisy.scene, noisy.episode.states[1], 128)
    np.testing.assert_array_equal(frames[number][:128, 128:], believed)
    with pytest.raises(DataError, match=r"action 3 of 3 leads to another state"):
        next(film_episode(noisy, MODEL, **options))


def test_the_chosen_roll_out_is_marked() -> None:
    decision = Decision(0, tuple(rollout(value) for value in (-math.inf, -3.0, -1.0, -1.0)), chosen=2)
    assert [path.is_chosen for path in imagined_paths(decision)] == [False, False, True, False]
    assert [path.value for path in imagined_paths(decision)] == [-math.inf, -3.0, -1.0, -1.0]
    assert not imagined_paths(Decision(0))


def test_films_can_be_played_and_posters_seen(tmp_path: Path) -> None:
    frames = list(film_episode(RESULT, MODEL, title="Greedy", size_px=64, frames_per_action=2, hold=2))
    film = encode_film(frames, 12.0)
    assert (film.height, film.width) == frames[0].shape[:2]
    path = tmp_path / "film.webm"
    path.write_bytes(film.data)
    assert len(read_video(path)) == len(frames)
    poster = np.asarray(cv2.imdecode(np.frombuffer(film.poster, dtype=np.uint8), cv2.IMREAD_COLOR))
    assert np.abs(poster[:, :, ::-1].astype(int) - frames[-1]).mean() < 5.0
    assert film.poster == encode_picture(frames[-1], ".webp")
    with pytest.raises(DataError, match="at least one frame"):
        encode_film([], 12.0)


def test_films_are_compared_side_by_side(tmp_path: Path) -> None:
    films = [
        encode_film(film_episode(pushing(n), MODEL, size_px=128, frames_per_action=1, hold=0), 12.0) for n in (2, 5, 3)
    ]
    path = tmp_path / "comparison.webm"
    write_comparison(films, path, 12.0, columns=2, cell_px=64)
    frames = read_video(path)
    assert len(frames) == 6, "as long as the longest"
    assert frames[0].shape == (2 * 64 + 8, 2 * 64 + 8, 3)
