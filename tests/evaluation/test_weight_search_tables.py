"""Numbers, tables and lines about a search, by hand."""

from __future__ import annotations

from visualrhp.evaluation.weight_search import SearchResult, TrialEpisode, TrialRecord
from visualrhp.evaluation.weight_search_tables import (
    check_lines,
    record_summary,
    result_card,
    space_metrics,
    trials_table,
)

GOOD, BAD = TrialEpisode(True, False, 10, (0.1, 1.0, 2.0)), TrialEpisode(False, True, 3, (3.0,))


def record(step: str, trial: int, episodes: list[TrialEpisode], is_pruned: bool = False) -> TrialRecord:
    return TrialRecord(
        step, trial, {"reach": 1.0 + trial}, {len(episodes): 0.5 + trial}, {"discrete": episodes}, is_pruned
    )


SEARCHED = [record("search", 0, [BAD, BAD]), record("search", 1, [GOOD, BAD]), record("search", 2, [BAD], True)]
RESULT = SearchResult(
    SEARCHED,
    [record("selection", 1, [GOOD])],
    [record("check", 0, [BAD, GOOD]), record("check", 1, [GOOD, GOOD])],
    SEARCHED[1],
    {"reach": 2.0, "drop": 50.0},
)


def test_metrics_by_hand() -> None:
    metrics = space_metrics([GOOD, BAD])
    assert (metrics["success_rate"], metrics["drop_rate"], metrics["actions"]) == (0.5, 0.5, 10.0)
    assert metrics["from_behind"] == 0.5
    nothing = space_metrics([TrialEpisode(False, False, 49, ())])
    assert nothing["actions"] is None
    assert nothing["from_behind"] is None


def test_a_table_has_a_row_per_record() -> None:
    table = trials_table(RESULT.records, ["discrete"])
    assert table["step"].tolist() == ["search", "search", "search", "selection", "check", "check"]
    assert table["reach"].tolist() == [1.0, 2.0, 3.0, 2.0, 1.0, 2.0]
    assert table["is_pruned"].tolist() == [False, False, True, False, False, False]
    assert table["num_instances"].tolist() == [2, 2, 1, 1, 2, 2]
    assert table["success_rate_discrete"].tolist() == [0.0, 0.5, 0.0, 1.0, 0.5, 1.0]
    assert not any(name.endswith(("_low", "_high")) or "_low_" in name for name in table.columns)


def test_the_card_counts_and_summarizes() -> None:
    card = result_card(RESULT)
    assert card["best"] == {"trial": 1, "weights": {"reach": 2.0, "drop": 50.0}}
    assert (card["num_trials"], card["num_pruned"], card["num_episodes"]) == (3, 1, 10)
    assert card["results"]["check"]["1"] == record_summary(RESULT.best_check)
    assert card["results"]["check"]["1"]["by_action_space"]["discrete"]["success_rate"] == 1.0


def test_lines_of_text() -> None:
    first, *lines = check_lines(RESULT).splitlines()
    assert first == "Best: trial 1: reach 2, drop 50. On 2 further instances, first and best weights:"
    assert [line.split()[:3] for line in lines] == [["discrete", "first", "50.0%"], ["discrete", "best", "100.0%"]]
    assert "10.0 actions" in lines[0] and "50% of pushes from behind" in lines[0]
    nothing = SearchResult(SEARCHED, [], [SEARCHED[0]], SEARCHED[0], {})
    assert "- actions" in check_lines(nothing)
