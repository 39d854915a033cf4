"""Generating demonstrations: the same bytes with any number of workers and after any interruption."""

from __future__ import annotations

import errno
import json
import os
import resource
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipelines import generate_demos
from pipelines.config import ExecutorConfig, GenerateDemosConfig
from pipelines.workflow import executor as workflow_executor
from pipelines.workflow.app import compose
from pipelines.workflow.publishing import check_destination, publish
from pipelines.workflow.surroundings import explain_storage
from pipelines.workflow.tracking import open_run
from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.errors import ConfigError, DataError, StorageError
from visualrhp.files import detect_full_disk

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
    monkeypatch.setattr(generate_demos, "write_pictures", lambda *_: None)


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
        patch.setattr(generate_demos, "write_pictures", lambda *_: None)
        return content(generate(tmp_path_factory.mktemp("reference")))


def test_the_set_has_what_was_asked_for_and_failures_are_replaced(tmp_path: Path, reference: dict[str, bytes]) -> None:
    for name, data in reference.items():
        (tmp_path / name).write_bytes(data)
    stored = DemonstrationSet.open(tmp_path, "continuous")
    metrics = json.loads(reference["metrics.json"])
    assert len(stored) == metrics["demonstrations"] == 21
    failed = stored.card["failed_indices"]
    assert 0 < len(failed) == metrics["failures"]
    assert sorted([*stored.indices.tolist(), *failed]) == list(range(metrics["attempts"]))
    assert metrics["solved_rate"] == 21 / metrics["attempts"]
    assert metrics["transitions"] == stored.num_transitions
    assert stored.card["config"]["planner"]["max_simulations"] == 80
    rows = [row.split(",") for row in reference["lengths.csv"].decode().split()]
    assert rows[0] == ["num_objects", "actions", "demonstrations"]
    assert sum(int(number) for _, _, number in rows[1:]) == 21


@pytest.mark.parametrize("num_workers", [2, 4])
def test_several_workers_make_the_same_bytes(tmp_path: Path, reference: dict[str, bytes], num_workers: int) -> None:
    assert content(generate(tmp_path, f"executor.num_workers={num_workers}")) == reference


