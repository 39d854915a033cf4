"""Pictures of a scene: bodies, their past, imagined roll-outs, and the bars and panels around them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from visualrhp.observation.label_image import PALETTE, label_image
from visualrhp.rendering.drawing import (
    BACKGROUND,
    DESIRED,
    FINGER,
    GRIPPER,
    INK,
    OBSTACLE,
    SURFACE,
    Canvas,
    Colour,
    mix,
)
from visualrhp.rendering.imagined import Box, ImaginedPath, draw_paths, draw_returns
from visualrhp.rendering.legend import meaning_bar, rollout_bar, scale_height
from visualrhp.rendering.panels import Caption, caption_bar, observation_panel
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene, geometry
from visualrhp.types import FloatArray, State


class SceneView:
    """Draws frames of one scene with the same layout; caches what they have in common."""

    def __init__(
        self,
        scene: Scene,
        size_px: int,
        *,
        show_legend: bool,
        show_observation: bool,
        show_inset: bool,
        believed_scene: Scene | None = None,
    ) -> None:
        self.canvas = Canvas(scene, size_px)
        self.show_legend = show_legend
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
        listed: Sequence[ImaginedPath] | None,
        decision_s: float | None,
    ) -> Frame:
        """See :func:`visualrhp.rendering.frames.render_frame`.

        ``observed`` is the state of the label image, ``listed`` the paths of the bar below.
        """
        canvas, size_px = self.canvas, self.canvas.size_px
        canvas.clear()
        _draw_bodies(canvas, state, trail)
        draw_paths(canvas, paths)
        _point_to_gripper(canvas, state)
        picture = canvas.finished()
        taken = [self._draw_inset(picture, state, observed)] if self._corner is not None else []
        draw_returns(picture, canvas, paths, taken)
        if self.show_observation:
            panel = observation_panel(canvas.scene, self.believed_scene, observed, size_px)
            picture = np.concatenate([picture, panel], axis=1)
        bars = [picture]
        if caption is not None:
            bars.insert(0, caption_bar(caption, size_px, picture.shape[1]))
        width = picture.shape[1]
        if listed is not None:
            bars.append(rollout_bar(canvas.scene, listed, scale_height(size_px), width, decision_s))
        if self.show_legend:
            bars.append(meaning_bar(size_px, width, with_paths=listed is not None))
        return np.concatenate(bars, axis=0) if len(bars) > 1 else picture

    def _draw_inset(self, picture: Frame, state: State, observed: State) -> Box:
        """Draw the label image in the corner where it hides least; it stays there until another corner is better."""
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
        visible[:] = frame[: visible.shape[0], : visible.shape[1]]  # the smallest pictures show only a part
        return left, top, right, bottom


def _points_to_see(scene: Scene, state: State) -> FloatArray:
    """[N, 2] points of the gripper, the objects and the target region."""
    around = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    return np.concatenate(
        [
            scene.target.position + scene.target.radius * np.stack([np.cos(around), np.sin(around)], axis=1),
            *scene.gripper.outlines(state.gripper_pose, state.gripper_opening),
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
    gripper = scene.gripper.outlines(state.gripper_pose, state.gripper_opening)
    canvas.shade([*outlines, *gripper])
    path = [*trail, state]
    _draw_path(canvas, np.array([past.desired_position for past in path]), mix(DESIRED, INK, 0.25))
    for outline in outlines[1:]:
        canvas.polygon(outline, OBSTACLE, mix(OBSTACLE, INK, 0.45))
    canvas.polygon(outlines[0], DESIRED, mix(DESIRED, INK, 0.5), width=0.0022)
    centre = state.desired_position
    canvas.dot(centre, 0.0045, mix(DESIRED, INK, 0.6))  # the centre must reach the target region
    _draw_path(canvas, np.array([past.gripper_position for past in path]), GRIPPER)
    palm, left, right = gripper
    for finger in (left, right):
        canvas.polygon(finger, FINGER, mix(FINGER, INK, 0.5))
    canvas.polygon(palm, GRIPPER, mix(GRIPPER, INK, 0.5))
    _draw_palm_details(canvas, palm)


def _draw_path(canvas: Canvas, positions: FloatArray, colour: Colour) -> None:
    """Draw a polyline with a dot at each earlier position; the oldest part is the faintest."""
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
    """Draw a lighter plate and the flange of the wrist, so that the gripper is recognizable."""
    centre = palm.mean(axis=0)
    canvas.polygon(centre + 0.62 * (palm - centre), mix(GRIPPER, SURFACE, 0.22))
    canvas.disc(centre, 0.013, mix(GRIPPER, INK, 0.35))
    canvas.disc(centre, 0.008, mix(GRIPPER, SURFACE, 0.45))


def _point_to_gripper(canvas: Canvas, state: State) -> None:
    """Draw an arrow at the border of the picture towards a gripper outside it."""
    points = np.concatenate(canvas.scene.gripper.outlines(state.gripper_pose, state.gripper_opening))
    inset = canvas.size_of(0.03)
    low, high = canvas.bounds
    if ((points > low) & (points < high)).all(axis=1).any():
        return
    centre = points.mean(axis=0)
    place = np.clip(centre, low + inset, high - inset)
    heading = centre - place
    angle = float(np.arctan2(heading[1], heading[0]))
    arrow = canvas.size_of(1.0) * np.array([[0.022, 0.0], [-0.008, 0.016], [-0.002, 0.0], [-0.008, -0.016]])
    canvas.polygon(geometry.to_world(arrow, (*place, angle)), GRIPPER, mix(GRIPPER, INK, 0.5))
