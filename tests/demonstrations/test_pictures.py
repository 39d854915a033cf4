"""Pictures of a set show its own states."""

from __future__ import annotations

import numpy as np
import pytest

from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.pictures import contact_sheet, demonstration_frames, length_histogram
from visualrhp.errors import DataError
from visualrhp.rendering.episode_renderer import episode_frames
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.video import Frame
from visualrhp.simulation import Physics, TransitionModel, make_action_space
from visualrhp.simulation.recording import MotionRecorder
from visualrhp.types import Outcome

CELL_PX = 160


def test_a_row_of_the_contact_sheet_goes_from_the_first_state_to_the_last(stored: DemonstrationSet) -> None:
    sheet = contact_sheet(stored)
    pairs = list(stored)[:8]
    assert sheet.dtype == np.uint8 and sheet.shape == (len(pairs) * CELL_PX, 8 * CELL_PX, 3)
    for row, (task, episode) in enumerate(pairs):
        cells = np.split(sheet[row * CELL_PX : (row + 1) * CELL_PX], 8, axis=1)
        np.testing.assert_array_equal(cells[0], render_frame(task.scene, episode.states[0], size_px=CELL_PX))
        number = min(8, len(episode) + 1)
        last = render_frame(task.scene, episode.states[-1], size_px=CELL_PX, trail=episode.states[:-1])
        np.testing.assert_array_equal(cells[number - 1], last)
        for blank in cells[number:]:
            assert (blank == sheet[0, 0]).all()


def film(stored: DemonstrationSet, count: int) -> list[Frame]:
    return [*demonstration_frames(stored, Physics(), count, 96, frames_per_action=4, hold=8)]


def test_the_video_has_the_motions_of_the_first_demonstrations(stored: DemonstrationSet) -> None:
    one, two = film(stored, 1), film(stored, 2)
    counts = []
    for task, episode in list(stored)[:2]:
        model = TransitionModel(task.scene, make_action_space(stored.action_space))
        motions = MotionRecorder(model, 4).record_episode(episode)
        counts.append(1 + sum(len(motion) - 1 for motion in motions) + 8)
    assert [len(one), len(two)] == [counts[0], sum(counts)]
    np.testing.assert_array_equal(two[0], one[0])
    with pytest.raises(DataError, match="leads to another state"):
        next(demonstration_frames(stored, Physics(motion_steps=60), 1, 96, 4, 8))


def test_bars_of_the_histogram_are_centred_on_the_numbers() -> None:
    figure = length_histogram([1, 3, 3, 4], "discrete")
    (axes,) = figure.axes
    heights = {round(bar.get_x() + bar.get_width() / 2, 6): bar.get_height() for bar in axes.patches}  # pyright: ignore[reportAttributeAccessIssue]
    assert heights == {0: 0, 1: 1, 2: 0, 3: 2, 4: 1}
    assert axes.get_title() == "4 demonstrations, discrete: 2.8 actions on average"


def test_the_video_names_the_action_space_and_the_outcome(stored: DemonstrationSet) -> None:
    task, episode = next(iter(stored))
    shown = film(stored, 1)

    def last_frame(title: str, outcome: Outcome | None) -> Frame:
        motions = [episode.states[number : number + 2] for number in range(len(episode))]
        return [*episode_frames(task.scene, task.state, motions, title=title, outcome=outcome, size_px=96)][-1]

    title = f"K.RRT, {stored.action_space}"
    np.testing.assert_array_equal(shown[-1], last_frame(title, Outcome.SUCCESS))
    assert not np.array_equal(shown[-1], last_frame(title, None))
