"""The search for the handcrafted heuristic's weights: what it does with results, and that nothing else affects it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from tests.evaluation.samples import sample_result
from visualrhp.errors import ConfigError, DataError
from visualrhp.evaluation.journal import Journal
from visualrhp.evaluation.weight_search import (
    CheckConfig,
    SearchConfig,
    SearchResult,
    SelectionConfig,
    TrialEpisode,
    TrialRecord,
    TrialTask,
    WeightSearch,
    objective,
    run_once,
)
from visualrhp.heuristics.crafted import CostToGo

SEARCH = SearchConfig(
    num_trials=40,
    num_random_trials=10,
    num_instances=4,
    block=2,
    action_cost=0.25,
    ranges={
        "reach": (2.0, 60.0),
        "turn": (0.05, 5.0),
        "carry": (20.0, 80.0),
        "align": (0.3, 10.0),
        "face": (0.05, 5.0),
    },
)


def pretended(tasks: Sequence[TrialTask]) -> list[TrialEpisode]:
    """The nearer reach is to 60, the more tasks are solved, in fewer actions; the other weights have no effect."""
    episodes = []
    for task in tasks:
        distance = abs(math.log(task.weights["reach"] / 60.0))
        success = 0.25 * (task.index % 4) + 0.2 < 1.2 - distance
        episodes.append(TrialEpisode(success, not success, 10 + int(5 * distance), (distance,)))
    return episodes


def make_search(seed: int = 0, search: SearchConfig = SEARCH) -> WeightSearch:
    return WeightSearch(
        start=CostToGo(reach=18.0),
        action_spaces=("continuous", "discrete"),
        seed=seed,
        search=search,
        selection=SelectionConfig(num_finalists=2, num_instances=3),
        check=CheckConfig(num_instances=2),
        run=pretended,
    )


@pytest.fixture(scope="module")
def found() -> SearchResult:
    search = make_search()
    return search.finish(list(search.trials()))


def test_it_finds_the_best_weights(found: SearchResult) -> None:
    assert found.best.weights["reach"] == pytest.approx(60.0, rel=0.15)
    assert found.weights == asdict(CostToGo()) | found.best.weights, "weights without a range stay"
    assert found.best_check.objective > found.start_check.objective
    assert all(episode.success for episode in found.best_check.episodes["discrete"])
    assert sum(record.is_pruned for record in found.searched) >= 2
    assert found.start_check.weights["reach"] == 18.0


def test_proposals_come_from_results_and_from_the_seed(found: SearchResult) -> None:
    def error(values: list[float]) -> float:
        return sum(abs(math.log(value / 60.0)) for value in values) / len(values)

    first = [record.weights["reach"] for record in found.searched]
    second = [record.weights["reach"] for record in make_search(seed=1).trials()]
    assert first[0] == second[0] == 18.0, "the weights to start from"
    assert first[1:] != second[1:]
    for values in (first, second):
        assert error(values[25:]) < 0.5 * error(values[1:10])


def test_the_same_seed_gives_the_same_records(found: SearchResult) -> None:
    again = make_search()
    assert again.finish(list(again.trials())) == found


def test_a_proposal_is_a_function_of_the_trials_before_it(found: SearchResult) -> None:
    trial, weights = make_search().propose(found.searched[:12])
    assert (trial.number, weights) == (12, found.searched[12].weights)


def test_the_steps_share_no_instance() -> None:
    seen: list[set[int]] = []

    def watched(tasks: Sequence[TrialTask]) -> list[TrialEpisode]:
        seen[-1].update(task.index for task in tasks)
        return pretended(tasks)

    search = replace(make_search(search=replace(SEARCH, num_trials=3, num_random_trials=3)), run=watched)
    seen.append(set())
    searched = list(search.trials())
    seen.append(set())
    _, best = search.select(searched)
    seen.append(set())
    search.checks(searched[0], best)
    assert [len(indices) for indices in seen] == [4, 3, 2]
    assert len(set.union(*seen)) == 9
    assert [min(indices) for indices in seen] == list(search.first_instances.values())


def test_a_hopeless_trial_is_stopped_early(found: SearchResult) -> None:
    pruned = [record for record in found.searched if record.is_pruned]
    assert {record.num_instances for record in pruned} == {2}
    finished = [record.curve[2] for record in found.searched if not record.is_pruned]
    assert max(record.objective for record in pruned) < max(finished)


def test_the_selection_decides_not_the_search() -> None:
    searched = [
        TrialRecord("search", trial, {"reach": reach}, {4: value}, {}, is_pruned=False)
        for trial, (reach, value) in enumerate([(18.0, 0.5), (100.0, 0.9), (60.0, 0.8), (61.0, 0.1)])
    ]
    selected, winner = make_search().select(searched)
    assert winner is searched[2]
    assert {record.trial for record in selected} == {0, 1, 2}


def test_objective_by_hand() -> None:
    """A failure is as bad as 49 actions without success, however early it came."""
    solved, dropped = TrialEpisode(True, False, 7, ()), TrialEpisode(False, True, 1, ())
    assert objective([solved], 0.7) == pytest.approx(0.9)
    assert objective([solved, dropped], 0.7) == pytest.approx((0.9 - 0.7) / 2)
    assert objective([solved, dropped], 0.0) == 0.5


def test_an_episode_is_reduced_to_what_counts() -> None:
    episode = TrialEpisode.of(sample_result(num_actions=3))
    assert episode == TrialEpisode(True, False, 3, (0.0, 0.0, 0.0)), "pushes from straight behind"
    assert TrialEpisode.from_json(asdict(episode)) == episode


def test_an_episode_is_run_once(tmp_path: Path) -> None:
    ran: list[int] = []

    def run(tasks: Sequence[TrialTask]) -> Iterator[tuple[TrialTask, TrialEpisode]]:
        ran.extend(task.index for task in tasks)
        yield from reversed(list(zip(tasks, pretended(tasks), strict=True)))

    def runner():
        return run_once(run, Journal(tmp_path / "episodes.jsonl"))

    tasks = [TrialTask({"reach": 20.0 / 3.0}, "discrete", index) for index in range(3)]
    first = runner()(tasks[:2])
    assert first == pretended(tasks[:2])
    assert runner()(tasks[:2]) == first
    assert runner()([tasks[2], tasks[0]]) == [*pretended(tasks[2:]), first[0]]
    assert ran == [0, 1, 2]
    runner()([TrialTask({"reach": 6.667}, "discrete", 0)])
    runner()([TrialTask({"reach": 20.0 / 3.0}, "continuous", 0)])
    assert ran == [0, 1, 2, 0, 0], "other weights or another action space are another episode"


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        ({}, "ranges is empty"),
        ({"fcae": (1.0, 2.0)}, r"ranges\.fcae is not a weight\. Did you mean face\?"),
        ({"reach": (3.0, 2.0)}, r"ranges\.reach=\[3, 2\]: the smaller bound comes first"),
        ({"reach": (0.0, 2.0)}, r"ranges\.reach\[0\]=0.* is out of range"),
    ],
)
def test_a_wrong_range_is_named(ranges: dict[str, tuple[float, float]], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        SearchConfig(40, 10, 4, 2, 0.25, ranges)


@pytest.fixture(autouse=True)
def quiet_optuna() -> Iterator[None]:
    """Restore the verbosity of Optuna, which the search changes."""
    import optuna

    before = optuna.logging.get_verbosity()
    yield
    optuna.logging.set_verbosity(before)


def test_a_recorded_episode_has_a_schema(tmp_path: Path) -> None:
    path = tmp_path / "episodes.jsonl"
    episode = TrialEpisode(True, False, 8, (0.25, -0.5))
    Journal(path, TrialEpisode).append("a", asdict(episode))
    assert TrialEpisode.from_json(Journal(path, TrialEpisode)["a"]) == episode
    wrong = (
        {"success": 1},
        {"num_actions": "8"},
        {"num_actions": 8.0},
        {"push_angles": None},
        {"push_angles": ["1"]},
        {"x": 1},
    )
    for number, change in enumerate(wrong):
        broken = tmp_path / f"{number}.jsonl"
        Journal(broken).append("a", asdict(episode) | change)
        with pytest.raises(DataError, match=rf"{number}\.jsonl is damaged: line 1"):
            Journal(broken, TrialEpisode)
