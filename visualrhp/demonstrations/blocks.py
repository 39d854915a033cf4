"""Resumable generation of demonstration sets: attempts in blocks of consecutive indices, one file per block (Sec. 6.1).

A killed run loses at most the unfinished blocks. The set consists of the first solved instances by index; an instance
without a plan is recorded as a failure and replaced by the next index, so the set depends only on the configuration and
the seed.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from visualrhp.demonstrations.dataset import damaged_shards, file_hash
from visualrhp.demonstrations.shards import Arrays, between, check_arrays, concatenate, read_arrays, write_arrays
from visualrhp.demonstrations.statistics import AttemptStatistics
from visualrhp.demonstrations.writer import DemonstrationWriter
from visualrhp.documents import FileKind
from visualrhp.errors import ConfigError, DataError
from visualrhp.files import atomic_path, remove_unfinished_files

_log = logging.getLogger(__name__)

BLOCK_SIZE: Final = 8
"""Attempts per block; a block is the unit of parallel work."""

BLOCK: Final = FileKind("a block of attempts (an npz file)", "delete it, and rerun the command to generate it again")

_NUM_TRIALS = 200
"""Number of attempts after which the generation fails if hardly any of them is solved."""

Generate = Callable[[Sequence[range]], Iterable[Arrays]]
"""Attempts the task instances of several blocks, in any order: :func:`visualrhp.demonstrations.generate.generate_block`
for each range of indices, possibly in parallel."""


class BlockStore:
    """Blocks of attempts in a folder; missing blocks are generated.

    Args:
        folder: of the files; created if missing.
        generate: attempts task instances.
        observe: called with (numbers of the blocks, finished blocks, attempts of the last one) after every block.
    """

    def __init__(
        self,
        folder: Path,
        generate: Generate,
        observe: Callable[[range, int, Arrays], None] = lambda numbers, finished, arrays: None,
    ) -> None:
        self._folder = folder
        self._generate = generate
        self._observe = observe
        remove_unfinished_files(folder)

    def blocks(self, numbers: range) -> Iterator[Arrays]:
        """Yield the blocks with these ``numbers``, in order; missing ones are generated first, damaged ones again.

        Raises:
            DataError: a folder is in the place of a block.
        """
        self._fill(numbers)
        for number in numbers:
            try:
                arrays = read_attempts(self._path(number))
            except DataError as damage:  # damaged after it was written
                _log.warning("%s", damage)
                if self._path(number).is_dir():
                    raise
                self._path(number).unlink(missing_ok=True)
                self._fill(range(number, number + 1))
                arrays = read_attempts(self._path(number))
            yield arrays

    def _fill(self, numbers: range) -> None:
        missing = [number for number in numbers if not os.path.lexists(self._path(number))]
        if not missing:
            return
        ranges = [range(number * BLOCK_SIZE, (number + 1) * BLOCK_SIZE) for number in missing]
        finished = len(numbers) - len(missing)
        for done, arrays in enumerate(self._generate(ranges), start=1):
            # Only this process writes; a block is complete or absent.
            write_arrays(self._path(int(arrays["index"][0]) // BLOCK_SIZE), arrays)
            self._observe(numbers, finished + done, arrays)

    def _path(self, number: int) -> Path:
        return self._folder / f"block-{number:06d}.npz"


def read_attempts(path: Path) -> Arrays:
    """Read a block of attempts.

    Raises:
        DataError: the file is missing or damaged, or holds something else.
    """
    arrays = read_arrays(path, BLOCK)
    check_arrays(path, arrays, BLOCK)
    if "search_time_s" not in arrays or not _is_one_number_each(arrays):
        raise BLOCK.damaged(path, "search_time_s is missing, or has not one number for each attempt")
    return arrays


def write_set(store: BlockStore, writer: DemonstrationWriter) -> AttemptStatistics:
    """Fill ``writer`` with the attempts of ``store`` until its set is complete; return statistics of the attempts.

    Raises:
        ConfigError: the planner solves hardly any task instance.
    """
    statistics = AttemptStatistics()
    num_solved, first = 0, 0
    while not writer.is_complete:
        last = first + -(-writer.num_missing // BLOCK_SIZE)  # enough if none of them fails
        for arrays in store.blocks(range(first, last)):
            statistics.add(arrays, writer.num_missing)
            num_solved += int(arrays["solved"].sum())
            writer.add(arrays)
            if writer.num_attempts >= _NUM_TRIALS and num_solved < 0.1 * writer.num_attempts:
                raise ConfigError(
                    f"The planner solved {num_solved} of {writer.num_attempts} task instances, too few for a set of "
                    "demonstrations; raise planner.max_simulations, or change the scene."
                )
            if writer.is_complete:
                break
        first = last
    return statistics


def repair_set(folder: Path, card: Mapping[str, Any], store: BlockStore, scratch: Path) -> bool | None:
    """Generate the damaged shards of a set again.

    Args:
        folder: of the set.
        card: of the set, which this code made with the configuration of ``store``.
        store: of the attempts.
        scratch: folder for the new shards until they are verified.

    Returns:
        None if nothing was damaged, True if all damaged shards are repaired, False if a regenerated shard differs.
    """
    damages = damaged_shards(folder, card)
    for number, damage in damages.items():
        _log.warning("%s", damage)
        shard = card["shards"][number]
        first, stop = shard["first_index"], shard["first_index"] + shard["num_attempts"]
        numbers = range(first // BLOCK_SIZE, -(-stop // BLOCK_SIZE))
        arrays = concatenate(list(store.blocks(numbers)))
        del arrays["search_time_s"]
        again = scratch / shard["file"]
        offset = numbers.start * BLOCK_SIZE
        write_arrays(again, between(arrays, first - offset, stop - offset))
        if file_hash(again) != shard["sha256"]:
            _log.warning("%s differs when generated again; the whole set is generated again.", shard["file"])
            return False
        with atomic_path(folder / shard["file"]) as path:
            path.write_bytes(again.read_bytes())
    return True if damages else None


def _is_one_number_each(arrays: Arrays) -> bool:
    times = arrays["search_time_s"]
    return times.dtype == np.float64 and times.shape == arrays["index"].shape
