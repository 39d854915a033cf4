"""How figures look, and how they are written.

Every method has the same colour and marker in all figures (the colour-blind safe set of Okabe and Ito, and greys).
Figures are plain matplotlib ``Figure`` objects, created within :func:`figure_style` and without pyplot's global state;
:func:`to_svg` prepares one for a page, :func:`save` writes it.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import matplotlib
from matplotlib.figure import Figure

from visualrhp.evaluation.methods import KNOWN_METHODS, order_methods
from visualrhp.files import atomic_path

INK: Final = "#1c2129"
FAINT: Final = "#6f7885"
GRID: Final = "#d9dde3"
PAPER: Final = "#fefefe"

BLUE: Final = "#0072b2"
VERMILION: Final = "#d55e00"
GREEN: Final = "#009e73"
PURPLE: Final = "#cc79a7"
ORANGE: Final = "#e69f00"
SKY: Final = "#56b4e9"
GREY: Final = "#6f6f6f"
LIGHT_GREY: Final = "#9a9a9a"
BLACK: Final = "#000000"

PALETTE: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, GREY)
"""Colours of lines that are not methods, in their order."""

NOISE_COLOURS: Final = {"none": "#0b2545", "low": "#2a6f97", "medium": "#c8792b", "high": "#a4161a"}
NOISE_LINES: Final = {"none": "-", "low": "--", "medium": "-.", "high": ":"}


@dataclass(frozen=True, slots=True)
class MethodStyle:
    """How a method is drawn."""

    colour: str
    marker: str


_LOOKS = (
    (BLUE, "*"),
    (SKY, "D"),
    (BLUE, "o"),
    (ORANGE, "h"),
    (ORANGE, "s"),
    (GREEN, "p"),
    (GREEN, "^"),
    (VERMILION, "v"),
    (GREY, "X"),
    (PURPLE, "P"),
    (BLACK, "d"),
)
_STYLES: Final = {label: MethodStyle(*look) for label, look in zip(KNOWN_METHODS, _LOOKS, strict=True)}
_FURTHER_STYLES: Final = [MethodStyle(LIGHT_GREY, marker) for marker in ("h", "*", "p", "<", ">", "H")]


def method_style(label: str, labels: Sequence[str]) -> MethodStyle:
    """Colour and marker of the method ``label`` among all ``labels`` of a figure."""
    if label in _STYLES:
        return _STYLES[label]
    others = [other for other in order_methods(labels) if other not in _STYLES]
    return _FURTHER_STYLES[others.index(label) % len(_FURTHER_STYLES)]


@contextmanager
def figure_style() -> Iterator[None]:
    """Matplotlib's parameters within the block."""
    parameters: Any = {
        "font.family": "sans-serif",
        "font.sans-serif": ["DejaVu Sans"],
        "font.size": 10,
        "axes.titlesize": 10,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.labelsize": 10,
        "axes.labelcolor": INK,
        "axes.edgecolor": FAINT,
        "axes.linewidth": 0.8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.facecolor": "none",
        "figure.facecolor": "none",
        "savefig.facecolor": "white",
        "grid.color": GRID,
        "grid.alpha": 0.6,
        "grid.linewidth": 0.7,
        "lines.linewidth": 1.5,
        "legend.frameon": False,
        "legend.fontsize": 9.5,
        "legend.handlelength": 1.9,
        "text.color": INK,
        "xtick.color": FAINT,
        "ytick.color": FAINT,
        "xtick.labelcolor": INK,
        "ytick.labelcolor": INK,
        "xtick.labelsize": 9.5,
        "ytick.labelsize": 9.5,
        "svg.fonttype": "none",
        "svg.hashsalt": "visualrhp",
    }
    with matplotlib.rc_context(parameters):
        yield


def to_svg(figure: Figure) -> str:
    """The figure as an ``<svg>`` element for an HTML page: no identifiers that could clash, no external names.

    Text and axes take the page's text colour (``currentColor``), hollow markers its ``--surface`` colour, so that the
    figure follows a light or dark theme. The same figure gives the same string.
    """
    with figure_style():
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].strip()
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\s*xmlns(:\w+)?="[^"]*"', "", svg)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = svg.replace("font-family: 'DejaVu Sans', sans-serif", "font-family: inherit")
    return svg.replace(INK, "currentColor").replace(PAPER, "var(--surface, #fff)")


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write the figure to ``path`` (.svg, .png or .pdf), atomically; the same figure gives the same bytes."""
    suffix = os.path.splitext(path)[1]
    metadata: dict[str, Any] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix, {})
    with figure_style(), atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=160, metadata=metadata)
