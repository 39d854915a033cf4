"""Pictures of a task for people to look at: anti-aliased frames of a scene, its past, what the robot sees and thinks.

The world frame (x right, y up, metres) appears with y up; pixels exist only in this package.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from visualrhp.errors import ConfigError
from visualrhp.rendering.drawing import (
    BACKGROUND,
    DESIRED,
    FAINT_INK,
    FINGER,
    INK,
    OBSTACLE,
    PAPER,
    ROBOT,
    SURFACE,
    Canvas,
    Colour,
    mix,
    rounded_box,
    shortened,
    text,
    text_width,
)
from visualrhp.rendering.imagined import Box, ImaginedPath, draw_paths, draw_returns, legend_bar
from visualrhp.rendering.label_image import PALETTE, label_image
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene, geometry
from visualrhp.types import FloatArray, State, wrap_angle

Outcome = Literal["success", "dropped", "out of actions", "no plan", "plan failed", "diverged"]

OUTCOME_COLOURS: dict[Outcome, Colour] = {
    "success": (22, 128, 72),
    "dropped": (196, 52, 48),
    "out of actions": (176, 112, 8),
    "no plan": (176, 112, 8),
    "plan failed": (176, 112, 8),
    "diverged": (112, 60, 140),
}


@dataclass(frozen=True, slots=True)
class Caption:
    """Words above a frame.

    Attributes:
        title: usually the planner's name.
        step: actions executed so far.
        max_steps: the action limit.
        outcome: how the episode ended, once it has.
    """

    title: str
    step: int | None = None
    max_steps: int | None = None
    outcome: Outcome | None = None


def render_frame(
    scene: Scene,
    state: State,
    *,
    size_px: int = 480,
    trail: Sequence[State] = (),
    imagined: Sequence[ImaginedPath] | None = None,
    caption: Caption | None = None,
    show_observation: bool = False,
    show_inset: bool = False,
) -> Frame:
    """Draw a state of a scene.

    Args:
        scene: what to draw.
        state: where everything is.
        size_px: height and width of the picture of the scene; the caption adds a bar above it, the imagined paths one
            below it, and the observation a panel to its right.
        trail: earlier states, oldest first; the paths of the gripper and of the desired object are drawn through them
            and fade with age.
        imagined: a planner's roll-outs or its plan, drawn with their returns over the picture, with a legend below;
            an empty sequence gives an empty bar, None leaves the bar out.
        caption: words for the bar; none leaves the bar out.
        show_observation: whether to add the abstract label image (Sec. 5.1), enlarged pixel by pixel, as a panel.
        show_inset: whether to put the abstract label image into the corner of the picture where it hides least.

    Returns:
        [H, W, 3] uint8 RGB, H and W even; H = W = ``size_px`` (rounded up to even) with nothing added around it.

    Raises:
        ConfigError: ``size_px`` is below 64.
    """
    view = _View(scene, size_px, show_observation, show_inset)
    return view.draw(state, state, trail, caption, imagined or (), imagined, None)


class EpisodeRenderer:
    """Frames of an episode as it unfolds: what the planner imagines in a state, then the motion to the next one.

    A state is at rest and the motion between two of them is not recorded, so the pictures in between interpolate the
    poses (an aid to the eye, not physics; the label image is always that of the last state at rest).

    Args:
        scene: the scene in which the episode runs.
        state: the initial state.
        title: of the caption; none leaves the caption out.
        max_steps: the action limit, for the caption.
        size_px: see :func:`render_frame`.
        frames_per_action: pictures for each action, the state that it leads to included.
        imagined_frames: pictures of what the planner imagines before each action.
        show_imagined: whether there is a bar below the pictures for the legend of the imagined paths.
        show_observation: see :func:`render_frame`.
        show_inset: see :func:`render_frame`.
        believed_scene: the planner's model, whose shapes the label image shows, where it differs from the world
            (Sec. 8.2).

    Raises:
        ConfigError: ``frames_per_action`` or ``imagined_frames`` is not positive, or see :func:`render_frame`.
    """

    def __init__(
        self,
        scene: Scene,
        state: State,
        *,
        title: str = "",
        max_steps: int | None = None,
        size_px: int = 480,
        frames_per_action: int = 6,
        imagined_frames: int = 6,
        show_imagined: bool = False,
        show_observation: bool = False,
        show_inset: bool = False,
        believed_scene: Scene | None = None,
    ) -> None:
        for name, value in (("frames_per_action", frames_per_action), ("imagined_frames", imagined_frames)):
            if value < 1:
                raise ConfigError(f"{name}={value}: at least one picture for each action is needed")
        self._view = _View(scene, size_px, show_observation, show_inset, believed_scene)
        self._title = title
        self._max_steps = max_steps
        self._frames_per_action = frames_per_action
        self._imagined_frames = imagined_frames
        self._states = [state]
        self._legend: Sequence[ImaginedPath] | None = () if show_imagined else None
        self._decision_s: float | None = None

    def still(self, outcome: Outcome | None = None) -> Frame:
        """The current state, with how the episode ended if it has."""
        return self._draw(self._states[-1], outcome=outcome)

    def imagine(self, paths: Sequence[ImaginedPath], decision_s: float | None = None) -> Iterator[Frame]:
        """The roll-outs in the current state; their legend stays until the next ones. Nothing if there are none.

        Args:
            paths: of the roll-outs.
            decision_s: how long the planner took [s], which the legend says if it is given.
        """
        if self._legend is None or not paths:
            return
        self._legend, self._decision_s = paths, decision_s
        picture = self._draw(self._states[-1], paths)
        for _ in range(self._imagined_frames):
            yield picture

    def move(self, state: State, outcome: Outcome | None = None) -> Iterator[Frame]:
        """The motion from the current state to ``state``, which becomes the current one."""
        past = self._states[-1]
        for part in range(1, self._frames_per_action):
            yield self._draw(interpolate(past, state, part / self._frames_per_action), moving=True)
        self._states.append(state)
        yield self.still(outcome)

    def _draw(
        self,
        state: State,
        paths: Sequence[ImaginedPath] = (),
        *,
        moving: bool = False,
        outcome: Outcome | None = None,
    ) -> Frame:
        trail = self._states if moving else self._states[:-1]
        caption = Caption(self._title, len(trail), self._max_steps, outcome) if self._title else None
        return self._view.draw(state, self._states[-1], trail, caption, paths, self._legend, self._decision_s)


def episode_frames(
    scene: Scene,
    states: Sequence[State],
    *,
    title: str = "",
    outcome: Outcome | None = None,
    max_steps: int | None = None,
    imagined: Sequence[Sequence[ImaginedPath]] | None = None,
    decision_s: Sequence[float] | None = None,
    size_px: int = 480,
    frames_per_action: int = 6,
    imagined_frames: int = 6,
    hold: int = 18,
    show_observation: bool = False,
    show_inset: bool = False,
    believed_scene: Scene | None = None,
) -> Iterator[Frame]:
    """Frames of a video of an episode: its states, joined by in-between pictures, then ``hold`` frames of its end.

    Args:
        scene: the scene in which the episode ran.
        states: L + 1 states, the first one initial.
        title: of the caption; none leaves the caption out.
        outcome: shown in the caption from the last state on.
        max_steps: the action limit, for the caption.
        imagined: for each of the first states, up to all of them, the roll-outs that the planner compared there, or its
            plan; they are shown before the motion. None leaves the bar of their legend out.
        decision_s: how long the planner took in each of these states [s], for the legend.
        size_px: see :func:`render_frame`.
        frames_per_action: see :class:`EpisodeRenderer`.
        imagined_frames: see :class:`EpisodeRenderer`.
        hold: how often the last picture is repeated.
        show_observation: see :func:`render_frame`.
        show_inset: see :func:`render_frame`.
        believed_scene: see :class:`EpisodeRenderer`.

    Raises:
        ConfigError: ``frames_per_action`` or ``imagined_frames`` is not positive, or see :func:`render_frame`.
    """
    renderer = EpisodeRenderer(
        scene,
        states[0],
        title=title,
        max_steps=max_steps,
        size_px=size_px,
        frames_per_action=frames_per_action,
        imagined_frames=imagined_frames,
        show_imagined=imagined is not None,
        show_observation=show_observation,
        show_inset=show_inset,
        believed_scene=believed_scene,
    )
    last = len(states) - 1
    picture = renderer.still(outcome if last == 0 else None)
    yield picture
    for step in range(last + 1):
        if imagined is not None and step < len(imagined):
            yield from renderer.imagine(imagined[step], None if decision_s is None else decision_s[step])
        if step < last:
            for picture in renderer.move(states[step + 1], outcome if step + 1 == last else None):
                yield picture
    for _ in range(hold):
        yield picture


def interpolate(start: State, end: State, fraction: float) -> State:
    """A state between two: positions and the opening linearly, angles the short way round; ``fraction`` in [0, 1]."""
    if fraction >= 1.0:
        return end
    difference = end.vector - start.vector
    angles = np.r_[2, 7 : difference.size : 3]
    difference[angles] = wrap_angle(difference[angles])
    difference[4] = 0.0  # the command changes with the next action
    return State(start.vector + fraction * difference)


class _View:
    """Draws frames of one scene in one arrangement; keeps what they have in common."""

    def __init__(
        self, scene: Scene, size_px: int, show_observation: bool, show_inset: bool, believed_scene: Scene | None = None
    ) -> None:
        self.canvas = Canvas(scene, size_px)
        self.show_observation = show_observation
        self.believed_scene = believed_scene or scene
        self._corner: tuple[int, int] | None = (1, 0) if show_inset else None  # column and row, in halves

    def draw(
        self,
        state: State,
        observed: State,
        trail: Sequence[State],
        caption: Caption | None,
        paths: Sequence[ImaginedPath],
        legend: Sequence[ImaginedPath] | None,
        decision_s: float | None,
    ) -> Frame:
        """See :func:`render_frame`; ``observed`` is the state of the label image, ``legend`` the paths of the bar."""
        canvas, size_px = self.canvas, self.canvas.size_px
        canvas.clear()
        _draw_bodies(canvas, state, trail)
        draw_paths(canvas, paths)
        _point_to_gripper(canvas, state)
        picture = canvas.finished()
        taken = [self._draw_inset(picture, state, observed)] if self._corner is not None else []
        draw_returns(picture, canvas, paths, taken)
        if self.show_observation:
            panel = _observation_panel(canvas.scene, self.believed_scene, observed, size_px)
            picture = np.concatenate([picture, panel], axis=1)
        bars = [picture]
        if caption is not None:
            bars.insert(0, _caption_bar(caption, size_px, picture.shape[1]))
        if legend is not None:
            bars.append(legend_bar(canvas.scene, legend, _bar_height(size_px), picture.shape[1], decision_s))
        return np.concatenate(bars, axis=0) if len(bars) > 1 else picture

    def _draw_inset(self, picture: Frame, state: State, observed: State) -> Box:
        """Put the label image into the corner that hides least; it stays there as long as none is better."""
        labels = PALETTE[label_image(self.believed_scene, observed)]
        side = max(1, round(0.26 * self.canvas.size_px / labels.shape[0])) * labels.shape[0]
        border, margin = max(1, self.canvas.size_px // 240), max(2, self.canvas.size_px // 80)
        whole = side + 2 * border
        far = max(0, self.canvas.size_px - margin - whole)
        near = min(margin, far)

        def box(corner: tuple[int, int]) -> Box:
            left, top = (far if place else near for place in corner)
            return left, top, left + whole, top + whole

        points = self.canvas.frame_pixels(_points_to_see(self.canvas.scene, state))

        def hidden(corner: tuple[int, int]) -> int:
            left, top, right, bottom = box(corner)
            within = (points >= (left, top)).all(axis=1) & (points < (right, bottom)).all(axis=1)
            return int(np.count_nonzero(within))

        corners = [(1, 0), (0, 0), (1, 1), (0, 1)]
        current = self._corner or corners[0]
        best = min(corners, key=hidden)
        self._corner = current = best if hidden(best) < hidden(current) else current
        left, top, right, bottom = box(current)
        frame = np.empty((whole, whole, 3), dtype=np.uint8)
        frame[:] = mix(BACKGROUND, INK, 0.6)
        factor = side // labels.shape[0]
        frame[border : border + side, border : border + side] = labels.repeat(factor, axis=0).repeat(factor, axis=1)
        visible = picture[top:bottom, left:right]
        visible[:] = frame[: visible.shape[0], : visible.shape[1]]  # the smallest pictures have no room for all of it
        return left, top, right, bottom


def _points_to_see(scene: Scene, state: State) -> FloatArray:
    """[N, 2] points of the gripper, the objects and the target region."""
    around = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    return np.concatenate(
        [
            scene.target.position + scene.target.radius * np.stack([np.cos(around), np.sin(around)], axis=1),
            *scene.gripper.outlines(state.robot_pose, state.gripper_opening),
            *_object_outlines(scene, state),
        ]
    )


def _object_outlines(scene: Scene, state: State) -> list[FloatArray]:
    return [
        geometry.to_world(shape.outline, pose) for shape, pose in zip(scene.objects, state.object_poses, strict=True)
    ]


def _draw_bodies(canvas: Canvas, state: State, trail: Sequence[State]) -> None:
    scene = canvas.scene
    outlines = _object_outlines(scene, state)
    gripper = scene.gripper.outlines(state.robot_pose, state.gripper_opening)
    canvas.shade([*outlines, *gripper])
    path = [*trail, state]
    _draw_path(canvas, np.array([past.object_poses[0, :2] for past in path]), mix(DESIRED, INK, 0.25))
    for outline in outlines[1:]:
        canvas.polygon(outline, OBSTACLE, mix(OBSTACLE, INK, 0.45))
    canvas.polygon(outlines[0], DESIRED, mix(DESIRED, INK, 0.5), width=0.0022)
    centre = state.object_poses[0, :2]
    canvas.dot(centre, 0.0045, mix(DESIRED, INK, 0.6))  # the centre is what has to reach the target region
    _draw_path(canvas, np.array([past.robot_pose[:2] for past in path]), ROBOT)
    palm, left, right = gripper
    for finger in (left, right):
        canvas.polygon(finger, FINGER, mix(FINGER, INK, 0.5))
    canvas.polygon(palm, ROBOT, mix(ROBOT, INK, 0.5))
    _draw_palm_details(canvas, palm)


def _draw_path(canvas: Canvas, positions: FloatArray, colour: Colour) -> None:
    """A polyline with a dot at each earlier position; the oldest part is the faintest."""
    count = len(positions) - 1
    if count < 1:
        return
    before = canvas.picture.copy()
    for index in range(count):
        faded = mix(SURFACE, colour, 0.25 + 0.75 * (index + 1) / count)
        canvas.line(positions[index : index + 2], faded, 0.0026)
        canvas.dot(positions[index], 0.0034, faded)
    cv2.addWeighted(before, 0.35, canvas.picture, 0.65, 0.0, canvas.picture)


def _draw_palm_details(canvas: Canvas, palm: FloatArray) -> None:
    """A lighter plate and the flange of the wrist, so that the gripper reads as one."""
    centre = palm.mean(axis=0)
    canvas.polygon(centre + 0.62 * (palm - centre), mix(ROBOT, SURFACE, 0.22))
    canvas.disc(centre, 0.013, mix(ROBOT, INK, 0.35))
    canvas.disc(centre, 0.008, mix(ROBOT, SURFACE, 0.45))


def _point_to_gripper(canvas: Canvas, state: State) -> None:
    """An arrow at the border of the picture, towards a gripper that has left it."""
    points = np.concatenate(canvas.scene.gripper.outlines(state.robot_pose, state.gripper_opening))
    inset = canvas.size_of(0.03)
    low, high = canvas.bounds
    if ((points > low) & (points < high)).all(axis=1).any():
        return
    centre = points.mean(axis=0)
    place = np.clip(centre, low + inset, high - inset)
    heading = centre - place
    angle = float(np.arctan2(heading[1], heading[0]))
    arrow = canvas.size_of(1.0) * np.array([[0.022, 0.0], [-0.008, 0.016], [-0.002, 0.0], [-0.008, -0.016]])
    canvas.polygon(geometry.to_world(arrow, (*place, angle)), ROBOT, mix(ROBOT, INK, 0.5))


def _bar_height(size_px: int) -> int:
    height = max(24, round(0.085 * size_px))
    return height + height % 2


def _caption_bar(caption: Caption, size_px: int, width: int) -> Frame:
    """A bar with the title on the left and the step count and outcome on the right.

    Where there is no room for all of it, the outcome comes first, then the step, then as much of the title as fits.
    """
    height = _bar_height(size_px)
    text_px = max(10, round(0.46 * height))
    bar = np.full((height, width, 3), PAPER, dtype=np.uint8)
    bar[-max(1, size_px // 320) :] = mix(PAPER, INK, 0.15)
    margin = round(0.35 * height)
    right = width - margin
    if caption.outcome is not None:
        label_px = text_px
        while label_px > 6 and text_width(caption.outcome, label_px, 600) > width - 3 * margin:
            label_px -= 1
        label_width = text_width(caption.outcome, label_px, 600)
        colour = OUTCOME_COLOURS[caption.outcome]
        rounded_box(bar, right - label_width - margin, round(0.16 * height), right, round(0.84 * height), colour)
        baseline = round(0.5 * height + 0.36 * label_px)
        text(bar, caption.outcome, right - label_width - margin // 2, baseline, (255, 255, 255), label_px, 600)
        right -= label_width + 2 * margin
    baseline = round(0.5 * height + 0.36 * text_px)
    if caption.step is not None:
        limit = "" if caption.max_steps is None else f" / {caption.max_steps}"
        for steps in (f"{caption.step}{limit}", f"{caption.step}"):
            if right - text_width(steps, text_px, 400) >= margin:
                right -= text_width(steps, text_px, 400)
                text(bar, steps, right, baseline, FAINT_INK, text_px, 400)
                break
    room = right - 2 * margin
    while text_px > 9 and text_width(caption.title, text_px, 700) > room:
        text_px -= 1
    text(bar, shortened(caption.title, room, text_px, 700), margin, baseline, INK, text_px, 700)
    return bar


def _observation_panel(scene: Scene, believed_scene: Scene, state: State, height: int) -> Frame:
    """The abstract label image, every pixel of it a square, under its name and over as many facts as there is room."""
    labels = PALETTE[label_image(believed_scene, state)]
    factor = max(1, height // 2 // labels.shape[0])
    image = labels.repeat(factor, axis=0).repeat(factor, axis=1)
    side = image.shape[0]
    margin = max(6, height // 40)
    text_px = max(10, height // 34)
    panel = np.full((height, side + 2 * margin + (side % 2), 3), BACKGROUND, dtype=np.uint8)
    top = 2 * margin + text_px
    if top + side <= height:
        name = shortened("what the robot sees", side, text_px, 600)
        text(panel, name, margin, top - margin // 2 - 2, INK, text_px, 600)
    else:
        top = max(0, (height - side) // 2)
    panel[max(0, top - 2) : top + side + 2, margin - 2 : margin + side + 2] = mix(BACKGROUND, INK, 0.35)
    panel[top : top + side, margin : margin + side] = image
    lines = [
        f"{labels.shape[0]} x {labels.shape[1]} labels, robot-centric",
        f"gripper {'closed' if state.gripper_closed else 'open'}, {1e3 * state.gripper_opening:.0f} mm",
        f"{1e2 * np.hypot(*(state.object_poses[0, :2] - scene.target.position)):.1f} cm to the target",
    ]
    for line_number, line in enumerate(lines):
        baseline = top + side + margin + text_px + round(1.45 * line_number * text_px)
        if baseline + text_px // 3 <= height:
            text(panel, shortened(line, side, text_px, 400), margin, baseline, FAINT_INK, text_px, 400)
    return panel
