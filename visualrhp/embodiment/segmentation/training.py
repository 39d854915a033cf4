"""Training of our segmentation network on labelled frames (torch)."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

from visualrhp.documents import document
from visualrhp.embodiment.segmentation.augmentation import augmented
from visualrhp.embodiment.segmentation.configs import SegmenterTrainingConfig
from visualrhp.embodiment.segmentation.frames import LabelledFrames
from visualrhp.embodiment.segmentation.losses import class_agreement, segmentation_loss, targets_of
from visualrhp.embodiment.segmentation.network import SegmentationNetwork
from visualrhp.errors import DataError, LearningError
from visualrhp.learning.history import EpochHistory
from visualrhp.learning.training_state import load_training_state, save_training_state
from visualrhp.parameters import Index
from visualrhp.streams import TrainingStream
from visualrhp.types import Metrics


@document
class SegmenterProgress:
    """The values in the state of a training."""

    epoch: Index
    history: EpochHistory


class SegmenterTraining:
    """Trains a network; yields one row of metrics an epoch.

    The result is a function of the arguments and the seed (and of torch's number of threads). A training that is saved,
    loaded into a new object with the same arguments, and continued gives the result of an uninterrupted one.

    Args:
        network: trained in place.
        frames: to learn from.
        config: of the training.
        seed: of the order of the frames and their augmentation.

    Raises:
        DataError: there are too few frames for a batch.
    """

    def __init__(
        self, network: SegmentationNetwork, frames: LabelledFrames, config: SegmenterTrainingConfig, seed: int
    ) -> None:
        self.network = network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.config = config
        self.epoch = 0
        self.history: list[Metrics] = []
        num_validation = round(config.validation_fraction * len(frames))
        self._frames = frames
        self._training = np.arange(len(frames) - num_validation)
        self._validation = np.arange(len(frames) - num_validation, len(frames))
        if len(self._training) < config.batch_size:
            raise DataError(
                f"{len(self._training)} frames are too few to train on; there should be at least batch_size="
                f"{config.batch_size}"
            )
        self._generator = np.random.default_rng(TrainingStream.SEGMENTER_FRAMES.seed(seed))
        self._device = next(network.parameters()).device
        self._optimizer = torch.optim.AdamW(network.parameters(), lr=config.lr, weight_decay=config.weight_decay)

    def run(self) -> Iterator[Metrics]:
        """Train until all epochs are done, including those before a restart.

        Raises:
            LearningError: the training diverged.
        """
        while self.epoch < self.config.epochs:
            start = time.perf_counter()
            terms = self._train_epoch()
            self.epoch += 1
            metrics = {
                "epoch": float(self.epoch),
                **{f"train/{name}": value for name, value in terms.items()},
                "lr": self._optimizer.param_groups[0]["lr"],
                "samples_per_s": len(self._training) / (time.perf_counter() - start),
            }
            if len(self._validation):
                metrics |= {f"validation/{name}": value for name, value in self._validate().items()}
            if not all(math.isfinite(value) for value in metrics.values()):
                raise LearningError(f"the training diverged in epoch {self.epoch}; use a smaller learning rate")
            self.history.append(metrics)
            yield metrics

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the state of the training to one file, atomically."""
        save_training_state(path, {**self._parts(), "epoch": self.epoch, "history": self.history})

    def load(self, path: str | os.PathLike[str]) -> None:
        """Resume from a file of :meth:`save`.

        Raises:
            CheckpointError: the file is missing or damaged, or was written by another training.
        """
        values = load_training_state(path, self._parts(), SegmenterProgress)
        self.epoch, self.history = values["epoch"], values["history"]

    def _parts(self) -> dict[str, Any]:
        return {"network": self.network, "optimizer": self._optimizer, "generator": self._generator}

    def _train_epoch(self) -> Metrics:
        self.network.train()
        size = self.config.batch_size
        order = self._generator.permutation(self._training)
        num_batches = len(order) // size  # an incomplete batch would disturb the statistics of normalization
        sums: dict[str, float] = {}
        for number in range(num_batches):
            rows = np.sort(order[number * size : (number + 1) * size])
            frames = augmented(self._frames[rows], self.config.augmentation, self._generator)
            self._set_learning_rate(self.epoch * num_batches + number, self.config.epochs * num_batches)
            loss, terms = self._loss(frames)
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()
            for name, value in {"loss": loss.detach(), **terms}.items():
                sums[name] = sums.get(name, 0.0) + float(value) / num_batches
        return sums

    def _validate(self) -> Metrics:
        self.network.eval()
        sums: dict[str, float] = {}
        with torch.inference_mode():
            for first in range(0, len(self._validation), self.config.batch_size):
                rows = self._validation[first : first + self.config.batch_size]
                frames = self._frames[rows]
                targets = targets_of(frames)
                output = self.network(torch.from_numpy(frames.images).to(self._device))
                loss, terms = segmentation_loss(output, targets)
                agreement = class_agreement(output, targets)
                for name, value in {"loss": loss, **terms, "class_iou": agreement}.items():
                    sums[name] = sums.get(name, 0.0) + float(value) * len(rows) / len(self._validation)
        return sums

    def _loss(self, frames: LabelledFrames) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        return segmentation_loss(self.network(torch.from_numpy(frames.images).to(self._device)), targets_of(frames))

    def _set_learning_rate(self, step: int, num_steps: int) -> None:
        warm_up = self.config.warm_up * num_steps
        if step < warm_up:
            factor = (step + 1) / (warm_up + 1)
        else:
            factor = 0.5 * (1.0 + math.cos(math.pi * (step - warm_up) / (num_steps - warm_up)))
        for group in self._optimizer.param_groups:
            group["lr"] = self.config.lr * factor
