"""Pictures of a task for people to look at: anti-aliased frames of a scene, its history and what the robot sees.

The world frame (x right, y up, metres) appears with y up; pixels exist only in this package. Colours follow the paper's
labels (Sec. 5.1: desired object light green, obstacles red, robot blue, target region dark green) in softer tones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from visualrhp.errors import ConfigError
from visualrhp.rendering.label_image import PALETTE, label_image
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene, geometry
from visualrhp.types import FloatArray, State, wrap_angle

Outcome = Literal["success", "dropped", "out of actions", "no plan", "plan failed", "diverged"]

Colour = tuple[int, int, int]

BACKGROUND: Colour = (233, 236, 241)
SURFACE: Colour = (253, 249, 240)
EDGE: Colour = (52, 58, 68)
GRID: Colour = (240, 233, 218)
PAPER: Colour = (253, 253, 254)
TARGET: Colour = (24, 108, 68)
DESIRED: Colour = (96, 200, 92)
OBSTACLE: Colour = (222, 92, 84)
ROBOT: Colour = (56, 112, 196)
FINGER: Colour = (36, 78, 150)
INK: Colour = (33, 37, 44)
FAINT_INK: Colour = (108, 116, 128)
OUTCOME_COLOURS: dict[Outcome, Colour] = {
    "success": (22, 128, 72),
    "dropped": (196, 52, 48),
    "out of actions": (176, 112, 8),
    "no plan": (176, 112, 8),
    "plan failed": (176, 112, 8),
    "diverged": (112, 60, 140),
}

MARGIN = 0.1
"""Width of the border around the surface that a frame shows [m]: the gripper often reaches beyond the edges."""

_SUPERSAMPLING = 2
_SHIFT = 5  # OpenCV's fixed-point coordinates: fractional bits
_GRID_STEP = 0.1
_MIN_SIZE = 64


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
    caption: Caption | None = None,
    show_observation: bool = False,
) -> Frame:
    """Draw a state of a scene.

    Args:
        scene: what to draw.
        state: where everything is.
        size_px: height and width of the picture of the scene; the caption adds a bar above it, and the observation a
            panel to its right.
        trail: earlier states, oldest first; the paths of the gripper and of the desired object are drawn through them
            and fade with age.
        caption: words for the bar; none leaves the bar out.
        show_observation: whether to add the abstract label image (Sec. 5.1), enlarged pixel by pixel.

    Returns:
        [H, W, 3] uint8 RGB, H and W even; H = W = ``size_px`` (rounded up to even) without caption and observation.

    Raises:
        ConfigError: ``size_px`` is below 64.
    """
    return _render(_Canvas(scene, size_px), state, trail, caption, show_observation)


def episode_frames(
    scene: Scene,
    states: Sequence[State],
    *,
    title: str = "",
    outcome: Outcome | None = None,
    max_steps: int | None = None,
    size_px: int = 480,
    frames_per_action: int = 6,
    hold: int = 18,
    show_observation: bool = False,
) -> Iterator[Frame]:
    """Frames of a video of an episode: its states, joined by in-between pictures, then ``hold`` frames of its end.

    A state is at rest and the motion between two of them is not recorded, so the pictures in between interpolate the
    poses (an aid to the eye, not physics; the label image is always that of the last state at rest).

    Args:
        scene: the scene in which the episode ran.
        states: L + 1 states, the first one initial.
        title: of the caption; none leaves the caption out.
        outcome: shown in the caption from the last state on.
        max_steps: the action limit, for the caption.
        size_px: see :func:`render_frame`.
        frames_per_action: pictures for each action, the state that it leads to included.
        hold: how often the last picture is repeated.
        show_observation: see :func:`render_frame`.

    Raises:
        ConfigError: ``frames_per_action`` is not positive, or see :func:`render_frame`.
    """
    if frames_per_action < 1:
        raise ConfigError(f"frames_per_action={frames_per_action}: at least one picture for each action is needed")
    canvas = _Canvas(scene, size_px)

    def draw(state: State, past: Sequence[State], step: int, ended: bool) -> Frame:
        caption = Caption(title, step, max_steps, outcome if ended else None) if title else None
        return _render(canvas, state, past, caption, show_observation)

    last = len(states) - 1
    picture = draw(states[0], (), 0, last == 0)
    yield picture
    for step in range(1, last + 1):
        for part in range(1, frames_per_action + 1):
            state = interpolate(states[step - 1], states[step], part / frames_per_action)
            picture = draw(state, states[:step], step, step == last and part == frames_per_action)
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


class _Canvas:
    """Shapes in metres on a supersampled picture of a scene's surface."""

    def __init__(self, scene: Scene, size_px: int) -> None:
        if size_px < _MIN_SIZE:
            raise ConfigError(f"size_px={size_px}: a frame needs at least {_MIN_SIZE} pixels a side")
        size_px += size_px % 2
        self.scene = scene
        self.size_px = size_px
        low, high = scene.edges.min(axis=0), scene.edges.max(axis=0)
        extent = float((high - low).max()) + 2.0 * MARGIN
        self.pixels_per_metre = size_px * _SUPERSAMPLING / extent
        self._left_top = (low + high) / 2.0 + np.array([-extent, extent]) / 2.0
        side = size_px * _SUPERSAMPLING
        self.picture = np.full((side, side, 3), BACKGROUND, dtype=np.uint8)
        _draw_surface(self, scene)
        self._surface = self.picture.copy()

    def fixed_point(self, points: FloatArray) -> np.ndarray:
        """[N, 2] int32 pixel coordinates with fractional bits; the centre of pixel (0, 0) is (0, 0)."""
        pixels = (points - self._left_top) * (self.pixels_per_metre, -self.pixels_per_metre) - 0.5
        return np.round(pixels * (1 << _SHIFT)).astype(np.int32)

    def thickness(self, width: float) -> int:
        """Pixels of a line ``width`` [m] wide, at least one."""
        return max(1, round(width * self.pixels_per_metre))

    def polygon(self, points: FloatArray, fill: Colour, outline: Colour | None = None, width: float = 0.0016) -> None:
        corners = self.fixed_point(points)
        cv2.fillPoly(self.picture, [corners], fill, cv2.LINE_AA, _SHIFT)
        if outline is not None:
            cv2.polylines(self.picture, [corners], True, outline, self.thickness(width), cv2.LINE_AA, _SHIFT)

    def line(self, points: FloatArray, colour: Colour, width: float) -> None:
        cv2.polylines(
            self.picture, [self.fixed_point(points)], False, colour, self.thickness(width), cv2.LINE_AA, _SHIFT
        )

    def disc(self, centre: FloatArray, radius: float, colour: Colour, width: float | None = None) -> None:
        """A filled disc, or a ring of ``width`` [m]."""
        x, y = self.fixed_point(np.asarray(centre, dtype=np.float64)[None])[0]
        thickness = -1 if width is None else self.thickness(width)
        pixels = round(radius * self.pixels_per_metre * (1 << _SHIFT))
        cv2.circle(self.picture, (int(x), int(y)), pixels, colour, thickness, cv2.LINE_AA, _SHIFT)

    def clear(self) -> None:
        """Leave nothing but the surface."""
        np.copyto(self.picture, self._surface)

    def finished(self) -> Frame:
        """The picture in its final size."""
        small = cv2.resize(self.picture, (self.size_px, self.size_px), interpolation=cv2.INTER_AREA)
        return np.asarray(small, dtype=np.uint8)


