"""The search for the handcrafted heuristic's weights with the planner: what it writes, and that it can be resumed."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import yaml

from pipelines import tune_crafted as pipeline
from pipelines.config import TuneCraftedConfig
from pipelines.workflow.app import compose
from pipelines.workflow.tracking import open_run
from visualrhp.errors import ConfigError
from visualrhp.evaluation.weight_search import TrialEpisode, TrialTask
from visualrhp.execution import episode
from visualrhp.scene import sample_task_instance
from visualrhp.streams import Split

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


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return content(tuned(tmp_path_factory.mktemp("reference")))


def test_the_artefact_has_what_was_tried_and_found(reference: dict[str, bytes], tmp_path: Path) -> None:
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
    assert found["drop"] == 50.0, "without a range it stays"
    assert (card["seed"], card["num_trials"], card["num_pruned"]) == (0, 6, int(search["is_pruned"].sum()))
    assert card["num_episodes"] == 2 * table["num_instances"].sum()
    assert "0" in card["results"]["check"]


def test_two_workers_find_the_same(reference: dict[str, bytes], tmp_path: Path) -> None:
    assert content(tuned(tmp_path, "executor.num_workers=2")) == reference


def test_a_killed_search_is_resumed_with_the_same_result(
    reference: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed in every 30th episode, in any step, and once in the middle of a line."""
    run_unit, begun = pipeline.run_unit, []

    def killed_at_times(config: TuneCraftedConfig, task: TrialTask) -> tuple[TrialTask, TrialEpisode]:
        begun.append(task.key)
        if len(begun) % 30 == 29:
            raise KeyboardInterrupt
        return run_unit(config, task)

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
    assert len(begun) == len(set(begun)) + kills + 1, "only episodes in flight and that of the broken line run again"
    assert content(folder) == reference


def test_an_episode_is_run_on_the_instances_for_tuning(monkeypatch: pytest.MonkeyPatch) -> None:
    tasks, run_task = [], episode.run_task

    def watched(planner: Any, instance: Any, seed: int, split: Split, index: int, **others: Any) -> Any:
        tasks.append((seed, split, index, planner.heuristic.cost.reach))
        assert instance == sample_task_instance(config.scene, 3, Split.TUNING, 7)
        return run_task(planner, instance, seed, split, index, **others)

    monkeypatch.setattr(episode, "run_task", watched)
    config = configure("seed=3")
    task = TrialTask({"reach": 5.0}, "discrete", 7)
    same, result = pipeline.run_unit(config, task)
    assert tasks == [(3, Split.TUNING, 7, 5.0)]
    assert same is task
    assert 1 <= result.num_actions <= 49


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("search.ranges.reach=[3,2]", r"search\.ranges\.reach=\[3, 2\]: the smaller bound comes first"),
        ("search.ranges.reach=[0,2]", r"search\.ranges\.reach\[0\]=0 is out of range"),
        ("search.ranges.reach=[20,40]", r"planner\.heuristic\.reach=18, the first weight, is not in search"),
        ("+search.ranges.fcae=[1,2]", r"search\.ranges\.fcae is not a weight\. Did you mean face\?"),
        ("search.ranges=null", r"search\.ranges"),
        ("action_spaces=[]", r"action_spaces=\[\]"),
        ("action_spaces=[discrete,discrete]", r"several different ones"),
        ("planner=kinodynamic_rrt", r"planner\.name=K\.RRT has no handcrafted heuristic"),
        ("planner.deadline_s=0.1", r"planner\.deadline_s=0\.1: .* must be null"),
        ("planner=visual_rhp", r"choose planner=crafted_heuristic_rhp"),
        ("search.num_trials=0", r"search\.num_trials=0 is out of range"),
    ],
)
def test_a_mistake_is_named(override: str, words: str) -> None:
    start = [] if "planner=" in override else ["planner.heuristic.reach=18"]
    with pytest.raises(ConfigError, match=words):
        compose("tune_crafted", TuneCraftedConfig, [*start, override])


def test_a_missing_optuna_is_an_error_that_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(ConfigError, match="pip install optuna"):
        pipeline.check_libraries()


@pytest.fixture(autouse=True)
def quiet_optuna() -> Iterator[None]:
    """Restore the verbosity of Optuna, which the search changes."""
    import optuna

    before = optuna.logging.get_verbosity()
    yield
    optuna.logging.set_verbosity(before)
