"""A film of an episode in a robot cell: what the camera saw, what the planner imagined, and the cell from the side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.kinds import widest_section
from visualrhp.embodiment.looking import SeenScene
from visualrhp.embodiment.perception import SeenObject, View
from visualrhp.embodiment.robot_cell import ArmState, CameraFrame, GripperState, JointTrajectory, RobotCell
from visualrhp.errors import ConfigError
from visualrhp.execution.episode import EpisodeListener, TimedDecision
from visualrhp.rendering.drawing import BACKGROUND, DESIRED, GRIPPER, INK, OBSTACLE, text
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.imagined import ImaginedPath
from visualrhp.rendering.legend import meaning_bar, rollout_bar, scale_height
from visualrhp.rendering.panels import Caption, caption_bar
from visualrhp.rendering.video import Frame
from visualrhp.types import FloatArray, Outcome, State

_FEW_PIXELS = 64


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The cell at one time: the camera's image, and that from the side if there is one."""

    time_s: float
    image: Frame
    side: Frame | None


class FilmedCell(RobotCell):
    """A robot cell that takes pictures of itself while time passes, and behaves as the one that it wraps.

    Args:
        cell: the cell.
        fps: pictures per second of the cell's clock.
        picture: returns the camera's image, without an effect on the frames that perception gets; None for
            ``cell.frame``.
        side_view: returns a picture of the cell from the side; None if there is none.

    Attributes:
        snapshots: since they were last removed.

    Raises:
        ConfigError: ``fps`` is not positive.
    """

    def __init__(
        self,
        cell: RobotCell,
        fps: float = 10.0,
        picture: Callable[[], Frame] | None = None,
        side_view: Callable[[], Frame] | None = None,
    ) -> None:
        if not fps > 0.0:
            raise ConfigError(f"fps={fps!r:.60}: a film needs a positive number of pictures per second")
        self.snapshots: list[Snapshot] = []
        self._cell = cell
        self._period = 1.0 / fps
        self._picture = picture or (lambda: cell.frame().image)
        self._side_view = side_view
        self._next = cell.now()

    def now(self) -> float:
        return self._cell.now()

    def wait(self, duration_s: float) -> None:
        remaining = duration_s
        while (until := self._next - self._cell.now()) <= remaining:
            until = max(until, 0.0)
            self._cell.wait(until)
            remaining -= until
            self.take_picture()
        self._cell.wait(max(remaining, 0.0))

    def take_picture(self) -> Snapshot:
        """Take a picture now; the next one follows after one period."""
        side = None if self._side_view is None else self._side_view()
        self.snapshots.append(Snapshot(self._cell.now(), self._picture(), side))
        self._next = self._cell.now() + self._period
        return self.snapshots[-1]

    def frame(self) -> CameraFrame:
        return self._cell.frame()

    def arm(self) -> ArmState:
        return self._cell.arm()

    def gripper(self) -> GripperState:
        return self._cell.gripper()

    def follow(self, trajectory: JointTrajectory) -> None:
        self._cell.follow(trajectory)

    def move_gripper(self, opening: float) -> None:
        self._cell.move_gripper(opening)

    def stop(self) -> None:
        self._cell.stop()

    def close(self) -> None:
        self._cell.close()


