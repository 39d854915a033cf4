"""What a comparison says, in words."""

from __future__ import annotations

import pandas as pd

from tests.evaluation.samples import report_table, sample_table
from visualrhp.evaluation.report_findings import findings, own_method, success_sentence


def episodes_of(planner: str, successes: int, num_actions: int, n: int | None = None, h: int | None = None):
    """Twenty tasks, of which the first ``successes`` are completed."""
    row = {"planner": planner, "num_rollouts": n, "horizon": h, "num_actions": num_actions}
    return sample_table({**row, "episode": episode, "success": episode < successes} for episode in range(20))


PLUS = episodes_of("VisualRHP+", 20, 5, 3, 3)


def findings_of(*tables: pd.DataFrame) -> list[str]:
    return findings(pd.concat(tables, ignore_index=True))


def test_two_sentences_say_what_search_learning_and_looking_ahead_change() -> None:
    others = [
        episodes_of("K.RRT closed loop", 20, 8),
        episodes_of("Greedy", 10, 5),
        episodes_of("CraftedHeuristicRHP+", 20, 13, 8, 4),
        episodes_of("K.RRT", 20, 8),
    ]
    assert findings_of(PLUS, *others) == [
        "On the same 20 tasks with continuous actions, a learned policy that looks a few actions ahead (VisualRHP+ "
        "3x3) does not complete significantly more or fewer tasks than searching for a plan again in every unforeseen "
        "state (K.RRT closed loop) (+0.0%, p = 1), with shorter plans (−3.0 actions, p < 0.001).",
        "Compared with VisualRHP+ 3x3, its network alone (Greedy) completes fewer tasks (−50.0%, p = 0.002), with "
        "plans that are not significantly longer or shorter (+0.0 actions, p = 1); a handcrafted formula in place of "
        "its network (CraftedHeuristicRHP+ 8x4) does not complete significantly more or fewer tasks (+0.0%, p = 1), "
        "with longer plans (+8.0 actions, p < 0.001).",
    ]


def test_a_difference_that_may_be_chance_is_not_called_one() -> None:
    (sentence,) = findings_of(PLUS, episodes_of("Greedy", 16, 6))  # McNemar: p = 0.125
    assert "(Greedy) does not complete significantly more or fewer tasks (−20.0%, p = 0.12), with longer" in sentence
    (sentence,) = findings_of(PLUS, episodes_of("dhRRT", 0, 8))
    assert sentence.endswith("searching for a plan again after every part of the way (dhRRT) (+100.0%, p < 0.001).")


def test_what_was_not_evaluated_is_left_out() -> None:
    assert findings_of(PLUS) == []
    assert findings_of(episodes_of("mine", 20, 5), episodes_of("K.RRT", 20, 5)) == []
    assert own_method(["K.RRT", "Greedy"]) == "Greedy" and own_method(["VisualRHP 3x3", "x"]) == "VisualRHP 3x3"


def test_success_rates_are_those_of_the_first_action_space() -> None:
    sentence = success_sentence(report_table())
    assert sentence.startswith("VisualRHP 3x3 completes ") and "with continuous actions; Greedy" in sentence
