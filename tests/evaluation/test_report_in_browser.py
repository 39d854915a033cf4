"""The report in a browser: light, dark, on a telephone and on paper, with every method and all figures."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from playwright.sync_api import Browser, sync_playwright

from tests.evaluation.samples import evaluation_card, sample_table
from visualrhp.evaluation import training_figures
from visualrhp.evaluation.films import Film
from visualrhp.evaluation.methods import KNOWN_METHODS
from visualrhp.evaluation.report_content import page_content
from visualrhp.evaluation.report_figures import NamedFigure, result_figures
from visualrhp.evaluation.report_page import render
from visualrhp.evaluation.report_videos import Attempt, arrange_attempts

A4_WIDTH = 702
"""Width of a page of paper between its margins of 12 mm [CSS px]."""

MEDIA: dict[str, dict[str, Any]] = {
    "light": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "light"},
    "dark": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "dark"},
    "narrow": {"viewport": {"width": 420, "height": 900}, "color_scheme": "dark"},
    "print": {"viewport": {"width": A4_WIDTH, "height": 900}, "color_scheme": "dark"},
}

PROBLEMS = (Path(__file__).parent / "page_problems.js").read_text(encoding="utf-8")


def table_of_all_methods() -> pd.DataFrame:
    """Two episodes per setting of every known method and of two others; three of them with noise."""
    planners = []
    for label in KNOWN_METHODS:
        name, _, suffix = label.rpartition(" ")
        n, _, h = suffix.partition("x")
        planners.append((name, int(n), int(h)) if n.isdecimal() else (label, None, None))
    planners += [("mine", 2, 5), ("yours in 50 ms", None, 3)]
    settings = [("1-7", "mixed", "none"), ("1-7", "small", "none")]
    settings += [("4", "mixed", level) for level in ("low", "medium", "high")]
    rows = []
    for (planner, n, h), space, (requested, size, level), episode in itertools.product(
        planners, ("continuous", "discrete"), settings, (0, 1)
    ):
        if level != "none" and (space == "discrete" or planner not in ("VisualRHP+", "Greedy", "dhRRT")):
            continue
        rows.append(
            {
                "planner": planner,
                "num_rollouts": n,
                "horizon": h,
                "action_space": space,
                "scene_num_objects": requested,
                "object_size": size,
                "noise_level": level,
                "episode": episode,
                "num_objects": 1 + 3 * episode if requested == "1-7" else int(requested),
                "num_actions": 5 + len(rows) % 7,
                "success": len(rows) % 5 > 0,
                "decision_time_s": 0.01 * (1 + len(rows) % 300),
            }
        )
    return sample_table(rows)


def more_figures() -> dict[str, list[NamedFigure]]:
    """Curves of nine networks, and the two learning studies."""
    shown = training_figures.SHOWN_CURVES["train_rl"]
    steps = np.arange(20)
    histories = {
        f"continuous, cartesian, heuristic_m{number}": pd.DataFrame(
            {"iteration": steps} | {name: np.sin(0.2 * steps + number) for name in shown.columns}
        )
        for number in range(9)
    }
    batches = {"action_space": ["continuous", "discrete"] * 4, "num_demonstrations": [10, 10, 20, 20] * 2}
    trials = {"algorithm": ["C3PO", "PPO"] * 4, "transitions": [0, 0, 9000, 9000] * 2}
    rates = {"success_rate": np.linspace(0.3, 0.9, 8)}
    figures = {
        "training": training_figures.training_curves(histories, shown.unit, shown.columns, "Iteration"),
        "demonstrations": training_figures.demonstrations_sweep(pd.DataFrame(batches | rates)),
        "stability": training_figures.learning_stability(pd.DataFrame(trials | rates)),
    }
    named = {stem: NamedFigure(stem, stem, "A caption.", figure) for stem, figure in figures.items()}
    return {"training": [named["training"]], "sweeps": [named["demonstrations"], named["stability"]]}


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    episodes = table_of_all_methods()
    film = Attempt(0, "continuous", "Greedy", "Greedy succeeds", Film(b"", b"", 64, 80))
    missing = Attempt(0, "continuous", "CartesianRHP 3x3", "no network for 4 objects", None)
    scenes = arrange_attempts([film, missing], {0: 4}, ["continuous"], 0)
    figures = result_figures(episodes) | more_figures()
    path = tmp_path_factory.mktemp("report") / "index.html"
    content = page_content("A report", episodes, evaluation_card(episodes), figures, scenes, [], None)
    path.write_text(render(content), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """The system's Chromium, or else Playwright's (``playwright install chromium``)."""
    names = ("chromium", "chromium-browser", "google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=next(filter(None, map(shutil.which, names)), None))
        yield browser
        browser.close()


@pytest.mark.parametrize("medium", MEDIA)
def test_everything_is_legible_and_nothing_is_cut_off(medium: str, page_file: Path, browser: Browser) -> None:
    """Contrasts of WCAG AA: 4.5:1 for text, 3:1 for lines and symbols. On paper nothing can scroll."""
    page = browser.new_page(**MEDIA[medium])
    page.goto(page_file.as_uri())
    if medium == "print":
        page.emulate_media(media="print")
    found = page.evaluate(PROBLEMS, {"canScroll": medium != "print"})
    assert found["problems"] == []
    # The check has seen the page: figures, keys in tables, and words.
    assert found["figures"] == 9 and found["lines"] > 1000 and found["texts"] > 1000
    page.close()


def test_results_come_before_videos(page_file: Path, browser: Browser) -> None:
    page = browser.new_page()
    page.goto(page_file.as_uri())
    headings = page.eval_on_selector_all("h2", "headings => headings.map(heading => heading.id)")
    assert headings == ["results", "environments", "robustness", "sweeps", "watch", "training", "run"]
    assert page.eval_on_selector_all("nav a", "links => links.map(link => link.hash.slice(1))") == headings
    page.close()
