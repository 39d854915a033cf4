"""What a comparison of methods says, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import pandas as pd

from visualrhp.evaluation.methods import ACTION_SPACES, order_methods, with_labels
from visualrhp.evaluation.metrics import summarize
from visualrhp.evaluation.paired import SEARCHES, compare_methods
from visualrhp.evaluation.summaries import percent

SIGNIFICANCE: Final = 0.05
"""A difference with a smaller p value is called one."""

_BASELINES: Final = ("VisualRHP 3x3", "Greedy", "CraftedHeuristicRHP 8x4", "K.RRT")
"""The methods whose success rates follow that of the headline's method."""

_SEARCHING: Final = {
    "K.RRT closed loop": "searching for a plan again in every unforeseen state",
    "dhRRT": "searching for a plan again after every part of the way",
    "K.RRT": "searching for a plan once",
}

_CRAFTED: Final = {"VisualRHP+ 3x3": "CraftedHeuristicRHP+ 8x4", "VisualRHP 3x3": "CraftedHeuristicRHP 8x4"}
"""The methods of the headline, and what they are with a formula in place of the network."""


def own_method(methods: Sequence[str]) -> str:
    """The method that the headline is about: VisualRHP+, VisualRHP, or else the first."""
    return next(name for name in (*_CRAFTED, *order_methods(methods)) if name in methods)


def findings(main: pd.DataFrame) -> list[str]:
    """What the evaluation says about learning and looking ahead: at most two sentences.

    The first compares the headline's method with searching for plans, the second with what lacks its look-ahead or its
    network. They are about the first action space, and leave out what was not evaluated.

    Args:
        main: the episodes of the headline numbers (:func:`visualrhp.evaluation.summaries.main_rows`).
    """
    space, rows = _first_space(main)
    own = own_method(rows["method"].tolist())
    if own not in _CRAFTED:
        return []

    def compared(method: str, reference: str) -> dict[str, float] | None:
        return compare_methods(rows, method, reference)

    sentences = []
    for search in SEARCHES:
        if row := compared(own, search):
            sentences.append(
                f"On the same {row['tasks']} tasks with {space} actions, a learned policy that looks a few actions "
                f"ahead ({own}) {_predicate(row, f'{_SEARCHING[search]} ({search})')}."
            )
            break
    lacking = {"Greedy": "its network alone", _CRAFTED[own]: "a handcrafted formula in place of its network"}
    clauses = [
        f"{words} ({name}) {_predicate(row, '')}" for name, words in lacking.items() if (row := compared(name, own))
    ]
    if clauses:
        sentences.append(f"Compared with {own}, {'; '.join(clauses)}.")
    return sentences


def success_sentence(main: pd.DataFrame) -> str:
    """The success rates of the headline's method and of the baselines in the first action space."""
    space, rows = _first_space(main)
    rates = {row["method"]: row for row in summarize(rows, ["method"]).to_dict("records")}
    own = own_method(list(rates))
    sentence = (
        f"{own} completes {percent(rates[own]['success_rate'])} of the tasks "
        f"({percent(rates[own]['success_rate_low'])} to {percent(rates[own]['success_rate_high'])}) "
        f"with {space} actions"
    )
    others = [f"{name} {percent(rates[name]['success_rate'])}" for name in _BASELINES if name in rates and name != own]
    return f"{sentence}; {', '.join(others)}." if others else f"{sentence}."


def _first_space(main: pd.DataFrame) -> tuple[str, pd.DataFrame]:
    labelled = with_labels(main)
    space = next(space for space in ACTION_SPACES if space in set(labelled["action_space"]))
    return space, labelled.loc[labelled["action_space"] == space]


def _predicate(row: Mapping[str, float], reference: str) -> str:
    """A row of a comparison in words: "completes more tasks than <reference>, with shorter plans", and the numbers."""
    success, p = row["success_difference"], row["success_p"]
    if p < SIGNIFICANCE:
        words = f"completes {'more' if success > 0 else 'fewer'} tasks{f' than {reference}' if reference else ''}"
    else:
        words = f"does not complete significantly more or fewer tasks{f' than {reference}' if reference else ''}"
    predicate = f"{words} ({_signed(100.0 * success)}%, {_p(p)})"
    actions, p = row["actions_difference"], row["actions_p"]
    if math.isnan(actions):  # no task that both completed
        return predicate
    length = "longer" if actions > 0 else "shorter"
    plans = f"{length} plans" if p < SIGNIFICANCE else "plans that are not significantly longer or shorter"
    return f"{predicate}, with {plans} ({_signed(actions)} actions, {_p(p)})"


def _signed(value: float) -> str:
    return f"{round(value, 1) + 0.0:+.1f}".replace("-", "−")


def _p(value: float) -> str:
    return "p < 0.001" if value < 1e-3 else f"p = {value:.2g}"
