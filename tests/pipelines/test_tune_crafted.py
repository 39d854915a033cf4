"""The search for the handcrafted heuristic's weights: what it does with results, and that nothing else sways it."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import yaml

from pipelines import tune_crafted as pipeline
from pipelines.app import compose
from pipelines.config import TuneCraftedConfig
from pipelines.tracking import open_run
from pipelines.tune_crafted import Episode, Record, Runner, Unit, objective
from visualrhp.errors import ConfigError
from visualrhp.scene import Split

SETTINGS = (
    "tracking=none",
    "executor.num_workers=1",
    "planner.num_rollouts=2",
    "planner.horizon=2",
    "planner.heuristic.reach=18",
    "scene.num_objects=[1,2]",
    "search.num_trials=6",
    "search.num_random_trials=3",
    "search.num_instances=4",
    "search.block=2",
    "selection.num_instances=3",
    "selection.num_finalists=2",
    "check.num_instances=2",
)


def configure(*overrides: str) -> TuneCraftedConfig:
    return compose("tune_crafted", TuneCraftedConfig, [*SETTINGS, *overrides])


def tuned(work: Path, *overrides: str) -> Path:
    config = configure(*overrides)
    work.mkdir(exist_ok=True)
    with open_run(config, "tune_crafted", "test") as run:
        return pipeline.tune(config, work, run)


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.suffix != ".png"}


def pretend(unit: Unit) -> tuple[Unit, Episode]:
    """As if a task were solved the more often the nearer reach is to 60, in fewer actions, whatever the rest is."""
    distance = abs(math.log(unit.weights["reach"] / 60.0))
    success = 0.25 * (unit.index % 4) + 0.2 < 1.2 - distance
    return unit, Episode(success, not success, 10 + int(5 * distance), (distance,))


@pytest.fixture
def pretended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "run_unit", pretend)


# ----------------------------------------------------------------------------------------------------- with the planner
@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return content(tuned(tmp_path_factory.mktemp("reference")))


def test_the_artefact_says_what_was_tried_and_found(reference: dict[str, bytes], tmp_path: Path) -> None:
    (tmp_path / "trials.csv").write_bytes(reference["trials.csv"])
    table = pd.read_csv(tmp_path / "trials.csv")
    search = table[table["step"] == "search"]
    assert search["trial"].tolist() == list(range(6))
    assert set(table["step"]) == {"search", "selection", "check"}
    card = json.loads(reference["tune_crafted.json"])
    best = card["best"]
    found = yaml.safe_load(reference["best.yaml"])["heuristic"]
    assert found == {"kind": "crafted", **best["weights"]}
    row = search[search["trial"] == best["trial"]].iloc[0]
    assert {name: row[name] for name in ("reach", "turn", "carry", "align", "face")} == {
        name: best["weights"][name] for name in ("reach", "turn", "carry", "align", "face")
    }
    assert found["drop"] == 50.0, "no range, so it stays"
    assert (card["seed"], card["num_trials"], card["num_pruned"]) == (0, 6, int(search["is_pruned"].sum()))
    assert card["num_episodes"] == 2 * table["num_instances"].sum()
    assert "0" in card["results"]["check"]


def test_two_workers_find_the_same(reference: dict[str, bytes], tmp_path: Path) -> None:
    assert content(tuned(tmp_path, "executor.num_workers=2")) == reference


def test_it_goes_on_after_a_kill_as_if_nothing_had_happened(
    reference: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed in every 30th episode, of whichever step, and once in the middle of a line."""
    run_unit, begun = pipeline.run_unit, []

    def killed_at_times(unit: Unit) -> tuple[Unit, Episode]:
        begun.append(unit.key)
        if len(begun) % 30 == 29:
            raise KeyboardInterrupt
        return run_unit(unit)

    monkeypatch.setattr(pipeline, "run_unit", killed_at_times)
    kills = 0
    while True:
        try:
            folder = tuned(tmp_path)
            break
        except KeyboardInterrupt:
            kills += 1
            if kills == 1:
                path = tmp_path / "episodes.jsonl"
                path.write_text(path.read_text()[:-20])
    assert kills >= 2
    assert len(begun) == len(set(begun)) + kills + 1, "only what was in flight is done again, and the broken line"
    assert content(folder) == reference


