"""How figures look, and how they are written.

A colour has a value for a light and one for a dark background. Both have a contrast of at least 3:1 with it (text:
4.5:1), and remain apart for colour-blind readers. A method has the same colour, marker and line in all figures of an
evaluation; the marker alone identifies it in black and white.

Figures are plain matplotlib ``Figure`` objects, created within :func:`figure_style` and without pyplot's global state.
They are drawn in the light colours. :func:`save` writes them on an opaque light background, :func:`to_svg` prepares one
for a page that defines the colours for its theme (:func:`css_colours`).
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final, Literal

import matplotlib
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from visualrhp.evaluation.methods import KNOWN_METHODS, order_methods, with_labels
from visualrhp.files import atomic_path

INK: Final = "#1c2129"
FAINT: Final = "#616a77"
GRID: Final = "#d9dde3"
SURFACE: Final = "#ffffff"

BLUE: Final = "#1f3fb5"
SKY: Final = "#2f88d8"
ORANGE: Final = "#c97a14"
GREEN: Final = "#12875a"
VERMILION: Final = "#c2250f"
PURPLE: Final = "#6f2a80"
GREY: Final = "#6b6467"

COLOURS: Final = {
    "ink": (INK, "#e8ebf0"),
    "faint": (FAINT, "#9aa4b2"),
    "grid": (GRID, "#343b47"),
    "surface": (SURFACE, "#1a1e25"),
    "blue": (BLUE, "#3a84d6"),
    "sky": (SKY, "#5cd0ff"),
    "orange": (ORANGE, "#ffc53d"),
    "green": (GREEN, "#4fb981"),
    "vermilion": (VERMILION, "#f2543a"),
    "purple": (PURPLE, "#e38fe0"),
    "grey": (GREY, "#8d8683"),
}
"""Name -> colour on a light background, colour on a dark one. No other colours are used in figures."""

WIDTH: Final = 5.0
"""Width of every figure [inch]: its text is legible on a telephone, and two stand side by side on a screen."""

_DASHED: Final = (0, (5.0, 1.8))
_DOTTED: Final = (0, (1.2, 1.4))
_DASH_DOT: Final = (0, (5.0, 1.5, 1.2, 1.5))
_LINES: Final = ("-", _DASHED, _DOTTED, _DASH_DOT)

Dashes = str | tuple[int, tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class LineStyle:
    """How a method, a network or a level of noise is drawn."""

    colour: str
    marker: Any
    line: Dashes

    def keywords(self, marker_size: float | None) -> dict[str, Any]:
        """For matplotlib; without markers where their size is None."""
        markers = {} if marker_size is None else {"marker": self.marker, "markersize": marker_size}
        return {"color": self.colour, "linestyle": self.line, **markers}


_METHOD_STYLES: Final[dict[str, LineStyle]] = dict(
    zip(
        KNOWN_METHODS,
        (
            LineStyle(BLUE, "*", "-"),
            LineStyle(BLUE, "D", _DASHED),
            LineStyle(SKY, "o", _DOTTED),
            LineStyle(ORANGE, "<", "-"),
            LineStyle(ORANGE, "s", _DASHED),
            LineStyle(GREEN, ">", "-"),
            LineStyle(GREEN, "^", _DASHED),
            LineStyle(VERMILION, "v", _DASH_DOT),
            LineStyle(PURPLE, "X", _DASHED),
            LineStyle(PURPLE, "P", "-"),
            LineStyle(INK, "d", _DOTTED),
        ),
        strict=True,
    )
)
_FURTHER_MARKERS: Final = ((3, 1, 0), (6, 1, 0), "p", "8", (3, 1, 180))  # stars with three and with six points

NOISE_STYLES: Final = {
    "none": LineStyle(INK, "o", "-"),
    "low": LineStyle(SKY, "s", _DASHED),
    "medium": LineStyle(ORANGE, "^", _DASH_DOT),
    "high": LineStyle(VERMILION, "v", _DOTTED),
}

_SERIES_COLOURS: Final = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, GREY)
_SERIES_MARKERS: Final = ("o", "s", "^", "D", "v", "X", "P", "d", "<", ">", "*")


def method_styles(episodes: pd.DataFrame) -> dict[str, LineStyle]:
    """The styles of all methods in a table of episodes, in the order of legends.

    Give it the whole table of an evaluation, so that all of its figures agree: methods without a style of their own get
    one by their order.
    """
    labels = order_methods(with_labels(episodes)["method"].tolist())
    further = [label for label in labels if label not in _METHOD_STYLES]
    others = {
        label: LineStyle(GREY, _FURTHER_MARKERS[number % len(_FURTHER_MARKERS)], _LINES[number % len(_LINES)])
        for number, label in enumerate(further)
    }
    return {label: _METHOD_STYLES.get(label) or others[label] for label in labels}


def series_style(number: int) -> LineStyle:
    """The style of line ``number`` of lines that are not methods; 308 differ."""
    colours, markers = _SERIES_COLOURS, _SERIES_MARKERS
    return LineStyle(colours[number % len(colours)], markers[number % len(markers)], _LINES[number % len(_LINES)])


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
        "savefig.facecolor": SURFACE,
        "grid.color": GRID,
        "grid.linewidth": 0.7,
        "lines.linewidth": 1.5,
        "legend.frameon": False,
        "legend.fontsize": 9.5,
        "legend.handlelength": 2.6,
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


def css_colours(theme: Literal["light", "dark"]) -> str:
    """Declarations of the colours for a style sheet: ``--ink: #1c2129; ...``."""
    return " ".join(f"--{name}: {values[theme == 'dark']};" for name, values in COLOURS.items())


def css_colour(colour: str) -> str:
    """The name of a colour of a figure in a style sheet: ``var(--blue)``."""
    return next(f"var(--{name})" for name, (light, _) in COLOURS.items() if light == colour)


def to_svg(figure: Figure) -> str:
    """The figure as an ``<svg>`` element for an HTML page: no identifiers that could clash, no external names.

    It has no background, and the page defines its colours (:func:`css_colours`). The same figure gives the same string.
    """
    with figure_style():
        buffer = io.StringIO()
        metadata = {"Date": None, "Creator": None, "Format": None, "Type": None}
        figure.savefig(buffer, format="svg", metadata=metadata, facecolor="none")
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].strip()
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\s*xmlns(:\w+)?="[^"]*"', "", svg)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = svg.replace("font-family: 'DejaVu Sans', sans-serif", "font-family: inherit")
    return re.sub("|".join(light for light, _ in COLOURS.values()), lambda match: css_colour(match.group()), svg)


def key_svg(style: LineStyle) -> str:
    """A piece of a line in this style as an ``<svg>`` element: the key to the figures in text and tables."""
    with figure_style():
        figure = Figure(figsize=(0.44, 0.16))
        figure.add_artist(Line2D([0.0, 1.0], [0.5, 0.5], **style.keywords(None)))
        figure.add_artist(Line2D([0.5], [0.5], **style.keywords(6.5)))
    return to_svg(figure)


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write the figure to ``path`` (.svg, .png or .pdf), atomically; the same figure gives the same bytes.

    Its background is opaque: it is as legible in a dark viewer as in a light one.
    """
    suffix = os.path.splitext(path)[1]
    metadata: dict[str, Any] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix, {})
    with figure_style(), atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=160, metadata=metadata)
