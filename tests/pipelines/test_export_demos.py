"""Exports: complete or not there, and replaced as a whole."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from pipelines.config import ExportDemosConfig, GenerateDemosConfig
from pipelines.export_demos import export, main
from pipelines.workflow.app import compose
from pipelines.workflow.artefacts import card
from visualrhp.demonstrations.generate import generate_block
from visualrhp.demonstrations.writer import DemonstrationWriter
from visualrhp.errors import DataError, StorageError

SETTINGS = ("scale=smoke", "tracking=none", "action_space=discrete")


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = compose("generate_demos", GenerateDemosConfig, [*SETTINGS, "scene.num_objects=[1,2]"])
    folder = tmp_path_factory.mktemp("demonstrations")
    writer = DemonstrationWriter(folder, "discrete", 5, shard_size=3)
    writer.add(generate_block(range(8), config.scene, "discrete", config.planner, config.seed, config.physics))
    writer.finish(**card(config, "generate_demos"))
    return folder


def configure(demonstrations: Path, artefact: Path, *overrides: str) -> ExportDemosConfig:
    settings = [*SETTINGS, f"demonstrations={demonstrations}", f"paths.artefact={artefact}", *overrides]
    settings.append(f"paths.outputs={demonstrations.parent / 'outputs'}")
    return compose("export_demos", ExportDemosConfig, settings)


def test_parquet_has_the_transitions_the_scenes_and_the_card(
    tmp_path: Path, demonstrations: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = export(configure(demonstrations, tmp_path / "new" / "export", "format=parquet"))
    assert folder == tmp_path / "new" / "export"
    assert capsys.readouterr().out == f"5 demonstrations as parquet in {folder}\n"
    about = json.loads((folder / "card.json").read_text())
    assert about == json.loads((demonstrations / "card.json").read_text())
    transitions = pd.read_parquet(folder / "transitions.parquet")
    assert len(transitions) == about["num_transitions"]
    assert len(pd.read_parquet(folder / "scenes.parquet")) > 0
    assert [path.name for path in folder.parent.iterdir()] == ["export"]  # nothing unfinished beside it


@pytest.mark.parametrize("observation", ["image", "cartesian"])
def test_minari_is_written_for_an_observation(tmp_path: Path, demonstrations: Path, observation: str) -> None:
    pytest.importorskip("minari")
    overrides = ["format=minari", "dataset_id=clutter/demos-v0", f"observation={observation}", "num_objects=1"]
    folder = export(configure(demonstrations, tmp_path / observation, *overrides))
    metadata = json.loads((folder / "clutter" / "demos-v0" / "data" / "metadata.json").read_text())
    shape = json.loads(metadata["observation_space"])["subspaces"]["observation"]["shape"]
    assert shape == ([64, 64] if observation == "image" else [4 * 1 + 6])


def test_a_failed_export_leaves_the_earlier_one(tmp_path: Path, demonstrations: Path) -> None:
    target = tmp_path / "export"
    export(configure(demonstrations, target, "format=parquet"))
    before = {path.name: path.read_bytes() for path in target.iterdir()}
    with pytest.raises(DataError, match="7"):
        export(configure(demonstrations, tmp_path / "other", "format=parquet", "num_objects=7"))
    with pytest.raises(DataError, match=r"card\.json is missing"):
        export(configure(tmp_path / "nowhere", target, "format=parquet"))
    assert {path.name: path.read_bytes() for path in target.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["export"]


def test_demonstrations_of_the_other_action_space_are_refused(tmp_path: Path, demonstrations: Path) -> None:
    with pytest.raises(DataError, match="discrete"):
        export(configure(demonstrations, tmp_path / "export", "action_space=continuous"))
    assert not (tmp_path / "export").exists()


def test_the_command_exports(tmp_path: Path, demonstrations: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = [*SETTINGS, f"demonstrations={demonstrations}", f"paths.artefact={tmp_path / 'export'}"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["export_demos", *settings, "format=parquet"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert (tmp_path / "export" / "transitions.parquet").is_file()


def test_two_data_sets_of_minari_share_a_folder(tmp_path: Path, demonstrations: Path) -> None:
    """The commands of docs/demonstrations.md."""
    minari = pytest.importorskip("minari")
    root = tmp_path / "minari"
    export(configure(demonstrations, root, "format=minari"))
    image = (root / "visualrhp" / "discrete-image-v0" / "data" / "main_data.hdf5").read_bytes()
    export(configure(demonstrations, root, "format=minari", "observation=cartesian", "num_objects=1"))
    assert (root / "visualrhp" / "discrete-image-v0" / "data" / "main_data.hdf5").read_bytes() == image
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(root))
        assert set(minari.list_local_datasets()) == {"visualrhp/discrete-image-v0", "visualrhp/discrete-cartesian-v0"}
        assert minari.load_dataset("visualrhp/discrete-image-v0").total_episodes == 5


def test_an_export_of_other_demonstrations_is_not_replaced(tmp_path: Path, demonstrations: Path) -> None:
    target = tmp_path / "export"
    export(configure(demonstrations, target, "format=parquet", "num_objects=1"))
    export(configure(demonstrations, target, "format=parquet", "num_objects=1"))
    with pytest.raises(StorageError, match=r"holds another export \(parquet, num_objects=1\)"):
        export(configure(demonstrations, target, "format=parquet"))
    with pytest.raises(StorageError, match="was not made by"):
        export(configure(demonstrations, demonstrations, "format=parquet"))
    assert (demonstrations / "card.json").is_file()