def _render(
    canvas: _Canvas, state: State, trail: Sequence[State], caption: Caption | None, show_observation: bool
) -> Frame:
    """See :func:`render_frame`; a canvas serves many frames of its scene."""
    scene, size_px = canvas.scene, canvas.size_px
    canvas.clear()
    _draw_bodies(canvas, state, trail)
    picture = canvas.finished()
    if show_observation:
        picture = np.concatenate([picture, _observation_panel(scene, state, size_px)], axis=1)
    if caption is not None:
        picture = np.concatenate([_caption_bar(caption, size_px, picture.shape[1]), picture], axis=0)
    return picture


def _draw_bodies(canvas: _Canvas, state: State, trail: Sequence[State]) -> None:
    scene = canvas.scene
    outlines = [
        geometry.to_world(shape.outline, pose) for shape, pose in zip(scene.objects, state.object_poses, strict=True)
    ]
    gripper = scene.gripper.outlines(state.robot_pose, state.gripper_opening)
    _draw_shadows(canvas, [*outlines, *gripper])
    path = [*trail, state]
    _draw_path(canvas, np.array([past.object_poses[0, :2] for past in path]), _mix(DESIRED, INK, 0.25))
    for outline in outlines[1:]:
        canvas.polygon(outline, OBSTACLE, _mix(OBSTACLE, INK, 0.45))
    canvas.polygon(outlines[0], DESIRED, _mix(DESIRED, INK, 0.5), width=0.0022)
    centre = state.object_poses[0, :2]
    canvas.disc(centre, 0.0045, _mix(DESIRED, INK, 0.6))  # the centre is what has to reach the target region
    _draw_path(canvas, np.array([past.robot_pose[:2] for past in path]), ROBOT)
    palm, left, right = gripper
    for finger in (left, right):
        canvas.polygon(finger, FINGER, _mix(FINGER, INK, 0.5))
    canvas.polygon(palm, ROBOT, _mix(ROBOT, INK, 0.5))
    _draw_palm_details(canvas, palm)


