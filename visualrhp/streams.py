"""The register of random streams: every random number of the package comes from a stream that is listed here.

A result is a function of (configuration, seed, index). Streams of task instances are NumPy generators, keyed by the
split, the index of the instance and their use; those of trainings are seeds of torch generators. No two uses share a
stream (a test compares them), except that the initial weights and the imitation of a training have the same seed.
"""

from __future__ import annotations

from enum import Enum, IntEnum

import numpy as np


class Split(IntEnum):
    """Disjoint sets of task instances, so that nothing is evaluated on its training instances."""

    DEMONSTRATIONS = 0
    REINFORCEMENT = 1
    VALIDATION = 2
    EVALUATION = 3
    TUNING = 4
    EXPERT_ITERATION = 5
    SEGMENTATION = 6
    """Cells whose frames our segmentation network learns from."""


class Stream(Enum):
    """Uses of the random streams of a task instance: the key, and the number of counters that follow it."""

    INSTANCE = (0, 0)
    """Scene and initial state."""
    PLANNER = (1, 0)
    """Samples of a planner in an episode: of an evaluation, a video, or the search for a demonstration."""
    NOISE = (2, 0)
    """The perturbed world of Sec. 8.2."""
    EXPLORATION = (2, 1)
    """eps-RHP (Sec. 6.3.1): the counter is the number of the action in its episode. Expert iteration: who acts."""

    FRAMES = (4, 0)
    """Labelled frames of a simulated cell: motions of the arm between them, sampled points of pixels."""
    CELL = (3, 0)
    """Objects and layout of a simulated robot cell, with their physics."""
    CELL_LOOK = (5, 0)
    """Looks, camera and noise of a simulated robot cell."""


class TrainingStream(Enum):
    """Uses of the random streams of a training: the seed is ``factor * seed + offset``."""

    INITIAL_WEIGHTS = ("weights before imitation", 1, 0)
    IMITATION = ("held-out demonstrations, order of the pairs, mirroring", 1, 0)
    DQN_MINIBATCHES = ("minibatches from the replay buffer", 1, 0)
    C3PO_ACTIONS = ("actions of the collecting policy", 2, 0)
    C3PO_MINIBATCHES = ("order of the minibatches", 2, 1)
    SEGMENTER_WEIGHTS = ("weights of the segmentation network", 2, 0)
    SEGMENTER_FRAMES = ("order and augmentation of frames", 2, 1)

    def seed(self, seed: int) -> int:
        """Return the seed of the stream in a training with ``seed``."""
        _, factor, offset = self.value
        return factor * seed + offset


def generator_for(seed: int, split: Split, index: int, stream: Stream, *counters: int) -> np.random.Generator:
    """The random stream of task instance ``index`` for the use ``stream``.

    Raises:
        ValueError: the number of counters is not that of the stream.
    """
    key, num_counters = stream.value
    if len(counters) != num_counters:
        raise ValueError(f"the stream {stream.name} has {num_counters} counters, not {len(counters)}")
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(int(split), index, key, *counters)))


def search_seed(seed: int, trial: int) -> int:
    """The seed of trial ``trial`` of a parameter search, or of the imitation in round ``trial`` of expert iteration, so
    that a resumed one is reproducible."""
    return int(np.random.SeedSequence([seed, trial]).generate_state(1)[0])


def mode_generator() -> np.random.Generator:
    """The fixed stream from which the mode of a uniform policy is sampled, since all actions are equally likely."""
    return np.random.default_rng(0)
