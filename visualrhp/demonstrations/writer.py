"""Writing of demonstration sets."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from visualrhp.demonstrations.dataset import CARD_FILE, FORMAT, check_action_space, file_hash
from visualrhp.demonstrations.shards import Arrays, concatenate, head, tail, write_arrays
from visualrhp.errors import DataError
from visualrhp.files import write_json
from visualrhp.types import ActionSpaceName


class DemonstrationWriter:
    """Writes a demonstration set: takes consecutive attempts, writes shards and finally the card.

    Args:
        folder: of the set; created if missing.
        action_space: the action space of the attempts.
        count: number of demonstrations; attempts beyond the one that completes them are ignored.
        shard_size: demonstrations per shard file.
    """

    def __init__(self, folder: Path, action_space: ActionSpaceName, count: int, shard_size: int = 1000) -> None:
        self._folder = folder
        self._action_space: ActionSpaceName = action_space
        self._missing = count
        self._shard_size = shard_size
        self._pending: list[Arrays] = []
        self._num_pending = 0
        self._shards: list[dict[str, Any]] = []
        self._next_index = 0
        self._lengths: Counter[int] = Counter()
        self._solved: Counter[int] = Counter()
        self._failed: Counter[int] = Counter()
        self._failed_indices: list[int] = []

    @property
    def is_complete(self) -> bool:
        """Whether all demonstrations have been added."""
        return self._missing == 0

    @property
    def num_attempts(self) -> int:
        """Number of attempts added so far, including failures."""
        return self._next_index

    @property
    def num_missing(self) -> int:
        """Number of demonstrations still to be added."""
        return self._missing

    def add(self, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Add the next attempts, packed (see :func:`pack`); their indices continue those added so far.

        Search times are not stored, since they are not reproducible.

        Raises:
            DataError: the indices do not continue, or the actions are of the other space.
        """
        arrays = {name: array for name, array in arrays.items() if name != "search_time_s"}
        while len(arrays["index"]) and not self.is_complete:
            room = min(self._missing, self._shard_size - self._num_pending)
            solved = np.cumsum(arrays["solved"])
            taken = int(np.searchsorted(solved, room)) + 1 if solved[-1] >= room else len(solved)
            part = head(arrays, taken)
            self._append(part)
            arrays = tail(arrays, taken)

    def finish(self, **provenance: Any) -> dict[str, Any]:
        """Write the pending attempts and the card, and return the card.

        Args:
            provenance: further entries of the card (config, seed, commit).

        Raises:
            DataError: demonstrations are missing.
        """
        if not self.is_complete:
            raise DataError(
                f"{self._folder} lacks {self._missing} demonstrations; add attempts until the set is complete."
            )
        self._flush()
        content = hashlib.sha256("".join(shard["sha256"] for shard in self._shards).encode()).hexdigest()
        counts = sorted(self._solved | self._failed)
        card = {
            "kind": "demonstrations",
            "format": FORMAT,
            "action_space": self._action_space,
            "num_demonstrations": sum(self._solved.values()),
            "num_attempts": self._next_index,
            "num_transitions": sum(length * number for length, number in self._lengths.items()),
            "failed_indices": self._failed_indices,
            "by_num_objects": {str(m): {"solved": self._solved[m], "failed": self._failed[m]} for m in counts},
            "lengths": {str(length): self._lengths[length] for length in sorted(self._lengths)},
            "shards": self._shards,
            "content_hash": content,
            **provenance,
        }
        write_json(self._folder / CARD_FILE, card)
        known = {shard["file"] for shard in self._shards}
        for path in self._folder.glob("shard-*.npz"):  # shards of an earlier, larger set in the folder
            if path.name not in known:
                path.unlink()
        return card

    def _append(self, part: Arrays) -> None:
        expected = np.arange(self._next_index, self._next_index + len(part["index"]))
        if not np.array_equal(part["index"], expected):
            raise DataError(
                f"the attempts added to {self._folder} should continue with the indices {expected[0]} to "
                f"{expected[-1]}, but have {part['index'].tolist()}"
            )
        check_action_space(part, self._action_space, f"the attempts added to {self._folder}")
        solved = part["solved"]
        self._next_index += len(solved)
        self._missing -= int(solved.sum())
        self._lengths.update(part["length"][solved].tolist())
        self._solved.update(part["num_objects"][solved].tolist())
        self._failed.update(part["num_objects"][~solved].tolist())
        self._failed_indices += part["index"][~solved].tolist()
        self._pending.append(part)
        self._num_pending += int(solved.sum())
        if self._num_pending == self._shard_size:
            self._flush()

    def _flush(self) -> None:
        if not self._pending:
            return
        arrays = concatenate(self._pending)
        path = self._folder / f"shard-{len(self._shards):05d}.npz"
        write_arrays(path, arrays)
        self._shards.append(
            {
                "file": path.name,
                "bytes": path.stat().st_size,
                "sha256": file_hash(path),
                "first_index": int(arrays["index"][0]),
                "num_attempts": len(arrays["index"]),
                "num_demonstrations": int(arrays["solved"].sum()),
                "num_transitions": int(arrays["length"].sum()),
            }
        )
        self._pending, self._num_pending = [], 0
