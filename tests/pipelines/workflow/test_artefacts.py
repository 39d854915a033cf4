"""Hashes and cards of artefacts."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from pipelines.config import TrainILConfig
from pipelines.workflow.app import compose
from pipelines.workflow.artefacts import card, code_hash, content_hash, git_commit


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


@pytest.mark.parametrize(
    "failure",
    [
        FileNotFoundError("git"),
        subprocess.TimeoutExpired("git", 20.0),
        subprocess.CalledProcessError(128, "git"),
        PermissionError("git"),
    ],
)
def test_without_git_the_commit_is_unknown(failure: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise failure

    git_commit.cache_clear()
    monkeypatch.setattr(subprocess, "run", fail)
    assert git_commit() is None
    git_commit.cache_clear()


def test_another_repository_in_the_environment_is_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    git_commit.cache_clear()
    expected = git_commit()
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    monkeypatch.setenv("GIT_DIR", str(tmp_path / ".git"))
    git_commit.cache_clear()
    assert git_commit() == expected
    git_commit.cache_clear()


def test_the_hash_of_the_code_is_that_of_all_files() -> None:
    assert len(code_hash()) == 64
    code_hash.cache_clear()
    assert code_hash() == code_hash()