def test_interrupted_and_restarted_makes_the_same_bytes_and_keeps_finished_blocks(
    tmp_path: Path, reference: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    attempted: list[range] = []
    undisturbed = workflow_executor.run_tasks

    def interrupted_after_two(
        function: Callable[[Any], Any], items: Iterable[Any], executor: ExecutorConfig
    ) -> Iterator[Any]:
        for number, item in enumerate(reversed(list(items))):  # out of order, as among several workers
            attempted.append(item)
            yield from undisturbed(function, [item], executor)
            if number == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr(workflow_executor, "run_tasks", interrupted_after_two)
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


def test_a_damaged_block_is_generated_again(tmp_path: Path, reference: dict[str, bytes]) -> None:
    generate(tmp_path)
    block = tmp_path / "blocks" / "block-000001.npz"
    before = block.read_bytes()
    block.write_bytes(before[: len(before) // 2])
    assert content(generate(tmp_path)) == reference


# -------------------------------------------------- a published set that was damaged
def published(tmp_path: Path, reference: dict[str, bytes]) -> Path:
    folder = tmp_path / "published"
    folder.mkdir()
    for name, data in reference.items():
        (folder / name).write_bytes(data)
    return folder


@pytest.mark.parametrize(("number", "how"), [(0, "truncated"), (1, "bit-flipped"), (2, "missing")])
def test_a_damaged_shard_is_named_and_generated_again(
    tmp_path: Path, reference: dict[str, bytes], caplog: pytest.LogCaptureFixture, number: int, how: str
) -> None:
    folder = published(tmp_path, reference)
    path = folder / f"shard-{number:05d}.npz"
    untouched = {name: (folder / name).stat().st_mtime_ns for name in reference if name != path.name}
    if how == "missing":
        path.unlink()
    elif how == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    else:
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(data)
    with pytest.raises(DataError, match=path.name):
        DemonstrationSet.open(folder)
    assert generate_demos.is_published(configure(), folder, tmp_path / "work")
    assert path.name in caplog.text
    assert content(folder) == reference
    assert {name: (folder / name).stat().st_mtime_ns for name in untouched} == untouched


def test_a_set_of_other_code_or_configuration_is_not_repaired(tmp_path: Path, reference: dict[str, bytes]) -> None:
    folder = published(tmp_path, reference)
    (folder / "shard-00001.npz").unlink()
    assert not generate_demos.is_published(configure("seed=1"), folder, tmp_path / "work")
    assert not generate_demos.is_published(configure(), tmp_path / "nothing", tmp_path / "work")
    card = json.loads(reference["card.json"])
    (folder / "card.json").write_text(json.dumps(card | {"commit": "0" * 40}))
    assert not generate_demos.is_published(configure(), folder, tmp_path / "work")
    assert not (tmp_path / "work").exists()
    card["shards"][1]["sha256"] = "0" * 64  # it differs when generated again
    (folder / "card.json").write_text(json.dumps(card))
    assert not generate_demos.is_published(configure(), folder, tmp_path / "work")
    assert not (folder / "shard-00001.npz").exists()


def test_an_intact_set_is_not_changed_if_the_code_is_known(
    tmp_path: Path, reference: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = published(tmp_path, reference)
    card = json.loads(reference["card.json"])
    for commit, is_known in (("1" * 40, True), (f"{'1' * 40}-dirty", False), (None, False)):
        monkeypatch.setattr("pipelines.workflow.artefacts.git_commit", lambda commit=commit: commit)
        (folder / "card.json").write_text(json.dumps(card | {"commit": commit}))
        assert generate_demos.is_published(configure(), folder, tmp_path / "work") == is_known


# -------------------------------------------------- a full disk
def test_a_full_disk_is_explained_and_generation_resumes_from_the_finished_shards(
    tmp_path: Path, reference: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full in the middle of the third shard."""
    intact, written = np.savez, []

    def on_a_full_disk(file: Any, **arrays: Any) -> None:
        if Path(file.name).name.startswith(".shard"):
            written.append(file.name)
            if len(written) == 3:
                file.write(b"half a shard")
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        intact(file, **arrays)

    monkeypatch.setattr(np, "savez", on_a_full_disk)
    with (
        pytest.raises(StorageError, match=r"no space left .* rerun the command to resume"),
        explain_storage(tmp_path),
    ):
        generate(tmp_path)
    kept = content(tmp_path / "set")
    assert kept == {name: reference[name] for name in ("shard-00000.npz", "shard-00001.npz")}
    blocks = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "blocks").iterdir()}
    monkeypatch.undo()
    monkeypatch.setattr(generate_demos, "write_pictures", lambda *_: None)
    assert content(generate(tmp_path)) == reference
    assert {name: (tmp_path / "blocks" / name).stat().st_mtime_ns for name in blocks} == blocks


def test_a_file_that_cannot_grow_is_a_full_disk(tmp_path: Path, reference: dict[str, bytes]) -> None:
    """The operating system itself refuses: the limit of the size of a file is below that of a shard."""
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    generate(tmp_path)
    largest_block = max(path.stat().st_size for path in (tmp_path / "blocks").iterdir())
    assert largest_block + 1 < len(reference["shard-00000.npz"])
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest_block + 1, hard))
    try:
        with (
            pytest.raises(StorageError, match=r"no space left .*File too large"),
            explain_storage(tmp_path),
        ):
            generate(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert content(generate(tmp_path)) == reference


def test_a_disk_that_the_video_filled_is_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenCV does not say so."""
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=100))
    with (
        pytest.raises(StorageError, match="no space left"),
        explain_storage(tmp_path),
        detect_full_disk(tmp_path),
    ):
        pass
    monkeypatch.undo()
    with detect_full_disk(tmp_path):
        pass


def test_other_errors_are_not_reported_as_a_full_disk(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="file: Permission denied"), explain_storage(tmp_path):
        raise PermissionError(errno.EACCES, "Permission denied", "file")
    with pytest.raises(ValueError, match="no"), explain_storage(tmp_path):
        raise ValueError("no")


def test_unfinished_files_of_a_killed_process_are_removed(tmp_path: Path, reference: dict[str, bytes]) -> None:
    for folder in ("set", "blocks"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / ".shard-00000.ab12.tmp.npz").write_bytes(b"half")
    assert content(generate(tmp_path)) == reference
    assert not list((tmp_path / "blocks").glob(".*"))


def test_another_seed_makes_another_set(tmp_path: Path, reference: dict[str, bytes]) -> None:
    other = content(generate(tmp_path, "seed=1"))
    assert other["shard-00000.npz"] != reference["shard-00000.npz"]


def test_generation_ends_if_the_planner_solves_hardly_any_task(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"solved 0 of 200 .* planner\.max_simulations"):
        generate(tmp_path, "planner.max_simulations=1", "planner.num_children=1", "planner.num_directed=0", "seed=4")


def test_pictures_show_the_demonstrations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    folder = generate(tmp_path, "demonstrations.count=2", "planner.max_simulations=1000")
    sheet = (folder / "contact_sheet.png").read_bytes()
    assert sheet.startswith(b"\x89PNG")
    assert (folder / "demonstrations.webm").read_bytes()[:4] == b"\x1aE\xdf\xa3"
    assert (folder / "lengths.png").stat().st_size > 1000


@pytest.mark.parametrize("change", ["changed", "added", "deleted"])
def test_a_set_with_files_of_the_user_is_no_published_set(
    tmp_path: Path, reference: dict[str, bytes], change: str
) -> None:
    folder = published(tmp_path, reference)
    publish(folder, tmp_path / "set", "generate_demos")
    path = tmp_path / "set" / ("notes.txt" if change == "added" else "lengths.csv")
    if change == "deleted":
        path.unlink()
    else:
        path.write_text("mine")
    assert not generate_demos.is_published(configure(), tmp_path / "set", tmp_path / "work")
    if change == "deleted":  # then it is made again
        check_destination(tmp_path / "set", "generate_demos")
    else:
        with pytest.raises(StorageError, match="added or changed"):
            check_destination(tmp_path / "set", "generate_demos")
        assert path.read_text() == "mine"
