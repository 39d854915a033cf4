"""Publishing: only an earlier artefact of the same stage is ever replaced."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
from filelock import FileLock

from pipelines.workflow.publishing import (
    MARK,
    check_destination,
    check_files,
    copy_artefacts,
    publish,
    publish_files,
    read_mark,
    recover,
)
from visualrhp.errors import DataError, StorageError


def made(parent: Path, content: str = "content") -> Path:
    """A finished artefact."""
    folder = parent / "made"
    folder.mkdir(parents=True)
    (folder / "result.txt").write_text(content)
    return folder


def snapshot(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): path.read_text() if path.is_file() else "folder" for path in folder.rglob("*")
    }


@pytest.fixture
def artefact(tmp_path: Path) -> Path:
    """An artefact of the stage "evaluate"."""
    destination = tmp_path / "outputs" / "evaluate"
    publish(made(tmp_path), destination, "evaluate")
    return destination


def test_an_artefact_of_the_same_stage_is_replaced(tmp_path: Path, artefact: Path) -> None:
    new = made(tmp_path, "new")
    publish(new, artefact, "evaluate")
    assert (artefact / "result.txt").read_text() == "new"
    assert not new.exists()
    assert [path.name for path in artefact.parent.iterdir()] == ["evaluate"]
    mark = read_mark(artefact)
    assert mark is not None and (mark.stage, list(mark.files)) == ("evaluate", ["result.txt"])


def test_the_mark_is_a_function_of_the_content(tmp_path: Path, artefact: Path) -> None:
    publish(made(tmp_path), tmp_path / "other", "evaluate")
    assert (tmp_path / "other" / MARK).read_bytes() == (artefact / MARK).read_bytes()


@pytest.mark.parametrize("kind", ["a folder", "a subfolder", "a file", "a link", "a dangling link", "a damaged mark"])
def test_what_belongs_to_the_user_is_not_replaced(tmp_path: Path, kind: str) -> None:
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    destination = tmp_path / "destination"
    if kind == "a folder":
        destination = thesis
        (thesis / "chapter.tex").write_text("ten days of work")
    elif kind == "a subfolder":
        destination = thesis
        (thesis / "figures" / "drafts").mkdir(parents=True)
    elif kind == "a file":
        destination.write_text("notes")
    elif kind == "a link":
        destination.symlink_to(thesis)
    elif kind == "a dangling link":
        destination.symlink_to(tmp_path / "nowhere")
    else:
        destination = thesis
        (thesis / MARK).write_text("[]")
    before = snapshot(tmp_path)
    with pytest.raises(StorageError, match="Nothing was changed"):
        check_destination(destination, "evaluate")
    finished = made(tmp_path / "work")
    with pytest.raises(StorageError):
        publish(finished, destination, "evaluate")
    assert (finished / "result.txt").read_text() == "content"
    assert {name: text for name, text in snapshot(tmp_path).items() if not name.startswith("work")} == before


def test_artefacts_of_other_stages_are_not_replaced(artefact: Path) -> None:
    with pytest.raises(StorageError, match=r"made by pipelines\.evaluate, so pipelines\.report"):
        check_destination(artefact, "report")


@pytest.mark.parametrize("name", ["notes.md", "result.txt", "folder/notes.md", ".hidden"])
def test_an_artefact_with_files_of_the_user_is_not_replaced(artefact: Path, name: str) -> None:
    (artefact / name).parent.mkdir(exist_ok=True)
    (artefact / name).write_text("mine")
    with pytest.raises(StorageError, match=rf"added or changed since it was made \({name}\)"):
        check_destination(artefact, "evaluate")


def test_files_of_the_desktop_and_missing_files_are_no_obstacle(artefact: Path) -> None:
    (artefact / ".DS_Store").write_text("icons")
    (artefact / "result.txt").unlink()
    check_destination(artefact, "evaluate")


@pytest.mark.parametrize("path", [".", "..", "outputs"])
def test_folders_above_the_artefact_are_not_replaced(
    artefact: Path, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(artefact.parents[1])
    with pytest.raises(StorageError, match="is not empty and was not made"):
        check_destination(path, "evaluate")


def test_artefacts_with_another_identity_are_not_replaced(tmp_path: Path) -> None:
    publish(made(tmp_path), tmp_path / "export", "export_demos", "parquet, num_objects=4")
    check_destination(tmp_path / "export", "export_demos", "parquet, num_objects=4")
    with pytest.raises(StorageError, match="holds another export"):
        check_destination(tmp_path / "export", "export_demos", "parquet, num_objects=all")


def test_an_empty_folder_is_used(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    publish(made(tmp_path), tmp_path / "empty", "evaluate")
    assert (tmp_path / "empty" / "result.txt").is_file()


def test_half_written_files_are_not_published(tmp_path: Path) -> None:
    folder = made(tmp_path)
    (folder / ".metrics.ab12.tmp.json").write_text("{")
    publish(folder, tmp_path / "published", "evaluate")
    assert sorted(path.name for path in (tmp_path / "published").iterdir()) == [MARK, "result.txt"]


@pytest.mark.parametrize(
    "moment", ["before the old one is moved", "between the renames", "before the old one is deleted"]
)
def test_a_killed_publication_is_undone_or_finished(tmp_path: Path, artefact: Path, moment: str) -> None:
    arrived, previous = (artefact.with_name(f".evaluate.visualrhp-{word}") for word in ("new", "old"))
    if moment == "before the old one is moved":
        made(tmp_path, "new").rename(arrived)
    elif moment == "between the renames":
        made(tmp_path, "new").rename(arrived)
        artefact.rename(previous)
    else:
        artefact.rename(previous)
        made(tmp_path, "new").rename(artefact)
    recover(artefact)
    assert (artefact / "result.txt").read_text() == ("new" if moment.endswith("deleted") else "content")
    assert [path.name for path in artefact.parent.iterdir()] == ["evaluate"]


def test_folders_that_cannot_be_made_are_found_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="is not a folder"):
        check_destination(tmp_path / "file" / "a" / "b", "evaluate")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(StorageError, match="is not writable"):
        check_destination(tmp_path / "a" / "b", "evaluate")


# -------------------------------------------------------------------------------------------- files in a shared folder
def test_files_are_published_among_others(tmp_path: Path) -> None:
    shared = tmp_path / "play"
    names = ["a.webm", "a.json"]
    for number in range(2):
        work = tmp_path / f"work{number}"
        work.mkdir()
        (work / "a.webm").write_text(f"video {number}")
        (work / "a.json").write_text('{"stage": "play"}')
        publish_files(work, shared, names, "play")
        (shared / "mine.txt").write_text("mine")
        assert (shared / "a.webm").read_text() == f"video {number}"
    assert sorted(path.name for path in shared.iterdir()) == ["a.json", "a.webm", "mine.txt"]


@pytest.mark.parametrize("content", [None, "[]", "{}", '{"stage": "evaluate"}'])
def test_files_of_the_user_are_not_replaced(tmp_path: Path, content: str | None) -> None:
    (tmp_path / "a.webm").write_text("mine")
    if content is not None:
        (tmp_path / "a.json").write_text(content)
    with pytest.raises(StorageError, match=r"was not made by pipelines\.play"):
        check_files(tmp_path, ["a.webm", "a.json"], "play")


# ------------------------------------------------------------------------------------------------------------- copies
def test_a_copy_keeps_its_content_when_the_artefact_is_replaced_or_overwritten(tmp_path: Path, artefact: Path) -> None:
    copy = copy_artefacts(artefact, tmp_path / "inputs")
    with (artefact / "result.txt").open("w") as file:
        file.write("in place")
    assert (copy / "result.txt").read_text() == "content"


@pytest.mark.parametrize("kind", ["dangling link", "the inputs themselves", "link to itself"])
def test_folders_that_cannot_be_copied_are_named(tmp_path: Path, artefact: Path, kind: str) -> None:
    into = tmp_path / "inputs"
    if kind == "dangling link":
        (artefact / "notes").symlink_to("nowhere")
    elif kind == "link to itself":
        (artefact / "notes").symlink_to("notes")
    else:
        into = artefact / "work" / "inputs"
    with pytest.raises(DataError, match=r"evaluate c(annot be copied|ontains the outputs)"):
        copy_artefacts(artefact / ".." / "evaluate", into)


def test_two_processes_do_not_publish_at_once(tmp_path: Path, artefact: Path) -> None:
    lock = FileLock(artefact.with_name(".evaluate.visualrhp-lock"))
    (artefact.with_name(".evaluate.visualrhp-new")).mkdir()
    done: list[bool] = []

    def recovering() -> None:
        recover(artefact)
        done.append(True)

    with lock:
        thread = threading.Thread(target=recovering)
        thread.start()
        thread.join(0.2)
        assert not done
        assert artefact.with_name(".evaluate.visualrhp-new").is_dir()  # another process is moving it into place
    thread.join(10.0)
    assert done
    assert [path.name for path in artefact.parent.iterdir()] == ["evaluate"]


@pytest.mark.parametrize("name", ["work", "work/evaluate", "mlflow.db", "."])
def test_the_pipelines_own_folders_hold_no_artefact(tmp_path: Path, name: str) -> None:
    with pytest.raises(StorageError, match="belongs to the pipelines"):
        check_destination(tmp_path / name, "evaluate", reserved=[tmp_path / "work", tmp_path / "mlflow.db"])


def test_links_to_equal_files_are_no_change(tmp_path: Path, artefact: Path) -> None:
    """As those that DVC makes to its cache."""
    (artefact / "result.txt").rename(tmp_path / "cached")
    (artefact / "result.txt").symlink_to(tmp_path / "cached")
    check_destination(artefact, "evaluate")
    (tmp_path / "cached").write_text("changed")
    with pytest.raises(StorageError, match="added or changed"):
        check_destination(artefact, "evaluate")


def test_old_and_new_files_are_never_mixed(tmp_path: Path, artefact: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import shutil

    intact, replaced = shutil.copytree, []

    def replaced_meanwhile(*args: object, **kwargs: object) -> object:
        result = intact(*args, **kwargs)  # type: ignore[arg-type]
        if not replaced:
            replaced.append(True)
            publish(made(tmp_path, "new"), artefact, "evaluate")
        return result

    monkeypatch.setattr(shutil, "copytree", replaced_meanwhile)
    copy = copy_artefacts(artefact, tmp_path / "inputs")
    assert (copy / "result.txt").read_text() == "new"
    assert (copy / MARK).read_bytes() == (artefact / MARK).read_bytes()


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="nowhere does not exist"):
        copy_artefacts(tmp_path / "nowhere", tmp_path / "inputs")