def test_an_episode_is_run_on_the_instances_for_tuning(monkeypatch: pytest.MonkeyPatch) -> None:
    from visualrhp.evaluation import episodes

    splits, run_task = [], episodes.run_task

    def watched(planner: Any, distribution: Any, seed: int, split: Split, index: int, **others: Any) -> Any:
        splits.append((seed, split, index, planner.heuristic.cost.reach))
        return run_task(planner, distribution, seed, split, index, **others)

    monkeypatch.setattr(episodes, "run_task", watched)
    unit = Unit(configure("seed=3"), {"reach": 5.0}, "discrete", 7)
    same, episode = pipeline.run_unit(unit)
    assert splits == [(3, Split.TUNING, 7, 5.0)]
    assert same is unit
    assert 1 <= episode.num_actions <= 49


# ----------------------------------------------------------------------------------------------- with a known objective
@pytest.mark.usefixtures("pretended")
def test_it_finds_the_best_weights(tmp_path: Path) -> None:
    folder = tuned(tmp_path, "search.num_trials=40", "search.num_random_trials=10")
    found = json.loads((folder / "tune_crafted.json").read_text())
    assert found["best"]["weights"]["reach"] == pytest.approx(60.0, rel=0.15)
    assert found["num_pruned"] >= 2
    best, start = (found["results"]["check"][str(trial)] for trial in (found["best"]["trial"], 0))
    assert best["objective"] > start["objective"]
    assert best["by_action_space"]["discrete"]["success_rate"] == 1.0


@pytest.mark.usefixtures("pretended")
def test_proposals_come_from_what_was_learned_and_from_the_seed(tmp_path: Path) -> None:
    def proposed(name: str, *overrides: str) -> list[float]:
        folder = tuned(tmp_path / name, "search.num_trials=40", "search.num_random_trials=10", *overrides)
        table = pd.read_csv(folder / "trials.csv")
        return table[table["step"] == "search"]["reach"].tolist()

    first, second = proposed("a"), proposed("b", "seed=1")
    assert first[0] == second[0] == 18.0, "the weights of the configuration"
    assert first[1:] != second[1:]

    def error(values: list[float]) -> float:
        return sum(abs(math.log(value / 60.0)) for value in values) / len(values)

    for values in (first, second):
        assert error(values[25:]) < 0.5 * error(values[1:10])


def test_the_steps_share_no_instance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, set[int]] = {"search": set(), "selection": set(), "check": set()}
    run_trial = pipeline.run_trial

    def watched(
        config: Any, runner: Runner, step: str, number: int, weights: Any, instances: range, *others: Any
    ) -> Record:
        seen[step] |= set(instances)
        return run_trial(config, runner, step, number, weights, instances, *others)

    monkeypatch.setattr(pipeline, "run_trial", watched)
    monkeypatch.setattr(pipeline, "run_unit", pretend)
    tuned(tmp_path)
    assert [len(instances) for instances in seen.values()] == [4, 3, 2]
    assert len(set.union(*seen.values())) == 9


@pytest.mark.usefixtures("pretended")
def test_a_hopeless_trial_is_stopped_early(tmp_path: Path) -> None:
    config = configure("search.num_trials=30")
    with open_run(config, "tune_crafted", "test") as run:
        search = pipeline.search(config, Runner(config, tmp_path / "episodes.jsonl"), run)
    pruned = [record for record in search if record.is_pruned]
    assert pruned
    assert {record.num_instances for record in pruned} == {2}
    finished = [record.curve[2] for record in search if not record.is_pruned]
    assert max(record.objective for record in pruned) < max(finished)


@pytest.mark.usefixtures("pretended")
def test_the_selection_decides_not_the_search(tmp_path: Path) -> None:
    config = configure()
    searched = [
        Record("search", trial, {"reach": reach}, {4: value}, {}, is_pruned=False)
        for trial, (reach, value) in enumerate([(18.0, 0.5), (100.0, 0.9), (60.0, 0.8), (61.0, 0.1)])
    ]
    selected, winner = pipeline.select(config, Runner(config, tmp_path / "episodes.jsonl"), searched)
    assert winner is searched[2]
    assert {record.trial for record in selected} == {0, 1, 2}


