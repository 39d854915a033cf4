"""Films of episodes in a robot cell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.embodiment.planar_cell import PlanarCell, PlanarKinematics, PlanarPerception, pushing_task
from tests.embodiment.test_robot_world import CONTINUOUS, FORWARD, Scripted
from visualrhp.embodiment.film import FilmedCell, FilmRecorder
from visualrhp.embodiment.robot_world import RobotWorld
from visualrhp.errors import ConfigError
from visualrhp.execution import run_episode
from visualrhp.rendering.legend import meaning_bar, scale_height
from visualrhp.rendering.panels import bar_height
from visualrhp.simulation import TransitionModel
from visualrhp.types import Outcome

SIZE = 96


def filmed(side: bool = True) -> tuple[FilmedCell, FilmRecorder, Any]:
    task = pushing_task()
    cell = PlanarCell(task)
    grey = np.full((60, 80, 3), 128, np.uint8)
    film = FilmedCell(cell, fps=5.0, side_view=(lambda: grey) if side else None)
    world = RobotWorld(film, PlanarPerception(cell), PlanarKinematics(), CONTINUOUS)
    recorder = FilmRecorder(
        film,
        lambda: world.last_sight.view,
        None,
        "Scripted",
        49,
        lambda timed: (),
        size_px=SIZE,
        decision_frames=2,
        hold=3,
    )
    model = TransitionModel(task.scene, CONTINUOUS)
    result = run_episode(Scripted(FORWARD), world, model, np.random.default_rng(0), recorder)
    return film, recorder, result


@pytest.mark.parametrize("side", [True, False])
def test_a_film_has_a_picture_of_every_fifth_of_a_second_of_motion(side: bool) -> None:
    film, recorder, result = filmed(side)
    assert result.outcome is Outcome.SUCCESS
    frames = list(recorder.frames)
    width = (3 if side else 2) * SIZE
    bars = bar_height(SIZE) + scale_height(SIZE) + meaning_bar(SIZE, width, with_paths=True).shape[0]
    assert {frame.shape for frame in frames} == {(SIZE + bars, width, 3)}
    decisions, ends = 2 * result.num_actions, 3
    assert len(frames) >= decisions + ends + 3 * result.num_actions  # every action takes most of a second
    assert film.snapshots == [], "pictures are kept as frames only"


def test_a_filmed_cell_behaves_as_the_one_it_wraps() -> None:
    _, _, result = filmed()
    cell = PlanarCell(pushing_task())
    world = RobotWorld(cell, PlanarPerception(cell), PlanarKinematics(), CONTINUOUS)
    plain = run_episode(Scripted(FORWARD), world, TransitionModel(cell.scene, CONTINUOUS), np.random.default_rng(0))
    assert plain.outcome is result.outcome
    for one, other in zip(plain.episode.states, result.episode.states, strict=True):
        np.testing.assert_allclose(one.vector, other.vector, atol=1e-9)


def test_the_clock_passes_every_wait_exactly() -> None:
    cell = PlanarCell(pushing_task())
    film = FilmedCell(cell, fps=7.0)
    for duration in (0.0, 0.01, 0.5, 1.0 / 7.0, 0.3):
        before = cell.now()
        film.wait(duration)
        assert cell.now() - before == pytest.approx(duration)
    assert len(film.snapshots) == 1 + int((cell.now() - 1.0) * 7.0 + 1e-9)
    assert np.diff([snapshot.time_s for snapshot in film.snapshots]) == pytest.approx(1.0 / 7.0)


def test_settings_that_give_no_film_are_refused() -> None:
    cell = PlanarCell(pushing_task())
    with pytest.raises(ConfigError, match="fps=0"):
        FilmedCell(cell, fps=0.0)
    with pytest.raises(ConfigError, match="size_px=10"):
        FilmRecorder(FilmedCell(cell), lambda: None, None, "", 49, lambda timed: (), size_px=10)
