"""Work folders, publishing, cards."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipelines.config import TrainILConfig
from pipelines.workflow.app import compose
from pipelines.workflow.artefacts import card, content_hash, discard, publish, work_folder


@pytest.fixture(autouse=True)
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DVC_ROOT", raising=False)
    return tmp_path


def folder(*overrides: str, **inputs: str) -> Path:
    return work_folder(compose("train_il", TrainILConfig, overrides), "train_il", inputs)


def test_work_is_resumed_only_if_the_result_would_be_the_same(repository: Path) -> None:
    reference = folder()
    assert reference.parent == repository / "outputs" / "work" / "train_il"
    same = (["executor.num_workers=1"], ["tracking=none"], ["paths.artefact=elsewhere"])
    assert {folder(*overrides) for overrides in same} == {reference}
    different = {folder("seed=1"), folder("learner.lr=1"), folder("action_space=discrete"), folder(demonstrations="1f")}
    assert len(different) == 4
    assert reference not in different


def test_equal_values_from_another_scale_are_the_same_work() -> None:
    assert folder("scale=quick", "learner.lr=0.1") == folder("learner.lr=0.1")


def test_other_outputs_have_their_own_work(repository: Path) -> None:
    assert folder("paths.outputs=other").parent == repository / "other" / "work" / "train_il"
    assert folder("paths.outputs=other").name == folder().name


def test_work_is_in_the_repository_when_dvc_runs_a_copy(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    monkeypatch.setenv("DVC_ROOT", str(repository))
    monkeypatch.chdir(tmp_path_factory.mktemp("copy"))
    assert folder().is_relative_to(repository)


def test_publishing_replaces_what_was_there(tmp_path: Path) -> None:
    destination = tmp_path / "a" / "b"
    for number in range(2):
        new = tmp_path / "new"
        new.mkdir()
        (new / f"{number}.txt").write_text("content")
        publish(new, destination)
        assert [path.name for path in destination.iterdir()] == [f"{number}.txt"]
        assert not new.exists()
    assert [path.name for path in destination.parent.iterdir()] == ["b"]


def test_discard_ignores_what_does_not_exist(tmp_path: Path) -> None:
    discard(tmp_path / "absent")


def test_cards_are_the_same_for_the_same_configuration() -> None:
    def one(*overrides: str) -> dict[str, object]:
        config = compose("train_il", TrainILConfig, overrides)
        return card(config, "train_il", metrics={"success_rate": 1.0})

    first = one("executor.num_workers=1", "paths.outputs=here")
    assert first == one("tracking=none", "paths.outputs=there")
    assert json.loads(json.dumps(first))["metrics"] == {"success_rate": 1.0}
    assert first["stage"] == "train_il"
    assert first["seed"] == 0


def test_content_hash_knows_no_order() -> None:
    assert content_hash({"a": 1, "b": [1, 2]}) == content_hash({"b": [1, 2], "a": 1})
    assert content_hash({"a": 1}) != content_hash({"a": 2})
