"""Generating demonstrations: the same bytes whatever happens on the way."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pipelines import execution, generate_demos
from pipelines.app import compose
from pipelines.config import ExecutorConfig, GenerateDemosConfig
from pipelines.tracking import open_run
from visualrhp.errors import ConfigError
from visualrhp.learning.demonstrations import DemonstrationSet

SETTINGS = (
    "scale=smoke",
    "tracking=none",
    "executor.num_workers=1",
    "scene.num_objects=[1,2]",
    "demonstrations.count=21",
    "demonstrations.shard_size=10",
    "planner.max_simulations=80",  # some fail
)


@pytest.fixture(autouse=True)
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generate_demos, "_write_pictures", lambda *_: None)


def configure(*overrides: str) -> GenerateDemosConfig:
    return compose("generate_demos", GenerateDemosConfig, [*SETTINGS, *overrides])


def generate(work: Path, *overrides: str) -> Path:
    config = configure(*overrides)
    with open_run(config, "generate_demos", "test") as run:
        return generate_demos.generate(config, work, run)


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate_demos, "_write_pictures", lambda *_: None)
        return content(generate(tmp_path_factory.mktemp("reference")))


def test_the_set_has_what_was_asked_for_and_failures_are_replaced(tmp_path: Path, reference: dict[str, bytes]) -> None:
    for name, data in reference.items():
        (tmp_path / name).write_bytes(data)
    demonstrations = DemonstrationSet.open(tmp_path, "continuous")
    metrics = json.loads(reference["metrics.json"])
    assert len(demonstrations) == metrics["demonstrations"] == 21
    failed = demonstrations.card["failed_indices"]
    assert 0 < len(failed) == metrics["failures"]
    assert sorted([*demonstrations.indices.tolist(), *failed]) == list(range(metrics["attempts"]))
    assert metrics["solved_rate"] == 21 / metrics["attempts"]
    assert metrics["transitions"] == demonstrations.num_transitions
    assert demonstrations.card["config"]["planner"]["max_simulations"] == 80
    rows = [row.split(",") for row in reference["lengths.csv"].decode().split()]
    assert rows[0] == ["num_objects", "actions", "demonstrations"]
    assert sum(int(number) for _, _, number in rows[1:]) == 21


def test_two_workers_make_the_same_bytes(tmp_path: Path, reference: dict[str, bytes]) -> None:
    assert content(generate(tmp_path, "executor.num_workers=2")) == reference


def test_interrupted_and_restarted_makes_the_same_bytes_and_keeps_finished_blocks(
    tmp_path: Path, reference: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    attempted: list[range] = []
    undisturbed = execution.run_tasks

    def interrupted_after_two(
        function: Callable[[Any], Any], items: Iterable[Any], executor: ExecutorConfig
    ) -> Iterator[Any]:
        for number, item in enumerate(reversed(list(items))):  # out of order, as among several workers
            attempted.append(item)
            yield from undisturbed(function, [item], executor)
            if number == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr(execution, "run_tasks", interrupted_after_two)
    restarts = 0
    while True:
        try:
            folder = generate(tmp_path)
            break
        except KeyboardInterrupt:
            restarts += 1
            assert not (tmp_path / "set" / "card.json").exists()
    assert restarts >= 1
    assert len(attempted) == len(set(attempted))
    assert content(folder) == reference


def test_a_damaged_block_is_made_again(tmp_path: Path, reference: dict[str, bytes]) -> None:
    generate(tmp_path)
    block = tmp_path / "blocks" / "block-000001.npz"
    before = block.read_bytes()
    block.write_bytes(before[: len(before) // 2])
    assert content(generate(tmp_path)) == reference


def test_another_seed_makes_another_set(tmp_path: Path, reference: dict[str, bytes]) -> None:
    other = content(generate(tmp_path, "seed=1"))
    assert other["shard-00000.npz"] != reference["shard-00000.npz"]


def test_a_planner_without_a_chance_is_given_up(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"solved 0 of 200 .* planner\.max_simulations"):
        generate(tmp_path, "planner.max_simulations=1", "planner.num_children=1", "planner.num_directed=0", "seed=4")


def test_pictures_show_the_demonstrations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    folder = generate(tmp_path, "demonstrations.count=2", "planner.max_simulations=1000")
    sheet = (folder / "contact_sheet.png").read_bytes()
    assert sheet.startswith(b"\x89PNG")
    assert (folder / "demonstrations.webm").read_bytes()[:4] == b"\x1aE\xdf\xa3"
    assert (folder / "lengths.png").stat().st_size > 1000
