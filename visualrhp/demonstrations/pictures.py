"""Pictures of a demonstration set: a contact sheet, a video, a histogram of lengths."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure

from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.rendering.episode_renderer import episode_frames
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.video import Frame
from visualrhp.simulation import Physics, TransitionModel, make_action_space
from visualrhp.simulation.recording import MotionRecorder

_SHEET_ROWS, _SHEET_COLUMNS, _SHEET_SIZE_PX = 8, 8, 160


def contact_sheet(demonstrations: DemonstrationSet) -> Frame:
    """One row per demonstration: its first state, equally spaced states between, and its last; [H, W, 3] uint8."""
    rows = []
    for task, episode in itertools.islice(demonstrations, _SHEET_ROWS):
        last = len(episode)
        picked = sorted({round(last * column / (_SHEET_COLUMNS - 1)) for column in range(_SHEET_COLUMNS)})
        pictures = [
            render_frame(task.scene, episode.states[step], size_px=_SHEET_SIZE_PX, trail=episode.states[:step])
            for step in picked
        ]
        blank = np.full_like(pictures[0], pictures[0][0, 0])
        rows.append(np.hstack([*pictures, *[blank] * (_SHEET_COLUMNS - len(pictures))]))
    return np.vstack(rows)


def demonstration_frames(
    demonstrations: DemonstrationSet, physics: Physics, count: int, size_px: int, frames_per_action: int, hold: int
) -> Iterator[Frame]:
    """Frames of a video of the first ``count`` demonstrations.

    Args:
        demonstrations: of the set.
        physics: with which they were generated; the actions are simulated again, to record the motions.
        count: number of demonstrations.
        size_px: height and width of the picture of the scene.
        frames_per_action: see :class:`~visualrhp.simulation.recording.MotionRecorder`.
        hold: number of repetitions of the last picture of each.

    Raises:
        ConfigError: a number of frames or the size is out of range.
        DataError: the demonstrations were generated with other physics.
    """
    action_space = make_action_space(demonstrations.action_space)
    for task, episode in itertools.islice(demonstrations, count):
        recorder = MotionRecorder(TransitionModel(task.scene, action_space, physics), frames_per_action)
        yield from episode_frames(
            task.scene,
            episode.states[0],
            recorder.record_episode(episode),
            title=f"K.RRT, {demonstrations.action_space}",
            outcome=episode.outcome,
            size_px=size_px,
            hold=hold,
        )


def length_histogram(lengths: Sequence[int], action_space: str) -> Figure:
    """Histogram of the number of actions of the demonstrations."""
    figure = Figure(figsize=(5.0, 3.0), layout="constrained")
    axes = figure.add_subplot()
    axes.hist(lengths, bins=range(max(lengths) + 2), align="left", color="#0072b2", rwidth=0.9)
    axes.set_xlabel("Actions of a demonstration")
    axes.set_ylabel("Demonstrations")
    mean = sum(lengths) / len(lengths)
    axes.set_title(f"{len(lengths)} demonstrations, {action_space}: {mean:.1f} actions on average", fontsize="medium")
    axes.spines[["top", "right"]].set_visible(False)
    return figure
