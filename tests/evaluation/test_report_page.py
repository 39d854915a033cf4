"""The page has the numbers of the episodes, and is self-contained."""

from __future__ import annotations

import base64
import re
from dataclasses import replace

import pandas as pd

from tests.evaluation.samples import evaluation_card, report_table
from visualrhp.evaluation.films import Film
from visualrhp.evaluation.report_content import page_content
from visualrhp.evaluation.report_figures import result_figures
from visualrhp.evaluation.report_page import render
from visualrhp.evaluation.report_videos import Attempt, arrange_attempts


def page_of(episodes: pd.DataFrame, *attempts: Attempt) -> str:
    scenes = arrange_attempts(attempts, {0: 4} if attempts else {}, ["continuous"], 0)
    figures = result_figures(episodes)
    return render(page_content("Title", episodes, evaluation_card(episodes), figures, scenes, [], None))


def words_of(page: str) -> str:
    text = re.sub(r"<style>.*?</style>|<svg.*?</svg>|<script>.*?</script>", "", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text))


def test_the_page_has_the_numbers_of_the_episodes() -> None:
    text = words_of(page_of(report_table()))
    assert "VisualRHP 3x3 completes 90% of the tasks (65% to 98%) with continuous actions" in text
    assert "Greedy 50%" in text and "K.RRT 100%" in text
    # success [Wilson], efficiency of the nine completed tasks [bootstrap], time, decision, dropped, episodes
    row = "VisualRHP 3x3 continuous 90% 65–98 0.34 0.24–0.46 510 ms 510–510 ms 50 ms 10% 10"
    assert row in text
    assert "VisualRHP 3x3 with continuous actions has no network for some numbers of objects: 9 of 39 tasks" in text
    assert "0123456789" in text and "180" in text


def test_the_headline_is_about_visualrhp_plus_where_it_was_evaluated() -> None:
    table = report_table()
    plus = table.loc[table["planner"] == "VisualRHP"].assign(planner="VisualRHP+", success=True)
    text = words_of(page_of(pd.concat([table, plus], ignore_index=True)))
    assert "VisualRHP+ 3x3 completes 100% of the tasks" in text and "VisualRHP 3x3 90%" in text


def test_the_page_begins_with_what_was_learned_about_methods() -> None:
    table = report_table()
    own = table.loc[table["planner"] == "VisualRHP"]
    plus = own.assign(planner="VisualRHP+", success=True, num_actions=5)
    search = own.assign(planner="K.RRT closed loop", num_rollouts=None, horizon=None, success=True, num_actions=8)
    text = words_of(page_of(pd.concat([table, plus, search], ignore_index=True)))
    assert "(VisualRHP+ 3x3) does not complete significantly more or fewer tasks than searching for a plan" in text
    assert "with shorter plans (−3.0 actions, p = 0.002)" in text


def test_methods_and_symbols_are_explained() -> None:
    table = report_table()
    page = page_of(table.assign(planner=table["planner"].replace("Greedy", "mine")))
    text = words_of(page)
    assert "K.RRT Kinodynamic RRT: searches for a plan once" in text and "n×h After the name of a method" in text
    assert page.count('<span class="key"') > 3 * len(set(table["planner"]))  # in legends, tables and cards


def test_small_tables_make_a_page_too() -> None:
    """One planner, one setting: only the figures that make sense."""
    table = report_table()
    chosen = (table["planner"] == "Greedy") & (table["noise_level"] == "none") & (table["object_size"] == "mixed")
    table = table.loc[chosen & (table["action_space"] == "discrete")]
    page = page_of(table.assign(success=False, action_efficiency=float("nan")))
    assert "Greedy completes 0% of the tasks" in page
    assert "Success rate by object size" not in page and "Success rate under noise" not in page
    assert page == page_of(table.assign(success=False, action_efficiency=float("nan")))


def test_videos_are_embedded_and_missing_ones_explained() -> None:
    film = Attempt(0, "continuous", "Greedy", "Greedy succeeds", Film(b"film", b"poster", 64, 80))
    page = page_of(report_table(), film, replace(film, method="other", description="no network", film=None))
    assert f"data:video/webm;base64,{base64.b64encode(b'film').decode()}" in page
    assert f"data:image/webp;base64,{base64.b64encode(b'poster').decode()}" in page
    assert '<div class="absent">no network</div>' in page
    sources = re.findall(r'(?:src|href)="([^"]{0,40})', page)
    assert sources and all(source.startswith(("data:", "#")) for source in sources)
    assert not re.findall(r"(?:https?:)?//[\w.-]+\.\w", page.split("<script>")[0])