def _draw_surface(canvas: _Canvas, scene: Scene) -> None:
    canvas.polygon(scene.edges + np.array([0.004, -0.006]), _mix(BACKGROUND, INK, 0.14))
    canvas.polygon(scene.edges, SURFACE)
    low, high = scene.edges.min(axis=0), scene.edges.max(axis=0)
    surface = canvas.picture.copy()
    for axis in range(2):
        for offset in np.arange(np.ceil(low[axis] / _GRID_STEP) * _GRID_STEP, high[axis], _GRID_STEP):
            ends = np.array([low, high])
            ends[:, axis] = offset
            canvas.line(ends, GRID, 0.0012)
    mask = np.zeros(surface.shape[:2], dtype=np.uint8)
    cv2.fillPoly(mask, [canvas.fixed_point(scene.edges)], 255, cv2.LINE_8, _SHIFT)
    canvas.picture[mask == 0] = surface[mask == 0]  # a surface need not be a rectangle
    with_target = canvas.picture.copy()
    target = scene.target
    canvas.disc(target.position, target.radius, TARGET)
    cv2.addWeighted(with_target, 0.78, canvas.picture, 0.22, 0.0, canvas.picture)
    canvas.disc(target.position, target.radius, TARGET, width=0.003)
    arm = np.array([[-0.009, 0.0], [0.009, 0.0]])
    for cross in (arm, arm[:, ::-1]):
        canvas.line(target.position + cross, TARGET, 0.0022)
    canvas.line(np.vstack([scene.edges, scene.edges[:1]]), EDGE, 0.004)


def _draw_shadows(canvas: _Canvas, outlines: Sequence[FloatArray]) -> None:
    """A soft shadow under everything that lies on the surface."""
    mask = np.zeros(canvas.picture.shape[:2], dtype=np.uint8)
    for outline in outlines:
        cv2.fillPoly(mask, [canvas.fixed_point(outline + np.array([0.003, -0.005]))], 70, cv2.LINE_AA, _SHIFT)
    mask = cv2.blur(mask, (canvas.thickness(0.008),) * 2)
    shade = cv2.cvtColor(255 - mask, cv2.COLOR_GRAY2RGB)
    cv2.multiply(canvas.picture, shade, canvas.picture, 1.0 / 255.0)


def _draw_path(canvas: _Canvas, positions: FloatArray, colour: Colour) -> None:
    """A polyline with a dot at each earlier position; the oldest part is the faintest."""
    count = len(positions) - 1
    if count < 1:
        return
    before = canvas.picture.copy()
    for index in range(count):
        faded = _mix(SURFACE, colour, 0.25 + 0.75 * (index + 1) / count)
        canvas.line(positions[index : index + 2], faded, 0.0026)
        canvas.disc(positions[index], 0.0034, faded)
    cv2.addWeighted(before, 0.35, canvas.picture, 0.65, 0.0, canvas.picture)


def _draw_palm_details(canvas: _Canvas, palm: FloatArray) -> None:
    """A lighter plate and the flange of the wrist, so that the gripper reads as one."""
    centre = palm.mean(axis=0)
    canvas.polygon(centre + 0.62 * (palm - centre), _mix(ROBOT, SURFACE, 0.22))
    canvas.disc(centre, 0.013, _mix(ROBOT, INK, 0.35))
    canvas.disc(centre, 0.008, _mix(ROBOT, SURFACE, 0.45))


