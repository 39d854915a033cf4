"""Bars and panels around the picture of a scene: captions, and the label image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visualrhp.observation.label_image import PALETTE, label_image
from visualrhp.rendering.drawing import (
    BACKGROUND,
    FAINT_INK,
    INK,
    PAPER,
    Colour,
    mix,
    rounded_box,
    shortened,
    text,
    text_width,
)
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene
from visualrhp.types import Outcome, State

OUTCOME_COLOURS: dict[Outcome, Colour] = {
    Outcome.SUCCESS: (22, 128, 72),
    Outcome.DROPPED: (196, 52, 48),
    Outcome.OUT_OF_ACTIONS: (176, 112, 8),
    Outcome.NO_PLAN: (176, 112, 8),
    Outcome.PLAN_FAILED: (176, 112, 8),
    Outcome.DIVERGED: (112, 60, 140),
    Outcome.UNREACHABLE: (112, 60, 140),
    Outcome.STOPPED: (112, 60, 140),
}


@dataclass(frozen=True, slots=True)
class Caption:
    """Text above a frame.

    Attributes:
        title: usually the planner's name.
        step: number of actions executed so far.
        max_steps: the action limit.
        outcome: how the episode ended; None while it is in progress.
    """

    title: str
    step: int | None = None
    max_steps: int | None = None
    outcome: Outcome | None = None


def bar_height(size_px: int) -> int:
    """Height of a bar above or below a picture of ``size_px`` [px]; even."""
    height = max(24, round(0.085 * size_px))
    return height + height % 2


def caption_bar(caption: Caption, size_px: int, width: int) -> Frame:
    """A bar with the title on the left and the step count and outcome on the right.

    If there is not enough room, the outcome takes precedence, then the step, then as much of the title as fits.
    """
    height = bar_height(size_px)
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


def observation_panel(scene: Scene, believed_scene: Scene, state: State, height: int) -> Frame:
    """The abstract label image, enlarged pixel by pixel, with a title above and as many facts below as fit."""
    labels = PALETTE[label_image(believed_scene, state)]
    factor = max(1, height // 2 // labels.shape[0])
    image = labels.repeat(factor, axis=0).repeat(factor, axis=1)
    side = image.shape[0]
    margin = max(6, height // 40)
    text_px = max(10, height // 34)
    panel = np.full((height, side + 2 * margin + (side % 2), 3), BACKGROUND, dtype=np.uint8)
    top = 2 * margin + text_px
    if top + side <= height:
        name = shortened("what the network sees", side, text_px, 600)
        text(panel, name, margin, top - margin // 2 - 2, INK, text_px, 600)
    else:
        top = max(0, (height - side) // 2)
    panel[max(0, top - 2) : top + side + 2, margin - 2 : margin + side + 2] = mix(BACKGROUND, INK, 0.35)
    panel[top : top + side, margin : margin + side] = image
    lines = [
        f"{labels.shape[0]} x {labels.shape[1]} labels, gripper-centred",
        f"gripper {'closed' if state.gripper_closed else 'open'}, {1e3 * state.gripper_opening:.0f} mm",
        f"{1e2 * np.hypot(*(state.desired_position - scene.target.position)):.1f} cm to the target",
    ]
    for line_number, line in enumerate(lines):
        baseline = top + side + margin + text_px + round(1.45 * line_number * text_px)
        if baseline + text_px // 3 <= height:
            text(panel, shortened(line, side, text_px, 400), margin, baseline, FAINT_INK, text_px, 400)
    return panel
