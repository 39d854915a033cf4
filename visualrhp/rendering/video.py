"""VP8 ``.webm`` videos, which browsers, and thus MLflow's pages, play without a plug-in.

VP8 rather than VP9: with OpenCV's settings, VP9 takes three to five times as long for files that are 10% smaller.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.errors import ConfigError, DataError
from visualrhp.files import atomic_path, detect_full_disk

Frame = npt.NDArray[np.uint8]
"""A picture: [H, W, 3] uint8, RGB, row 0 at the top."""

_TRACK_UID = b"\x73\xc5\x88"  # Matroska's element id of a track's UID, and the length of the UID, 8 bytes
_HEADER_BYTES = 1024


def write_video(path: str | os.PathLike[str], frames: Iterable[Frame], fps: float = 12.0) -> int:
    """Encode ``frames`` at ``fps`` frames per second, atomically; equal frames give equal bytes.

    Args:
        path: a file name that ends in ``.webm``; missing folders are created.
        frames: at least one, all of the same size. Chroma is stored for 2 x 2 pixels, so an odd width or height is
            padded by repeating the last column or row.

    Returns:
        The number of frames written.

    Raises:
        ConfigError: the suffix is another one, or ``fps`` is not positive.
        DataError: no frames, frames that differ in size or are not RGB bytes, or no VP8 encoder in this OpenCV.
        OSError: the disk is full.
    """
    if Path(path).suffix != ".webm":
        raise ConfigError(f"{path}: videos are written as VP8 in a .webm file; choose a name that ends in .webm")
    if not fps > 0.0:
        raise ConfigError(f"fps={fps}: a video needs a positive number of frames per second")
    remaining = iter(frames)
    first = next(remaining, None)
    if first is None:
        raise DataError(f"{path}: a video needs at least one frame")
    with atomic_path(path) as temporary, detect_full_disk(temporary.parent):  # OpenCV does not report it
        height, width = _checked(first, first.shape, path).shape[:2]
        size = (width + width % 2, height + height % 2)
        with _quiet_stderr():  # OpenCV warns that "VP80" is not WebM's tag for VP8, but encodes correctly
            writer = cv2.VideoWriter(str(temporary), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"VP80"), fps, size)
        if not writer.isOpened():
            raise DataError(
                f"{path}: this build of OpenCV ({cv2.__version__}) cannot write VP8 .webm videos with FFmpeg"
            )
        count = 0
        try:
            for frame in _chain(first, remaining):
                even = np.pad(
                    _checked(frame, first.shape, path), ((0, height % 2), (0, width % 2), (0, 0)), mode="edge"
                )
                writer.write(cv2.cvtColor(even, cv2.COLOR_RGB2BGR))
                count += 1
        finally:
            writer.release()
        _fix_track_identity(temporary)
    return count


def read_video(path: str | os.PathLike[str]) -> list[Frame]:
    """Decode all frames of a video (lossy: within a few grey levels of the written frames).

    Raises:
        DataError: the file is missing or is not a video that OpenCV can decode.
    """
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG) if Path(path).is_file() else None
    frames = []
    while capture is not None:
        decoded, frame = capture.read()
        if not decoded:
            capture.release()
            break
        frames.append(np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB), dtype=np.uint8))
    if not frames:
        raise DataError(f"{path} is missing or is not a video that can be decoded")
    return frames


def side_by_side(
    videos: Sequence[Sequence[Frame]], columns: int | None = None, gap: int = 8, background: int = 255
) -> Iterator[Frame]:
    """Combine videos into a grid, row by row; a video that has ended shows its last frame.

    Args:
        videos: at least one, each of at least one frame; all frames of one size.
        columns: number of columns; by default, all videos are in one row.
        gap: width between the cells [px].
        background: grey level of the gaps and of empty cells.

    Raises:
        ConfigError: ``columns`` is not positive.
        DataError: no videos, one without frames, or frames that differ in size.
    """
    if not videos or any(len(video) == 0 for video in videos):
        raise DataError("a grid of videos needs at least one video, and each of them at least one frame")
    if len({frame.shape for video in videos for frame in video}) > 1:
        raise DataError("the videos of a grid must have frames of one size")
    columns = len(videos) if columns is None else columns
    if columns < 1:
        raise ConfigError(f"columns={columns}: a grid has at least one column")
    rows = -(-len(videos) // columns)
    height, width = videos[0][0].shape[:2]
    for index in range(max(len(video) for video in videos)):
        grid = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), background, dtype=np.uint8)
        for cell, video in enumerate(videos):
            top, left = cell // columns * (height + gap), cell % columns * (width + gap)
            grid[top : top + height, left : left + width] = video[min(index, len(video) - 1)]
        yield grid


def _chain(first: Frame, rest: Iterator[Frame]) -> Iterator[Frame]:
    yield first
    yield from rest


def _checked(frame: Frame, shape: tuple[int, ...], path: str | os.PathLike[str]) -> Frame:
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3 or frame.shape != shape:
        raise DataError(
            f"{path}: a frame is {frame.dtype} {list(frame.shape)}; all frames must be uint8 [height, width, 3] and of "
            "one size"
        )
    return frame


def _fix_track_identity(path: Path) -> None:
    """Overwrite the random UID that FFmpeg gives a track, so that a video is a function of its frames only."""
    content = path.read_bytes()
    start = content.find(_TRACK_UID, 0, _HEADER_BYTES)
    if start >= 0:
        identity = content[start + 3 : start + 11]
        path.write_bytes(content.replace(identity, b"\x01" * 8))


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Discard what native code writes to the standard error stream."""
    saved = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)