def _caption_bar(caption: Caption, size_px: int, width: int) -> Frame:
    """A bar with the title on the left and the step count and outcome on the right."""
    height = max(24, round(0.085 * size_px))
    height += height % 2
    text_px = max(10, round(0.46 * height))
    bar = np.full((height, width, 3), PAPER, dtype=np.uint8)
    bar[-max(1, size_px // 320) :] = _mix(PAPER, INK, 0.15)
    margin = round(0.35 * height)
    right = width - margin
    baseline = round(0.5 * height + 0.36 * text_px)
    if caption.outcome is not None:
        label_width = _text_width(caption.outcome, text_px, 600)
        colour = OUTCOME_COLOURS[caption.outcome]
        _rounded_box(bar, right - label_width - margin, round(0.16 * height), right, round(0.84 * height), colour)
        _text(bar, caption.outcome, right - label_width - margin // 2, baseline, (255, 255, 255), text_px, 600)
        right -= label_width + 2 * margin
    if caption.step is not None:
        steps = f"{caption.step}" if caption.max_steps is None else f"{caption.step} / {caption.max_steps}"
        right -= _text_width(steps, text_px, 400)
        _text(bar, steps, right, baseline, FAINT_INK, text_px, 400)
    room = right - 2 * margin
    while text_px > 9 and _text_width(caption.title, text_px, 700) > room:
        text_px -= 1
    _text(bar, _shortened(caption.title, room, text_px, 700), margin, baseline, INK, text_px, 700)
    return bar


def _observation_panel(scene: Scene, state: State, height: int) -> Frame:
    """The abstract label image, every pixel of it a square, under its name."""
    labels = PALETTE[label_image(scene, state)]
    factor = max(1, height // 2 // labels.shape[0])
    image = labels.repeat(factor, axis=0).repeat(factor, axis=1)
    side = image.shape[0]
    margin = max(6, height // 40)
    text_px = max(10, height // 34)
    panel = np.full((height, side + 2 * margin + (side % 2), 3), BACKGROUND, dtype=np.uint8)
    top = 2 * margin + text_px
    panel[top - 2 : top + side + 2, margin - 2 : margin + side + 2] = _mix(BACKGROUND, INK, 0.35)
    panel[top : top + side, margin : margin + side] = image
    _text(
        panel, _shortened("what the robot sees", side, text_px, 600), margin, top - margin // 2 - 2, INK, text_px, 600
    )
    lines = [
        f"{labels.shape[0]} x {labels.shape[1]} labels, robot-centric",
        f"gripper {'closed' if state.gripper_closed else 'open'}, {1e3 * state.gripper_opening:.0f} mm",
        f"{1e2 * np.hypot(*(state.object_poses[0, :2] - scene.target.position)):.1f} cm to the target",
    ]
    for number, line in enumerate(lines):
        baseline = top + side + margin + text_px + round(1.45 * number * text_px)
        _text(panel, _shortened(line, side, text_px, 400), margin, baseline, FAINT_INK, text_px, 400)
    return panel


_FONT = cv2.FontFace("sans")


def _text(picture: Frame, text: str, x: int, baseline: int, colour: Colour, height_px: int, weight: int) -> None:
    cv2.putText(picture, text, (x, baseline), colour, _FONT, height_px, weight)


def _text_width(text: str, height_px: int, weight: int) -> int:
    _, _, width, _ = cv2.getTextSize((10_000, 1_000), text, (0, 0), _FONT, height_px, weight)
    return int(width)


def _shortened(text: str, width: int, height_px: int, weight: int) -> str:
    """``text``, or as much of its start as fits into ``width`` [px]."""
    if _text_width(text, height_px, weight) <= width:
        return text
    while text and _text_width(text + "...", height_px, weight) > width:
        text = text[:-1]
    return text.rstrip() + "..." if text else ""


def _rounded_box(picture: Frame, left: int, top: int, right: int, bottom: int, colour: Colour) -> None:
    radius = (bottom - top) // 2
    middle = top + radius
    cv2.rectangle(picture, (left + radius, top), (right - radius, top + 2 * radius), colour, -1)
    for x in (left + radius, right - radius):
        cv2.circle(picture, (x, middle), radius, colour, -1, cv2.LINE_AA)


def _mix(colour: Colour, other: Colour, share: float) -> Colour:
    """``colour`` with a ``share`` in [0, 1] of ``other``."""
    red, green, blue = (round((1.0 - share) * a + share * b) for a, b in zip(colour, other, strict=True))
    return red, green, blue
