"""The loss falls, a training is a function of the seed, and a resumed one is bit-exact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.embodiment.segmentation.painter import painted_frames
from visualrhp.embodiment.segmentation.configs import NetworkConfig, SegmenterTrainingConfig
from visualrhp.embodiment.segmentation.network import SegmentationNetwork
from visualrhp.embodiment.segmentation.training import SegmenterTraining
from visualrhp.errors import CheckpointError, DataError, LearningError

TINY = NetworkConfig((4, 8, 12), (1, 1), 8, 8)
CONFIG = SegmenterTrainingConfig(epochs=3, batch_size=4, lr=5e-3, validation_fraction=0.2)
FRAMES = painted_frames(0, 20, 48)


def training(seed: int = 0, config: SegmenterTrainingConfig = CONFIG) -> SegmenterTraining:
    return SegmenterTraining(SegmentationNetwork(TINY, seed), FRAMES, config, seed)


def weights(learner: SegmenterTraining) -> np.ndarray:
    return torch.cat([weight.detach().flatten() for weight in learner.network.parameters()]).numpy()


def test_the_loss_falls_and_rows_are_numbered() -> None:
    config = SegmenterTrainingConfig(epochs=12, batch_size=4, lr=1e-2, validation_fraction=0.2)
    rows = list(training(config=config).run())
    assert [row["epoch"] for row in rows] == list(range(1, 13))
    assert rows[-1]["train/loss"] < 0.5 * rows[0]["train/loss"]
    assert rows[-1]["validation/loss"] < 0.5 * rows[0]["validation/loss"]
    assert rows[-1]["lr"] < 0.1 * max(row["lr"] for row in rows)


def test_a_resumed_training_is_bit_exact(tmp_path: Path) -> None:
    whole = training()
    expected = list(whole.run())
    part = training()
    rows = part.run()
    next(rows)
    part.save(tmp_path / "state.safetensors")
    again = training()
    again.load(tmp_path / "state.safetensors")
    list(again.run())
    np.testing.assert_array_equal(weights(again), weights(whole))
    for one, other in zip(again.history, expected, strict=True):
        assert {k: v for k, v in one.items() if k != "samples_per_s"} == {
            k: v for k, v in other.items() if k != "samples_per_s"
        }


def test_another_seed_gives_another_network() -> None:
    one, other = training(0), training(1)
    next(one.run())
    next(other.run())
    assert not np.array_equal(weights(one), weights(other))


def test_a_state_of_another_training_is_refused(tmp_path: Path) -> None:
    training().save(tmp_path / "state.safetensors")
    other = SegmenterTraining(SegmentationNetwork(NetworkConfig((4, 8, 8), (1, 1), 8, 8)), FRAMES, CONFIG, 0)
    with pytest.raises(CheckpointError, match=r"state\.safetensors"):
        other.load(tmp_path / "state.safetensors")


def test_too_few_frames_are_refused() -> None:
    with pytest.raises(DataError, match=r"2 frames are too few.*batch_size=4"):
        SegmenterTraining(SegmentationNetwork(TINY), FRAMES[:2], CONFIG, 0)


def test_divergence_is_an_error() -> None:
    learner = training()
    with torch.no_grad():
        learner.network.head.weight.fill_(float("nan"))
    with pytest.raises(LearningError, match="diverged in epoch 1"):
        next(learner.run())
