from itertools import combinations

import numpy as np
import pytest

from visualrhp.streams import Split, Stream, TrainingStream, generator_for, mode_generator, search_seed

SHARED = {TrainingStream.INITIAL_WEIGHTS, TrainingStream.IMITATION}
"""Both have the seed of the training: a change would change every network that was ever trained by imitation."""

TRAININGS = [
    [TrainingStream.INITIAL_WEIGHTS, TrainingStream.IMITATION],
    [TrainingStream.DQN_MINIBATCHES],
    [TrainingStream.C3PO_ACTIONS, TrainingStream.C3PO_MINIBATCHES],
    [TrainingStream.SEGMENTER_WEIGHTS, TrainingStream.SEGMENTER_FRAMES],
]
"""Streams that one training uses."""


def counters_of(stream: Stream) -> tuple[int, ...]:
    return (0,) * stream.value[1]


def test_no_two_uses_share_a_stream_of_a_task_instance() -> None:
    first = {}
    for split in Split:
        for stream in Stream:
            for index in range(3):
                draw = generator_for(0, split, index, stream, *counters_of(stream)).integers(2**63)
                assert draw not in first, (first[draw], (split, stream, index))
                first[draw] = split, stream, index


def test_streams_have_keys_of_their_own() -> None:
    """Equal keys with another number of counters are different streams to NumPy's SeedSequence."""
    assert len({stream.value for stream in Stream}) == len(Stream)
    assert len(Stream.__members__) == len(Stream), "two names of one key would be aliases"
    assert len(TrainingStream.__members__) == len(TrainingStream)


def test_no_two_uses_in_a_training_share_a_seed() -> None:
    assert {stream for training in TRAININGS for stream in training} == set(TrainingStream)
    for training in TRAININGS:
        for one, other in combinations(training, 2):
            same = [seed for seed in range(50) if one.seed(seed) == other.seed(seed)]
            assert not same or {one, other} == SHARED


def test_counters_make_further_streams() -> None:
    draws = {generator_for(0, Split.REINFORCEMENT, 4, Stream.EXPLORATION, step).random() for step in range(20)}
    assert len(draws) == 20


def test_another_number_of_counters_is_refused() -> None:
    with pytest.raises(ValueError, match="EXPLORATION has 1 counters, not 0"):
        generator_for(0, Split.REINFORCEMENT, 0, Stream.EXPLORATION)


def test_streams_are_functions_of_their_key() -> None:
    """Hand-computed once: a change of these numbers changes every result of the project."""
    drawn = [
        int(generator_for(7, Split.EVALUATION, 2, stream, *counters_of(stream)).integers(2**32)) for stream in Stream
    ]
    keys = [(3, 2, 0), (3, 2, 1), (3, 2, 2), (3, 2, 2, 0), (3, 2, 4), (3, 2, 3), (3, 2, 5)]
    sequences = [np.random.SeedSequence(entropy=7, spawn_key=key) for key in keys]
    assert drawn == [int(np.random.default_rng(sequence).integers(2**32)) for sequence in sequences]
    assert search_seed(3, 5) == int(np.random.SeedSequence([3, 5]).generate_state(1)[0])
    assert mode_generator().random() == np.random.default_rng(0).random()
