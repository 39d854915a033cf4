"""Bars below a picture: the roll-outs in words with the colour scale of their returns, and what the colours mean."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from visualrhp.rendering.drawing import (
    DESIRED,
    FAINT_INK,
    GRIPPER,
    INK,
    OBSTACLE,
    PAPER,
    SURFACE,
    TARGET,
    Colour,
    mix,
    text,
    text_width,
)
from visualrhp.rendering.imagined import ImaginedPath, colour_at, share_of
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene
from visualrhp.simulation import rules

_TICKS = (rules.DROP_REWARD, -20.0, -10.0, -5.0, -2.0, rules.ACTION_REWARD)
"""Returns that are written below the scale, as far as there is room; the ends always."""
_LEAST_TEXT_PX = 9
_LEAST_WIDTH_WITH_MEANINGS = 200


def scale_height(size_px: int) -> int:
    """Height of the bar of the roll-outs below a picture of ``size_px`` [px]; even."""
    height = max(34, round(0.085 * size_px))
    return height + height % 2


# ----------------------------------------------------------------------------------------------------------- roll-outs
def rollout_bar(
    scene: Scene, paths: Sequence[ImaginedPath], height: int, width: int, decision_s: float | None = None
) -> Frame:
    """The bar below a frame: number of roll-outs, duration of the decision, and colour scale of the returns.

    Every return has a line on the scale, the chosen one a triangle above it. For a single roll-out or a plan, the
    number of its actions is shown: a plan was made earlier, so its duration is not that of the decision.

    Returns:
        [height, width, 3] uint8 RGB.
    """
    bar = np.full((height, width, 3), PAPER, dtype=np.uint8)
    bar[: max(1, height // 28)] = mix(PAPER, INK, 0.15)
    if not paths:
        return bar
    text_px = max(_LEAST_TEXT_PX, round(0.36 * height))
    margin = round(0.35 * height)
    baseline = round(0.5 * height + 0.36 * text_px)
    room = _draw_scale(bar, paths, text_px) - 2 * margin
    for words in _summaries(scene, paths, decision_s):
        if text_width(words, text_px, 400) <= room:
            text(bar, words, margin, baseline, FAINT_INK, text_px, 400)
            break
    return bar


def _draw_scale(bar: Frame, paths: Sequence[ImaginedPath], text_px: int) -> int:
    """Draw "return" and the colour scale with its ticks at the right end; return the column where they begin."""
    height, width = bar.shape[:2]
    tick_px = max(_LEAST_TEXT_PX, round(0.27 * height))
    margin = max(tick_px, round(0.35 * height))
    length = min(max(24, round(0.42 * width)), width - 2 * margin)
    start = width - margin - length
    top, bottom = round(0.3 * height), round(0.3 * height) + max(6, round(0.24 * height))
    shares = np.linspace(0.0, 1.0, length)
    bar[top:bottom, start : start + length] = [colour_at(share) for share in shares.tolist()]

    def column_of(value: float) -> int:
        return start + round(share_of(value) * (length - 1))

    thick = max(1, height // 36)
    for path in paths:
        if path.is_diverged:
            continue
        column = column_of(path.value)
        bar[bottom - (bottom - top) // 2 : bottom, column : column + thick] = INK
        if path.is_chosen:
            half = max(3, round(0.1 * height))
            corners = [(column - half, top - 2 * half), (column + half, top - 2 * half), (column, top - 1)]
            cv2.fillPoly(bar, [np.array(corners, dtype=np.int32)], INK, cv2.LINE_AA)
    taken: list[tuple[int, int]] = []
    for value in (_TICKS[0], _TICKS[-1], *_TICKS[1:-1]):
        words = f"{value:.0f}"
        half = text_width(words, tick_px, 500) // 2
        left, right = column_of(value) - half, column_of(value) + half
        if all(right + tick_px // 2 < other[0] or other[1] + tick_px // 2 < left for other in taken):
            taken.append((left, right))
            bar[bottom : bottom + max(2, height // 24), column_of(value) : column_of(value) + thick] = FAINT_INK
            text(bar, words, left, bottom + round(1.15 * tick_px), INK, tick_px, 500)
    name = text_width("return", text_px, 600)
    left = start - round(1.2 * tick_px) - name
    if left < margin:
        return start - margin
    text(bar, "return", left, round(0.5 * height + 0.36 * text_px), INK, text_px, 600)
    return left


def _summaries(scene: Scene, paths: Sequence[ImaginedPath], decision_s: float | None) -> list[str]:
    """Summaries of the roll-outs in words, the longest first."""
    diverged = sum(path.is_diverged for path in paths)
    dropping = sum(rules.is_dropped(scene, path.states[-1]) for path in paths if not path.is_diverged)
    remarks = [f"{diverged} diverged"] * bool(diverged) + [f"{dropping} dropping"] * bool(dropping)
    if len(paths) == 1:
        ahead = len(paths[0].states) - 1
        actions = f"{ahead} action{'s' if ahead != 1 else ''}"
        return [*(", ".join([count, *remarks]) for count in (f"{actions} ahead", actions)), f"{ahead}"]
    count = f"{len(paths)} roll-outs"
    timed = [] if decision_s is None else [f"{count} in {1e3 * decision_s:.3g} ms"]
    return [
        *(", ".join([words, *remarks]) for words in timed),
        ", ".join([count, *remarks]),
        *timed,
        count,
        f"{len(paths)}",
    ]


# ------------------------------------------------------------------------------------------------------------ meanings
def meaning_bar(size_px: int, width: int, *, with_paths: bool) -> Frame:
    """What the colours mean, in as many rows as necessary: objects, target region, gripper, and paths if there are any.

    Args:
        size_px: of the picture above.
        width: of the bar [px]; below 200 there is no room, and the bar is empty.
        with_paths: whether roll-outs are drawn.

    Returns:
        [H, width, 3] uint8 RGB, H even.
    """
    if width < _LEAST_WIDTH_WITH_MEANINGS:
        return np.empty((0, width, 3), dtype=np.uint8)
    text_px = max(_LEAST_TEXT_PX, round(0.0235 * size_px))
    side, gap, margin = round(1.1 * text_px), round(0.45 * text_px), round(0.9 * text_px)
    line = round(1.9 * text_px)
    rows: list[list[tuple[str, Callable[[Frame], None], int]]] = [[]]
    left = margin
    for name, draw in (*_BODIES, *(_PATHS if with_paths else ())):
        whole = side + gap + text_width(name, text_px, 500)
        if rows[-1] and left + whole > width - margin:
            rows.append([])
            left = margin
        rows[-1].append((name, draw, left))
        left += whole + margin
    height = len(rows) * line + len(rows) * line % 2
    bar = np.full((height, width, 3), PAPER, dtype=np.uint8)
    bar[: max(1, size_px // 320)] = mix(PAPER, INK, 0.15)
    for number, row in enumerate(rows):
        top = number * line + (line - side) // 2
        for name, draw, left in row:
            draw(bar[top : top + side, left : left + side])
            baseline = number * line + round(0.5 * line + 0.36 * text_px)
            text(bar, name, left + side + gap, baseline, INK, text_px, 500)
    return bar


def _enlarged(draw: Callable[[Frame], None]) -> Callable[[Frame], None]:
    """Draw on a square of 64 pixels, which is reduced to the place of the mark."""

    def drawn(place: Frame) -> None:
        square = np.full((64, 64, 3), PAPER, dtype=np.uint8)
        draw(square)
        place[:] = cv2.resize(square, (place.shape[1], place.shape[0]), interpolation=cv2.INTER_AREA)

    return drawn


def _body(colour: Colour) -> Callable[[Frame], None]:
    def draw(square: Frame) -> None:
        cv2.rectangle(square, (6, 6), (57, 57), colour, -1)
        cv2.rectangle(square, (6, 6), (57, 57), mix(colour, INK, 0.5), 4)

    return _enlarged(draw)


def _region(square: Frame) -> None:
    cv2.circle(square, (32, 32), 26, mix(SURFACE, TARGET, 0.22), -1, cv2.LINE_AA)
    cv2.circle(square, (32, 32), 26, TARGET, 6, cv2.LINE_AA)


def _path(colour: Colour, width: int, casing: Colour) -> Callable[[Frame], None]:
    def draw(square: Frame) -> None:
        for ink, extra in ((casing, 8), (colour, 0)):
            cv2.line(square, (8, 50), (54, 14), ink, width + extra, cv2.LINE_AA)
            cv2.circle(square, (52, 16), width + extra // 2, ink, -1, cv2.LINE_AA)

    return _enlarged(draw)


_BODIES = (
    ("desired", _body(DESIRED)),
    ("target", _enlarged(_region)),
    ("obstacle", _body(OBSTACLE)),
    ("gripper", _body(GRIPPER)),
)
_PATHS = (
    ("candidate", _path(colour_at(0.3), 10, PAPER)),
    ("chosen", _path(colour_at(0.9), 14, INK)),
)
