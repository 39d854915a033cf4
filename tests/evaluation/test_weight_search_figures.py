"""Figures of a search: a panel per weight, a line per record."""

from __future__ import annotations

from visualrhp.evaluation.weight_search import TrialEpisode, TrialRecord
from visualrhp.evaluation.weight_search_figures import pushes_figure, search_figure


def record(trial: int, angles: tuple[float, ...], is_pruned: bool = False) -> TrialRecord:
    episodes = {space: [TrialEpisode(True, False, 5, angles)] for space in ("continuous", "discrete")}
    weights = {"reach": 1.0 + trial, "carry": 10.0 + trial}
    return TrialRecord("search", trial, weights, {1: 0.1 * trial}, episodes, is_pruned)


RECORDS = [record(0, (0.1, 2.0)), record(1, (), is_pruned=True), record(2, (0.1, 0.2))]


def test_the_objective_is_drawn_in_order_and_against_each_weight() -> None:
    axes = search_figure(RECORDS, RECORDS[2]).axes
    assert [panel.get_xlabel() for panel in axes] == ["trial", "reach", "carry"]
    pruned, finished, selected = axes[1].lines
    assert list(pruned.get_xdata()) == [2.0] and list(finished.get_xdata()) == [1.0, 3.0]
    assert list(selected.get_xdata()) == [3.0] and list(selected.get_ydata()) == [0.2]


def test_shares_of_pushes_from_behind_are_in_the_legend() -> None:
    figure = pushes_figure({"first": RECORDS[0], "best": RECORDS[2]})
    assert [panel.get_title("left") for panel in figure.axes] == ["continuous", "discrete"]
    words = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert words == ["first: 50% below 60°", "best: 100% below 60°"]
