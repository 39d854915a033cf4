"""A planner's roll-outs drawn over a frame: their paths, coloured by their returns (Sec. 5.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from visualrhp.rendering.drawing import (
    INK,
    PAPER,
    TARGET,
    Canvas,
    Colour,
    text,
    text_width,
)
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene, geometry
from visualrhp.simulation import rules
from visualrhp.types import FloatArray, State

DROPPED: Colour = (200, 30, 30)
DIVERGED: Colour = (120, 122, 128)

# Cividis has no colour of the objects, and is the same for colour-blind readers.
_DARKEST, _BRIGHTEST = 0, 246  # of its 256 colours
_MAP = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], cv2.COLORMAP_CIVIDIS)[0, :, ::-1]
_STILL = 0.002
"""Paths of objects with a smaller displacement are not drawn [m]."""
_LEAST_SIZE_WITH_RETURNS = 200
_BOLD, _MEDIUM, _THIN = 0.0056, 0.0032, 0.0022
"""Widths of paths [m]."""
_FEW = 9
"""With more paths than this, only the chosen one is drawn in full."""
_MOST_RETURNS = 9
"""Labels in a picture."""


@dataclass(frozen=True, slots=True)
class ImaginedPath:
    """A roll-out of a planner, for display.

    Attributes:
        states: at least one. The first is the current state, or the one that a plan predicted for it.
        value: the return (Eq. 3); minus infinity if the physics diverged.
        is_chosen: whether its first action is the one that the planner takes.
    """

    states: tuple[State, ...]
    value: float
    is_chosen: bool = False

    @property
    def is_diverged(self) -> bool:
        """Whether the physics diverged, so that there is no return."""
        return not math.isfinite(self.value)


def share_of(value: float) -> float:
    """The place of a return on the colour scale, in [0, 1]; 1 is the goal after one action, 0 a drop at once or worse.

    The scale is the same in all pictures. It is logarithmic, since the returns near the goal differ by single actions:
    the goal after 1, 2, 5, 10, 20 actions is at 1, 0.82, 0.59, 0.41, 0.24.
    """
    best, worst = -rules.ACTION_REWARD, -rules.DROP_REWARD
    cost = min(max(-value, best), worst)
    return 1.0 - math.log(cost / best) / math.log(worst / best)


def colour_at(share: float) -> Colour:
    """A colour of the scale, from dark blue (0) to yellow (1), perceptually uniform (cividis)."""
    red, green, blue = _MAP[round(_DARKEST + share * (_BRIGHTEST - _DARKEST))].tolist()
    return red, green, blue


def colour_of(path: ImaginedPath) -> Colour:
    """The colour of a path: that of its return; grey if it diverged."""
    return DIVERGED if path.is_diverged else colour_at(share_of(path.value))


# --------------------------------------------------------------------------------------------------- over the picture
def draw_paths(canvas: Canvas, paths: Sequence[ImaginedPath]) -> None:
    """Draw the paths of the gripper and of the desired object, and their outlines at the end.

    The gripper's path is a line with a dot at every state, the largest at its end; the path of the desired object, if
    it moves, is dotted. The chosen path is bold and on top. A cross marks the end of a path that diverges (grey) or
    drops an object (red, at that object), a green ring the end of one that reaches the goal. Where there are many
    paths, only the chosen one has outlines, and the others are thinner and translucent.
    """
    colours = [colour_of(path) for path in paths]
    is_crowd = len(paths) > _FEW
    order = sorted(range(len(paths)), key=lambda i: (paths[i].is_chosen, paths[i].value))
    before = canvas.picture.copy()
    for i in order:
        if not paths[i].is_chosen and not is_crowd:
            _draw_ghost(canvas, paths[i], colours[i])
        elif not paths[i].is_chosen:
            _draw_path(canvas, paths[i], colours[i], _THIN)
    cv2.addWeighted(before, 0.45, canvas.picture, 0.55, 0.0, canvas.picture)
    for i in order:
        if paths[i].is_chosen:
            canvas.veil([(outline, colours[i]) for outline in _ghost(canvas.scene, paths[i])], 0.35)
            _draw_ghost(canvas, paths[i], colours[i])
    for i in order:
        if paths[i].is_chosen or not is_crowd:
            _draw_path(canvas, paths[i], colours[i], _BOLD if paths[i].is_chosen else _MEDIUM)
    for i in order:
        _draw_end(canvas, paths[i], colours[i], small=is_crowd and not paths[i].is_chosen)


def _draw_ghost(canvas: Canvas, path: ImaginedPath, colour: Colour) -> None:
    width = 0.0026 if path.is_chosen else 0.0016
    for outline in _ghost(canvas.scene, path):
        closed = np.vstack([outline, outline[:1]])
        canvas.line(closed, PAPER, width + 0.0018)
        canvas.line(closed, colour, width)


def _ghost(scene: Scene, path: ImaginedPath) -> list[FloatArray]:
    """Outlines of the gripper and of the objects that moved, at the end of a path."""
    end = path.states[-1]
    if len(path.states) == 1:
        return []
    outlines = list(scene.gripper.outlines(end.gripper_pose, end.gripper_opening))
    if _moves(path, 0):
        outlines.append(geometry.to_world(scene.objects[0].outline, end.object_poses[0]))
    fallen = [i for i in rules.dropped_objects(scene, end) if i > 0]
    return outlines + [geometry.to_world(scene.objects[i].outline, end.object_poses[i]) for i in fallen]


def _draw_path(canvas: Canvas, path: ImaginedPath, colour: Colour, width: float) -> None:
    gripper = np.array([state.gripper_position for state in path.states])
    casing = INK if path.is_chosen else PAPER
    if len(gripper) > 1:
        canvas.line(gripper, casing, width + 0.003)
        canvas.line(gripper, colour, width)
    for index, position in enumerate(gripper[1:], start=1):
        radius = (1.3 if index == len(gripper) - 1 else 0.75) * width
        canvas.dot(position, radius + 0.0015, casing)
        canvas.dot(position, radius, colour)
    if _moves(path, 0):
        desired = np.array([state.desired_position for state in path.states])
        for position in _beads(desired, canvas.size_of(0.0085 if path.is_chosen else 0.0075)):
            canvas.dot(position, 0.5 * width + 0.0013, casing)
            canvas.dot(position, 0.5 * width, colour)


def _draw_end(canvas: Canvas, path: ImaginedPath, colour: Colour, *, small: bool) -> None:
    size = 0.5 if small else 1.0
    end = path.states[-1]
    if path.is_diverged:
        _cross(canvas, end.gripper_position, DIVERGED, size)
        return
    for position in _fallen(canvas.scene, path):
        _cross(canvas, position, DROPPED, size)
    if rules.is_goal(canvas.scene, end) and not rules.is_dropped(canvas.scene, end):
        for radius, ring in ((0.0125, PAPER), (0.0115, TARGET), (0.008, PAPER), (0.007, colour)):
            canvas.dot(end.desired_position, size * radius, ring)


def _cross(canvas: Canvas, centre: FloatArray, colour: Colour, size: float) -> None:
    reach = canvas.size_of(0.011 * size)
    for width, ink in ((0.0085, PAPER), (0.005, colour)):
        for arm in ((1.0, 1.0), (1.0, -1.0)):
            ends = np.array([centre - np.multiply(arm, reach), centre + np.multiply(arm, reach)])
            canvas.line(ends, ink, size * width)


def _moves(path: ImaginedPath, index: int) -> bool:
    start = path.states[0]
    return any(
        math.hypot(*(state.object_positions[index] - start.object_positions[index])) > _STILL
        or abs(state.object_angles[index] - start.object_angles[index]) > 0.1
        for state in path.states[1:]
    )


def _fallen(scene: Scene, path: ImaginedPath) -> list[FloatArray]:
    """Final positions [2] of the objects that a path drops."""
    end = path.states[-1]
    return [end.object_positions[i] for i in rules.dropped_objects(scene, end)]


def _beads(points: FloatArray, spacing: float) -> FloatArray:
    """[N, 2] points along a polyline at equal distances, including both ends."""
    lengths = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    at = np.linspace(0.0, lengths[-1], max(2, round(lengths[-1] / spacing) + 1))
    return np.stack([np.interp(at, lengths, points[:, axis]) for axis in range(2)], axis=1)


# ------------------------------------------------------------------------------------------------------------- returns
Box = tuple[int, int, int, int]
"""Left, top, right, bottom [px]; right and bottom are outside."""


def draw_returns(picture: Frame, canvas: Canvas, paths: Sequence[ImaginedPath], taken: Sequence[Box] = ()) -> list[Box]:
    """Write the return of each path next to its end, where there is room.

    The chosen path comes first, then the others in order of decreasing return. A label that would cover another label,
    the end of a path, a cross or a box of ``taken``, or leave the picture, is moved around its end; it is omitted if
    there is no free place, or if there are 9 others. Pictures below 200 pixels have no labels.

    Returns:
        The boxes of the labels drawn.
    """
    side = canvas.size_px
    if side < _LEAST_SIZE_WITH_RETURNS:
        return []
    values = [path.value for path in paths if not path.is_diverged]
    is_crowd = len(paths) > _FEW
    spread = max(values) - min(values) if values else 0.0
    text_px = max(9, round(side / 40))
    pad = max(2, round(text_px / 4))
    ends = [canvas.frame_pixels(path.states[-1].gripper_position[None])[0] for path in paths]
    marks = [
        *ends,
        *(canvas.frame_pixels(position[None])[0] for path in paths for position in _fallen(canvas.scene, path)),
    ]
    starts = [canvas.frame_pixels(path.states[0].gripper_position[None])[0] for path in paths]
    order = sorted(range(len(paths)), key=lambda i: (not paths[i].is_chosen, -paths[i].value))
    drawn: list[Box] = []
    written: list[tuple[str, FloatArray]] = []
    for i in order:
        if len(drawn) == _MOST_RETURNS:
            break
        path, end = paths[i], ends[i]
        words = "diverged" if path.is_diverged else number(path.value, spread)
        if any(words == other and (is_crowd or np.hypot(*(end - at)) < text_px) for other, at in written):
            continue  # discrete roll-outs are often equal
        weight = 700 if path.is_chosen else 500
        width, height = text_width(words, text_px, weight) + 2 * pad, text_px + 2 * pad
        heading = math.atan2(*(end - starts[i])[::-1]) if np.hypot(*(end - starts[i])) > 1.0 else -math.pi / 2
        for box in _places(end, heading, width, height, 0.7 * text_px):
            inside = min(box[:2]) >= 1 and max(box[2:]) <= side - 1
            covers = any(_inside(mark, box, 2) for mark in marks)
            if inside and not covers and not any(_overlap(box, other, 2) for other in (*drawn, *taken)):
                break
        else:
            continue
        _label(picture, box, end, words, text_px, pad, weight, colour_of(path), path.is_chosen)
        drawn.append(box)
        written.append((words, end))
    return drawn


def number(value: float, spread: float) -> str:
    """Format a return with as few digits as distinguish values spread over ``spread``."""
    if spread >= 1.0 or spread == 0.0:
        return f"{value:.1f}" if abs(value) < 99.95 else f"{value:.0f}"
    return f"{value:.2f}" if spread >= 0.1 else f"{value:.3f}"


def _places(end: FloatArray, heading: float, width: int, height: int, gap: float) -> list[Box]:
    """Boxes around ``end``: first in the direction of the path, then at increasing angles and distances."""
    boxes = []
    for distance in (gap, 2.2 * gap, 4.0 * gap, 6.5 * gap):
        for turn in (0, 1, -1, 2, -2, 3, -3, 4):
            angle = heading + turn * math.pi / 4
            dx, dy = math.cos(angle), math.sin(angle)
            # The centre of a box whose border is ``distance`` away.
            reach = min(0.5 * width / max(abs(dx), 1e-6), 0.5 * height / max(abs(dy), 1e-6)) + distance
            left, top = round(end[0] + reach * dx - 0.5 * width), round(end[1] + reach * dy - 0.5 * height)
            boxes.append((left, top, left + width, top + height))
    return boxes


def _label(
    picture: Frame,
    box: Box,
    end: FloatArray,
    words: str,
    text_px: int,
    pad: int,
    weight: int,
    colour: Colour,
    is_chosen: bool,
) -> None:
    left, top, right, bottom = box
    nearest = (round(min(max(end[0], left), right - 1)), round(min(max(end[1], top), bottom - 1)))
    cv2.line(picture, (round(end[0]), round(end[1])), nearest, INK if is_chosen else colour, 1, cv2.LINE_AA)
    border = max(1, round(text_px / 10)) + is_chosen
    picture[top:bottom, left:right] = INK if is_chosen else PAPER
    picture[top + border : bottom - border, left + border : right - border] = colour
    red, green, blue = colour
    ink = INK if 0.299 * red + 0.587 * green + 0.114 * blue > 140 else PAPER
    text(picture, words, left + pad, bottom - pad - round(0.14 * text_px), ink, text_px, weight)


def _inside(point: FloatArray, box: Box, gap: int) -> bool:
    left, top, right, bottom = box
    return bool(left - gap <= point[0] <= right + gap and top - gap <= point[1] <= bottom + gap)


def _overlap(box: Box, other: Box, gap: int) -> bool:
    return box[0] < other[2] + gap and other[0] < box[2] + gap and box[1] < other[3] + gap and other[1] < box[3] + gap
