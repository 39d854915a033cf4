"""Videos of episodes: frames, encoded films, several films side by side."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from visualrhp.execution.episode import EpisodeResult
from visualrhp.files import atomic_path
from visualrhp.planning.planner import Decision
from visualrhp.rendering.drawing import DEFAULT_SIZE_PX
from visualrhp.rendering.episode_renderer import episode_frames
from visualrhp.rendering.imagined import ImaginedPath
from visualrhp.rendering.pictures import encode_picture
from visualrhp.rendering.video import Frame, read_video, side_by_side, write_video
from visualrhp.simulation.recording import MotionRecorder
from visualrhp.simulation.transition_model import TransitionModel


@dataclass(frozen=True)
class Film:
    """An encoded video.

    Attributes:
        data: content of a .webm file.
        poster: last frame, as the content of a .webp file.
        width, height: [px].
    """

    data: bytes = field(repr=False)
    poster: bytes = field(repr=False)
    width: int
    height: int


def film_episode(
    result: EpisodeResult,
    model: TransitionModel,
    *,
    title: str = "",
    max_steps: int | None = None,
    size_px: int = DEFAULT_SIZE_PX,
    frames_per_action: int = 6,
    imagined_frames: int = 0,
    hold: int = 18,
    show_observation: bool = False,
    show_inset: bool = False,
) -> Iterator[Frame]:
    """Frames of a video of an episode. Its actions are simulated again, to record the poses during the motions.

    Args:
        result: of the episode.
        model: of the world. Its scene is the true one, which differs from the one that the planner observes if there is
            noise (Sec. 8.2).
        title: of the caption; an empty one leaves the caption out.
        max_steps: the action limit, for the caption.
        size_px: height and width of the picture of the scene.
        frames_per_action: frames of the commanded motion of an action; while the world comes to rest, further ones
            follow at the same rate.
        imagined_frames: frames of the roll-outs of the planner before each action; 0 leaves them and the bar of their
            returns out.
        hold: how often the last frame is repeated.
        show_observation: whether a panel shows the label image.
        show_inset: whether an inset shows the label image.

    Raises:
        ConfigError: a number of frames or the size is out of range.
        DataError: the episode did not happen in the world of ``model``.
    """
    motions = MotionRecorder(model, frames_per_action).record_episode(result.episode)
    imagined = [imagined_paths(timed.decision) for timed in result.decisions] if imagined_frames else None
    return episode_frames(
        model.scene,
        result.episode.states[0],
        motions,
        title=title,
        outcome=result.outcome,
        max_steps=max_steps,
        imagined=imagined,
        decision_s=[timed.time_s for timed in result.decisions],
        size_px=size_px,
        imagined_frames=max(1, imagined_frames),
        hold=hold,
        show_observation=show_observation,
        show_inset=show_inset,
        believed_scene=result.scene,
    )


def imagined_paths(decision: Decision) -> list[ImaginedPath]:
    """The roll-outs of a decision as paths to draw."""
    return [
        ImaginedPath(rollout.states, rollout.total_return, number == decision.chosen)
        for number, rollout in enumerate(decision.rollouts)
    ]


def encode_film(frames: Iterable[Frame], fps: float) -> Film:
    """Encode a video in memory.

    Raises:
        ConfigError: ``fps`` is not positive.
        DataError: there are no frames, or this build of OpenCV cannot encode them.
    """
    last: Frame | None = None

    def remembered() -> Iterator[Frame]:
        nonlocal last
        for frame in frames:
            last = frame
            yield frame

    with tempfile.TemporaryDirectory() as folder:  # OpenCV writes to files only
        path = Path(folder) / "film.webm"
        write_video(path, remembered(), fps)
        data = path.read_bytes()
    assert last is not None  # a video without frames is an error above
    height, width = last.shape[:2]
    return Film(data, encode_picture(last, ".webp"), width, height)


def write_comparison(films: Sequence[Film], path: Path, fps: float, *, columns: int = 3, cell_px: int = 360) -> None:
    """Write a video in which several films play at once, row by row.

    Args:
        films: at least one, all of one size.
        path: a file name that ends in ``.webm``; or in ``.webp`` for a picture that moves in a loop, which pages show
            without a player.
        fps: frames a second.
        columns: of the grid.
        cell_px: width to which wider films are reduced.
    """
    decoded = []
    with tempfile.TemporaryDirectory() as folder:
        for number, film in enumerate(films):
            source = Path(folder) / f"{number}.webm"
            source.write_bytes(film.data)
            decoded.append([_reduced(frame, cell_px) for frame in read_video(source)])
    frames = side_by_side(decoded, columns=min(columns, len(decoded)))
    if path.suffix == ".webp":
        _write_loop(path, frames, fps)
    else:
        write_video(path, frames, fps)


def _reduced(frame: Frame, width: int) -> Frame:
    scale = min(1.0, width / frame.shape[1])
    size = (round(scale * frame.shape[1]), round(scale * frame.shape[0]))
    return np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _write_loop(path: Path, frames: Iterable[Frame], fps: float) -> None:
    from PIL import Image

    first, *others = (Image.fromarray(frame) for frame in frames)
    options = {"duration": round(1e3 / fps), "loop": 0, "quality": 60, "method": 4}
    with atomic_path(path) as temporary:
        first.save(temporary, format="WEBP", save_all=True, append_images=others, **options)
