"""Replaying whole sets: the count, and the name of what does not replay."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipelines.config import GenerateDemosConfig, VerifyDemosConfig
from pipelines.verify_demos import main, verify
from pipelines.workflow.app import compose
from pipelines.workflow.artefacts import card
from visualrhp.demonstrations.generate import generate_block
from visualrhp.demonstrations.shards import read_arrays, write_arrays
from visualrhp.demonstrations.writer import DemonstrationWriter
from visualrhp.errors import DataError

SETTINGS = ("scale=smoke", "tracking=none", "executor.num_workers=1")
SPACES = ("continuous", "discrete")


@pytest.fixture(scope="module", params=SPACES)
def made(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> tuple[str, Path]:
    """(action space, folder of a set of 12 in shards of 5)."""
    settings = [*SETTINGS, "scene.num_objects=[1,3]", f"action_space={request.param}", "demonstrations.count=12"]
    config = compose("generate_demos", GenerateDemosConfig, settings)
    folder = tmp_path_factory.mktemp(request.param)
    writer = DemonstrationWriter(folder, request.param, 12, shard_size=5)
    writer.add(generate_block(range(16), config.scene, request.param, config.planner, config.seed, config.physics))
    writer.finish(**card(config, "generate_demos"))
    return request.param, folder


def configure(space: str, folder: Path, outputs: Path, *overrides: str) -> VerifyDemosConfig:
    settings = [*SETTINGS, f"action_space={space}", f"demonstrations={folder}", f"paths.outputs={outputs}", *overrides]
    return compose("verify_demos", VerifyDemosConfig, settings)


@pytest.mark.parametrize("num_workers", [1, 2])
def test_all_replay_and_are_counted(
    tmp_path: Path, made: tuple[str, Path], capsys: pytest.CaptureFixture[str], num_workers: int
) -> None:
    space, folder = made
    result = verify(configure(space, folder, tmp_path, f"executor.num_workers={num_workers}"))
    of_set = json.loads((folder / "card.json").read_text())
    said = capsys.readouterr().out
    assert said.startswith(f"12 of 12 demonstrations ({of_set['num_transitions']} transitions) replay bit-exactly")
    content = json.loads((result / "verification.json").read_text())
    assert content["demonstrations"] == 12 and content["content_hash"] == of_set["content_hash"]


def altered(made: Path, folder: Path, entry: str, number: int, delta: float) -> Path:
    """A copy whose shard 1 has ``delta`` more in a number of an array, and the checksum of what it is now."""
    from visualrhp.demonstrations.dataset import file_hash

    folder.mkdir()
    for path in made.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    path = folder / "shard-00001.npz"
    arrays = read_arrays(path)
    arrays[entry].reshape(-1)[number] += delta
    write_arrays(path, arrays)
    about = json.loads((folder / "card.json").read_text())
    about["shards"][1]["sha256"] = file_hash(path)
    (folder / "card.json").write_text(json.dumps(about))
    return folder


def test_the_first_that_differ_are_named_by_shard_and_index(tmp_path: Path, made: tuple[str, Path]) -> None:
    space, whole = made
    first_index = json.loads((whole / "card.json").read_text())["shards"][1]["first_index"]
    folder = altered(whole, tmp_path / "set", "rewards", 0, 1e-9)
    with pytest.raises(DataError, match=rf"1 of 12 .* shard-00001\.npz, index {first_index}: reward 1 of"):
        verify(configure(space, folder, tmp_path))
    folder = altered(whole, tmp_path / "other", "materials", 0, 1.0)  # a heavier object: another world
    with pytest.raises(DataError, match=rf"shard-00001\.npz, index {first_index}: state \d+ of"):
        verify(configure(space, folder, tmp_path))
    assert not (tmp_path / "verify_demos").exists()


def test_other_physics_than_the_cards_would_be_noticed(
    tmp_path: Path, made: tuple[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    space, folder = made
    about = json.loads((folder / "card.json").read_text())
    other = tmp_path / "set"
    other.mkdir()
    for path in folder.iterdir():
        (other / path.name).write_bytes(path.read_bytes())
    about["config"]["physics"]["gripper_friction"] *= 0.5
    (other / "card.json").write_text(json.dumps(about))
    with pytest.raises(DataError, match=r"of 12 demonstrations .* do not replay: shard-0000"):
        verify(configure(space, other, tmp_path))
    for physics, words in (({"no_such_key": 1}, "no_such_key"), (None, "does not have the parameters")):
        about["config"]["physics"] = physics
        if physics is None:
            del about["config"]
        (other / "card.json").write_text(json.dumps(about))
        with pytest.raises(DataError, match=words):
            verify(configure(space, other, tmp_path))
    monkeypatch.undo()


def test_no_set_and_a_damaged_one_are_named_and_the_command_fails(
    tmp_path: Path, made: tuple[str, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    space, whole = made
    monkeypatch.chdir(tmp_path)

    def exit_code(folder: Path) -> int:
        arguments = [*SETTINGS, f"action_space={space}", f"demonstrations={folder}"]
        monkeypatch.setattr("sys.argv", ["verify_demos", *arguments])
        with pytest.raises(SystemExit) as stop:
            main()
        return int(stop.value.code or 0)

    assert exit_code(whole) == 0
    assert exit_code(tmp_path / "nowhere") == 2
    assert "nowhere/card.json is missing" in capsys.readouterr().err
    folder = altered(whole, tmp_path / "set", "rewards", 0, 1.0)
    assert exit_code(folder) == 2
    assert "shard-00001.npz, index" in capsys.readouterr().err
    (folder / "shard-00002.npz").write_bytes(b"")
    assert exit_code(folder) == 2
    assert "shard-00002.npz has 0 bytes" in capsys.readouterr().err
    with pytest.raises(DataError, match="needs its own"):
        verify(configure(SPACES[space == "continuous"], whole, tmp_path))