class FilmRecorder(EpisodeListener):
    """Makes the frames of a film from an episode: three square pictures in a row, below a caption.

    Left, the camera's image, with what was detected while the planner decides; in the middle, the scene of the planner
    with its roll-outs and the label image; right, the cell from the side. Below, the returns of the roll-outs and what
    the colours mean.

    Args:
        cell: takes the pictures.
        view: returns what was seen last.
        camera: of the images; None where there is none.
        title: of the caption.
        max_steps: the action limit.
        imagined: returns the roll-outs of a decision to draw.
        size_px: side of each picture [px].
        decision_frames: how often the picture of a decision is repeated.
        hold: how often the last picture is repeated.
    """

    def __init__(
        self,
        cell: FilmedCell,
        view: Callable[[], SeenScene],
        camera: Camera | None,
        title: str,
        max_steps: int,
        imagined: Callable[[TimedDecision], Sequence[ImaginedPath]],
        *,
        size_px: int = 400,
        decision_frames: int = 8,
        hold: int = 15,
    ) -> None:
        if size_px < _FEW_PIXELS:
            raise ConfigError(f"size_px={size_px}: a picture needs at least {_FEW_PIXELS} pixels")
        self._cell, self._view, self._camera, self._imagined = cell, view, camera, imagined
        self._title, self._max_steps = title, max_steps
        self._size, self._decision_frames, self._hold = size_px, decision_frames, hold
        self._states: list[State] = []
        self._paths: Sequence[ImaginedPath] = ()
        self._decision_s: float | None = None
        self._frames: list[bytes] = []  # JPEG: of a long episode, there are thousands
        self._has_ended = False

    def observed(self, state: State, outcome: Outcome | None) -> None:
        planned = self._planned(())
        self._show_motion(planned)
        self._states.append(state)
        if outcome is not None:
            self._end(outcome)

    def decided(self, decision: TimedDecision) -> None:
        self._paths, self._decision_s = self._imagined(decision), decision.time_s
        picture = self._compose(self._cell.take_picture(), self._planned(self._paths), marked=True)
        self._cell.snapshots.clear()
        self._show(picture, self._decision_frames)

    def end(self, outcome: Outcome) -> None:
        """Show the end of the episode, if no observed state was the last: it was stopped by a fault, for instance."""
        if self._has_ended:
            return
        self._show_motion(self._planned(()))
        self._end(outcome)

    @property
    def frames(self) -> Iterator[Frame]:
        """Frames so far, all of one size."""
        for data in self._frames:
            picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
            assert picture is not None  # it was encoded by this object
            yield np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), dtype=np.uint8)

    def _show(self, picture: Frame, times: int = 1) -> None:
        _, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 95])
        self._frames += [data.tobytes()] * times

    def _end(self, outcome: Outcome) -> None:
        self._has_ended = True
        picture = self._compose(self._cell.take_picture(), self._planned(()), marked=True, outcome=outcome)
        self._cell.snapshots.clear()
        self._show(picture, self._hold)

    def _show_motion(self, planned: Frame) -> None:
        if self._states:
            for snapshot in self._cell.snapshots:
                self._show(self._compose(snapshot, planned))
        self._cell.snapshots.clear()

    def _planned(self, paths: Sequence[ImaginedPath]) -> Frame:
        if not self._states:
            return np.full((self._size, self._size, 3), BACKGROUND, dtype=np.uint8)
        state, trail = self._states[-1], self._states[:-1]
        return render_frame(
            self._view().scene,
            state,
            size_px=self._size,
            trail=[past for past in trail if past.num_objects == state.num_objects],
            imagined=paths or None,
            show_inset=True,
        )[: self._size, : self._size]

    def _compose(
        self, snapshot: Snapshot, planned: Frame, *, marked: bool = False, outcome: Outcome | None = None
    ) -> Frame:
        image, view = snapshot.image, self._view()
        if marked and isinstance(view, View) and self._camera is not None:
            image = annotated(image, view, self._camera)
        parts = [_square(image, self._size), planned]
        if snapshot.side is not None:
            parts.append(_square(snapshot.side, self._size))
        row = np.concatenate(parts, axis=1)
        caption = Caption(self._title, max(0, len(self._states) - 1), self._max_steps, outcome)
        width = row.shape[1]
        bars = [
            caption_bar(caption, self._size, width),
            row,
            rollout_bar(view.scene, self._paths, scale_height(self._size), width, self._decision_s),
            meaning_bar(self._size, width, with_paths=True),
        ]
        return np.concatenate(bars, axis=0)


def annotated(image: Frame, view: View, camera: Camera) -> Frame:
    """The camera's image with the target region, the outlines of the objects and of the gripper that were found.

    Outlines are drawn at the height at which an object is widest.

    Args:
        image: [H, W, 3] uint8 RGB.
        view: what was seen.
        camera: of the image.
    """
    picture = image.copy()
    angles = np.linspace(0.0, 2.0 * np.pi, 49)
    rim = view.scene.target.position + view.scene.target.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    _polygon(picture, camera, rim, 0.0, (255, 255, 255))
    for outline in view.scene.gripper.outlines(view.state.gripper_pose, view.state.gripper_opening):
        _polygon(picture, camera, outline, 0.045, GRIPPER)
    for number, track in enumerate(view.tracks):
        colour = DESIRED if number == 0 else OBSTACLE
        place = _polygon(picture, camera, track.outline, _height(track), colour)
        label = track.kind.value + (" (held)" if track.is_held else " (hidden)" if track.is_hidden else "")
        px = max(10, image.shape[0] // 36)
        x, y = np.round(place).astype(int).tolist()
        for offset, ink in ((1, INK), (0, (255, 255, 255))):
            text(picture, label, x + offset, y + offset, ink, px, 600)
    return picture


def _height(track: SeenObject) -> float:
    extent = float(np.ptp(track.outline, axis=0).min())
    section = widest_section(track.kind, track.is_lying, extent)
    return 0.5 * (section.low + section.high)


def _polygon(
    picture: Frame, camera: Camera, outline: FloatArray, height: float, colour: tuple[int, int, int]
) -> FloatArray:
    """Draw an outline [V, 2] in the world frame at a height [m]; return the mean of its vertices [2] [px]."""
    points = np.concatenate([outline, np.full((len(outline), 1), height)], axis=1)
    pixels = camera.project(points)
    fixed = np.round(pixels * 16.0).astype(np.int32)
    cv2.polylines(picture, [fixed], True, colour, 2, cv2.LINE_AA, 4)
    return pixels.mean(axis=0)


def _square(image: Frame, size_px: int) -> Frame:
    """The middle of an image, scaled to a square."""
    height, width = image.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    middle = image[top : top + side, left : left + side]
    scaled = cv2.resize(middle, (size_px, size_px), interpolation=cv2.INTER_AREA)
    return np.asarray(scaled, dtype=np.uint8)
