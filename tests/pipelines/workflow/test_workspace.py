"""Work folders: resumed by content, locked, cleaned, and whole or gone."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import pytest
from filelock import FileLock

from pipelines.config import TrainILConfig
from pipelines.workflow.app import compose
from pipelines.workflow.workspace import (
    RUNS_SUFFIX,
    discard,
    discarded_folder,
    is_locked,
    locked,
    open_work,
    work_folder,
)
from visualrhp.errors import StorageError


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


def configure(*overrides: str) -> TrainILConfig:
    return compose("train_il", TrainILConfig, overrides)


def fail(error: Exception, *overrides: str) -> None:
    """Work that adds a letter to a file and then fails."""
    with open_work(configure(*overrides), "train_il") as work, (work / "state").open("a") as file:
        file.write("x")
        raise error


def test_work_is_kept_when_it_fails_and_deleted_when_it_succeeds(repository: Path) -> None:
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            fail(ZeroDivisionError())
    with open_work(configure(), "train_il") as work:
        assert (work / "state").read_text() == "xx"
        work.with_name(work.name + RUNS_SUFFIX).write_text("{}")
    assert list((repository / "outputs" / "work" / "train_il").iterdir()) == []


def test_half_written_files_are_removed_at_the_start(repository: Path) -> None:
    folder = work_folder(configure(), "train_il")
    litter = [folder / ".state.ab12.tmp.safetensors", folder / "artefact" / ".metrics.ab12.tmp.json"]
    for path in litter:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("half")
    discarded_folder(folder).mkdir()
    with open_work(configure(), "train_il") as work:
        assert work == folder
        assert not any(path.exists() for path in litter)
        assert not discarded_folder(folder).exists()


def test_two_processes_do_not_work_in_one_folder(repository: Path) -> None:
    with open_work(configure(), "train_il") as work:
        assert is_locked(work)
        with (
            pytest.raises(StorageError, match=r"Another process is running pipelines\.train_il"),
            open_work(configure(), "train_il"),
        ):
            pass
        with open_work(configure("seed=1"), "train_il") as other:
            assert other != work
        assert work.is_dir()
    assert not is_locked(work)


def test_a_lock_that_a_killed_process_left_is_no_obstacle(repository: Path) -> None:
    folder = work_folder(configure(), "train_il")
    folder.parent.mkdir(parents=True)
    lock = folder.with_name(folder.name + ".lock")
    lock.touch()
    assert not is_locked(folder)
    with FileLock(lock):
        assert is_locked(folder)
    with locked(folder):
        pass


def test_the_artefact_is_checked_before_the_work_folder_is_made(repository: Path) -> None:
    (repository / "thesis").mkdir()
    (repository / "thesis" / "chapter.tex").write_text("ten days of work")
    with pytest.raises(StorageError, match="thesis"), open_work(configure("paths.artefact=thesis"), "train_il"):
        pass
    assert [path.name for path in repository.iterdir()] == ["thesis"]


def test_a_full_disk_is_one_sentence_and_the_work_is_kept(repository: Path) -> None:
    with pytest.raises(StorageError, match=r"no space left .* rerun the command to resume"):
        fail(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    assert (work_folder(configure(), "train_il") / "state").read_text() == "x"


def test_a_work_folder_is_whole_or_gone(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = work_folder(configure(), "train_il")
    folder.mkdir(parents=True)
    runs = folder.with_name(folder.name + RUNS_SUFFIX)
    runs.write_text("{}")

    def killed(path: Path) -> None:
        assert not folder.exists() and path.is_dir()
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        discard(folder)
    assert runs.exists()  # so that the run is not recorded twice


def test_outputs_that_are_a_file_are_named(repository: Path) -> None:
    (repository / "outputs").write_text("")
    with pytest.raises(StorageError, match="is not a folder"), open_work(configure(), "train_il"):
        pass


def test_work_of_other_code_is_not_continued(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = folder()
    monkeypatch.setattr("pipelines.workflow.workspace.code_hash", lambda: "other code")
    assert folder() != reference


def test_a_link_is_no_work_folder(repository: Path) -> None:
    mine = repository / "mine"
    mine.mkdir()
    (mine / ".letter.tmp.docx").write_text("mine")
    path = work_folder(configure(), "train_il")
    path.parent.mkdir(parents=True)
    path.symlink_to(mine)
    with pytest.raises(StorageError, match="is a symbolic link"), open_work(configure(), "train_il"):
        pass
    assert (mine / ".letter.tmp.docx").exists()