# ---------------------------------------------------------------------------------------------------------------- parts
def test_objective_by_hand() -> None:
    """A failure is as bad as 49 actions without success, whenever it came."""
    solved, dropped = Episode(True, False, 7, ()), Episode(False, True, 1, ())
    assert objective([solved], 0.7) == pytest.approx(0.9)
    assert objective([solved, dropped], 0.7) == pytest.approx((0.9 - 0.7) / 2)
    assert objective([solved, dropped], 0.0) == 0.5


def test_metrics_by_hand() -> None:
    episodes = [Episode(True, False, 10, (0.1, 1.0, 2.0)), Episode(False, True, 3, (3.0,))]
    metrics = pipeline.space_metrics(episodes)
    assert (metrics["success_rate"], metrics["drop_rate"], metrics["actions"]) == (0.5, 0.5, 10.0)
    assert metrics["from_behind"] == 0.5
    nothing = pipeline.space_metrics(episodes[1:] * 0 + [Episode(False, False, 49, ())])
    assert nothing["actions"] is None
    assert nothing["from_behind"] is None


def test_an_episode_is_run_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[int] = []

    def watched(unit: Unit) -> tuple[Unit, Episode]:
        ran.append(unit.index)
        return pretend(unit)

    monkeypatch.setattr(pipeline, "run_unit", watched)
    config, path = configure(), tmp_path / "episodes.jsonl"
    units = [Unit(config, {"reach": 1.0 / 3.0}, "discrete", index) for index in range(3)]
    runner = Runner(config, path)
    first = runner.run(units[:2])
    assert first == [pretend(unit)[1] for unit in units[:2]]
    assert Runner(config, path).run(units[:2]) == first
    assert Runner(config, path).run([units[2], units[0]]) == [pretend(units[2])[1], first[0]]
    assert ran == [0, 1, 2]
    assert runner.run([Unit(config, {"reach": 0.33}, "discrete", 0)]), "other weights, another episode"
    assert runner.run([Unit(config, {"reach": 1.0 / 3.0}, "continuous", 0)])
    assert ran == [0, 1, 2, 0, 0]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("search.ranges.reach=[3,2]", r"search\.ranges\.reach=\[3, 2\]: the smaller bound comes first"),
        ("search.ranges.reach=[0,2]", r"search\.ranges\.reach\[0\]=0 is out of range"),
        ("search.ranges.reach=[20,40]", r"planner\.heuristic\.reach=18, the first to be tried, is not in search"),
        ("+search.ranges.fcae=[1,2]", r"search\.ranges\.fcae is no weight\. Did you mean face\?"),
        ("search.ranges=null", r"search\.ranges"),
        ("action_spaces=[]", r"action_spaces=\[\]"),
        ("action_spaces=[discrete,discrete]", r"several different ones"),
        ("planner=kinodynamic_rrt", r"planner\.name=K\.RRT has no handcrafted heuristic"),
        ("planner.deadline_s=0.1", r"planner\.deadline_s=0\.1: .* has to be null"),
        ("planner=visual_rhp", r"choose planner=crafted_heuristic_rhp"),
        ("search.num_trials=0", r"search\.num_trials=0 is out of range"),
    ],
)
def test_a_mistake_is_named(override: str, words: str) -> None:
    start = [] if "planner=" in override else ["planner.heuristic.reach=18"]
    with pytest.raises(ConfigError, match=words):
        compose("tune_crafted", TuneCraftedConfig, [*start, override])


def test_without_optuna_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(ConfigError, match="pip install optuna"):
        pipeline.check_libraries(configure())


@pytest.fixture(autouse=True)
def quiet_optuna() -> Iterator[None]:
    """What the search changes of Optuna's settings is put back."""
    import optuna

    before = optuna.logging.get_verbosity()
    yield
    optuna.logging.set_verbosity(before)
