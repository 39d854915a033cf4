"""The look of methods, and figures as text and as files."""

import itertools
import re
from collections.abc import Callable

import cv2
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb

from tests.evaluation.samples import ablation_table
from visualrhp.evaluation import episode_figures, styles
from visualrhp.evaluation.methods import KNOWN_METHODS


@pytest.fixture(scope="module")
def episodes():
    return ablation_table()


def linear(colour: str) -> np.ndarray:
    """Linear RGB [3] of a colour of sRGB."""
    value = np.asarray(to_rgb(colour))
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def contrast(first: str, second: str) -> float:
    """Contrast ratio of WCAG."""
    low, high = sorted(float(linear(colour) @ [0.2126, 0.7152, 0.0722]) for colour in (first, second))
    return (high + 0.05) / (low + 0.05)


VISION = {  # Machado, Oliveira, Fernandes, 2009: what is seen without one of the three kinds of cones, in linear RGB
    "full": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}


def seen_as(colour: str, vision: str) -> np.ndarray:
    """CIELAB coordinates [3]."""
    rgb = np.clip(np.asarray(VISION[vision]) @ linear(colour), 0.0, 1.0)
    encoded = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return cv2.cvtColor(encoded.astype(np.float32).reshape(1, 1, 3), cv2.COLOR_RGB2LAB).ravel()


def table_of(labels: list[str]) -> pd.DataFrame:
    return pd.DataFrame({"planner": labels, "num_rollouts": None, "horizon": None})


@pytest.mark.parametrize("theme", [0, 1], ids=["light", "dark"])
def test_colours_stand_out_from_the_background(theme: int):
    colours = {name: values[theme] for name, values in styles.COLOURS.items()}
    background = colours.pop("surface")
    del colours["grid"]
    for name, colour in colours.items():
        assert contrast(colour, background) >= (4.5 if name in ("ink", "faint") else 3.0), name


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("theme", [0, 1], ids=["light", "dark"])
def test_colours_of_lines_are_told_apart_by_colour_blind_readers(theme: int, vision: str):
    names = [name for name in styles.COLOURS if name not in ("surface", "grid", "faint")]
    for first, second in itertools.combinations(names, 2):
        colours = (styles.COLOURS[name][theme] for name in (first, second))
        one, other = (seen_as(colour, vision) for colour in colours)
        assert np.linalg.norm(one - other) > 10.0, (first, second)


def test_every_method_has_its_own_marker_and_its_own_line():
    labels = ["a", *KNOWN_METHODS, "b", "c", "d"]
    looks = styles.method_styles(table_of(labels))
    assert list(looks) == [*KNOWN_METHODS, "a", "b", "c", "d"]
    assert len({look.marker for look in looks.values()}) == len(labels)
    assert len({(look.colour, look.line) for look in looks.values()}) == len(labels)


def test_series_differ():
    looks: Callable[[int], styles.LineStyle] = styles.series_style
    assert len({looks(number) for number in range(308)}) == 308
    assert len({(looks(number).colour, looks(number).line) for number in range(28)}) == 28


def test_svg_for_a_page_is_self_contained_and_reproducible(episodes):
    svg = styles.to_svg(episode_figures.by_num_objects(episodes))
    assert svg.startswith("<svg") and svg.endswith("</svg>")
    assert "http" not in svg
    assert "var(--ink)" in svg and 'id="axes' not in svg
    assert not re.search(r"#[0-9a-f]{6}[;\"]", svg)  # every colour follows the theme
    assert set(re.findall(r"var\(--(\w+)\)", svg)) <= set(styles.COLOURS)
    assert svg == styles.to_svg(episode_figures.by_num_objects(episodes))


def test_files_are_reproducible(episodes, tmp_path):
    for name in ("a.svg", "b.svg", "a.png", "b.png"):
        styles.save(episode_figures.by_size(episodes, "action_efficiency"), tmp_path / name)
    for suffix in ("svg", "png"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_files_are_legible_in_a_dark_viewer_too(episodes, tmp_path):
    styles.save(episode_figures.by_size(episodes), tmp_path / "a.png")
    pixels = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert (pixels[..., 3] == 255).all() and (pixels[0, 0, :3] == 255).all()


def test_the_theme_of_a_page_defines_every_colour():
    for theme in ("light", "dark"):
        assert all(f"--{name}: #" in styles.css_colours(theme) for name in styles.COLOURS)
    assert styles.css_colour(styles.BLUE) == "var(--blue)"
    key = styles.key_svg(styles.series_style(0))
    assert key.startswith("<svg") and "var(--blue)" in key
