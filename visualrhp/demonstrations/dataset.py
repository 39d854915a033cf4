"""Reading demonstration sets: a folder of shards (:mod:`visualrhp.demonstrations.shards`) and a JSON card.

The task instances of a set are those with the indices 0, 1, 2, ... up to the one that completes the requested number of
demonstrations. An instance that the planner cannot solve is recorded as a failure and replaced by the next index, so
the content of a set depends only on (configuration, seed), not on the number of workers or interruptions.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from visualrhp.demonstrations.returns import monte_carlo_returns
from visualrhp.demonstrations.shards import SHARD, Shard, check_arrays, integers, map_arrays, offsets
from visualrhp.documents import FileKind, document, shown_path
from visualrhp.errors import DataError
from visualrhp.parameters import Count, Index, show
from visualrhp.scene.scene import TaskInstance
from visualrhp.simulation.rules import DISCOUNT
from visualrhp.types import ActionSpaceName, Episode, FloatArray, IntArray

CARD_FILE = "card.json"
FORMAT = 1


CARD: Final = FileKind(
    "the card of a set of demonstrations (a JSON file)",
    "generate the set again (python -m pipelines.generate_demos)",
    missing="is missing: there is no finished set of demonstrations there",
)


@document
class _ShardEntry:
    """A shard on the card."""

    file: str
    bytes: Index
    sha256: str
    first_index: Index
    num_attempts: Count
    num_demonstrations: Index
    num_transitions: Index

    def __post_init__(self) -> None:
        if not re.fullmatch(r"shard-\d{5,9}\.npz", self.file):
            raise ValueError(f"file={show(self.file)} is not the name of a shard, such as shard-00000.npz")
        if self.num_demonstrations > self.num_attempts:
            raise ValueError(f"num_demonstrations={self.num_demonstrations} is more than its attempts")


@document
class _Card:
    """The card of a set."""

    action_space: ActionSpaceName
    num_demonstrations: Count
    num_attempts: Count
    num_transitions: Index
    shards: tuple[_ShardEntry, ...]
    content_hash: str

    def __post_init__(self) -> None:
        first_index = 0
        for number, shard in enumerate(self.shards):
            if shard.first_index != first_index:
                raise ValueError(f"shards[{number}].first_index={shard.first_index}, but {first_index} comes next")
            first_index += shard.num_attempts
        for name in ("num_demonstrations", "num_attempts", "num_transitions"):
            if (total := sum(getattr(shard, name) for shard in self.shards)) != getattr(self, name):
                raise ValueError(f"{name}={getattr(self, name)}, but its shards have {total}")
        if len({shard.file for shard in self.shards}) < len(self.shards):
            raise ValueError("a shard is listed twice")
        if not re.fullmatch("[0-9a-f]{64}", self.content_hash):
            raise ValueError(f"content_hash={show(self.content_hash)} is not a SHA-256 checksum")


def read_card(folder: str | Path) -> dict[str, Any]:
    """Read the card of the demonstration set in ``folder``.

    Raises:
        DataError: it is missing or damaged, or is not such a card; the message names the file.
    """
    path = Path(folder) / CARD_FILE
    card = CARD.read_content(path)
    if not isinstance(card, dict) or card.get("kind") != "demonstrations" or card.get("format") != FORMAT:
        raise CARD.unusable(path, f"is not the card of a demonstration set of format {FORMAT}")
    CARD.check(path, _Card, card)
    return card


def damaged_shards(folder: str | Path, card: Mapping[str, Any]) -> dict[int, str]:
    """Number of every missing, truncated or altered shard -> description of the damage, with the name of the file.

    Args:
        folder: of the set.
        card: of the set, from :func:`read_card`.
    """
    damages = {}
    for number, shard in enumerate(card["shards"]):
        damage = _damage(Path(folder) / shard["file"], shard)
        if damage is not None:
            damages[number] = damage
    return damages


class DemonstrationSet:
    """Stored demonstrations. Opening reads the card and verifies the checksums; the shards are memory-mapped, and a
    demonstration is read from the disk when it is accessed.

    Iterating yields (TaskInstance, Episode); positions run from 0 to ``len(set) - 1`` and skip failures.
    """

    def __init__(self, folder: Path, card: Mapping[str, Any]) -> None:
        self._folder = folder
        self._shards: dict[int, Shard] = {}
        self._firsts = offsets(integers(shard["num_demonstrations"] for shard in card["shards"]))
        self.card = card

    @classmethod
    def open(cls, folder: str | Path, action_space: ActionSpaceName | None = None) -> DemonstrationSet:
        """Open the set in ``folder``.

        Args:
            folder: of the set.
            action_space: the expected action space; None for any.

        Raises:
            DataError: the card or a shard is missing, truncated or altered, or the set has another action space or
                format; the message names the file.
        """
        folder = Path(folder)
        path = folder / CARD_FILE
        card = read_card(folder)
        if action_space is not None and card["action_space"] != action_space:
            raise DataError(
                f"{shown_path(path)} belongs to demonstrations in the {card['action_space']} action space; the "
                f"{action_space} action space needs its own."
            )
        for damage in damaged_shards(folder, card).values():
            raise DataError(damage)
        return cls(folder, card)

    @property
    def action_space(self) -> ActionSpaceName:
        """The action space of the demonstrations."""
        return self.card["action_space"]

    @property
    def num_transitions(self) -> int:
        """Number of actions of all demonstrations."""
        return int(self.card["num_transitions"])

    @cached_property
    def lengths(self) -> IntArray:
        """[len(self)] actions L of each demonstration."""
        return self._collect("length")

    @cached_property
    def num_objects(self) -> IntArray:
        """[len(self)] objects m of each demonstration."""
        return self._collect("num_objects")

    @cached_property
    def indices(self) -> IntArray:
        """[len(self)] index of the task instance of each demonstration."""
        return self._collect("index")

    def positions(self, num_objects: int | None = None) -> list[int]:
        """Positions of the demonstrations with ``num_objects`` objects; None: of all.

        Raises:
            DataError: there are none.
        """
        every = self.num_objects
        found = np.arange(len(every)) if num_objects is None else np.flatnonzero(every == num_objects)
        if not len(found):
            raise DataError(
                f"there is no demonstration with {num_objects} objects; the set has "
                f"{', '.join(str(m) for m in np.unique(every)) or 'none at all'}"
            )
        return found.tolist()

    def __len__(self) -> int:
        return int(self._firsts[-1])

    def __getitem__(self, position: int) -> tuple[TaskInstance, Episode]:
        if not -len(self) <= position < len(self):
            raise IndexError(f"position {position} in a set of {len(self)} demonstrations")
        shard, attempt = self._locate(position % len(self))
        episode = shard.episode(attempt)
        assert episode is not None  # only solved attempts have a position
        return TaskInstance(shard.scene(attempt), episode.states[0]), episode

    def __iter__(self) -> Iterator[tuple[TaskInstance, Episode]]:
        for position in range(len(self)):
            yield self[position]

    def returns(self, discount: float = DISCOUNT) -> FloatArray:
        """[num_transitions] Monte Carlo returns (Eq. 4), demonstration after demonstration."""
        parts = [np.empty(0)]
        for position in range(len(self)):
            shard, attempt = self._locate(position)
            parts.append(monte_carlo_returns(shard.rewards(attempt), discount))
        return np.concatenate(parts)

    def shard(self, number: int) -> Shard:
        """The shard file ``number``, memory-mapped on first use.

        Raises:
            DataError: the file was damaged since the set was opened.
        """
        if number not in self._shards:
            entry = self.card["shards"][number]
            path = self._folder / entry["file"]
            arrays = map_arrays(path)
            check_arrays(path, arrays)
            check_action_space(arrays, self.action_space, str(path))
            found = len(arrays["index"]), int(arrays["solved"].sum()), int(arrays["length"].sum())
            if found != (entry["num_attempts"], entry["num_demonstrations"], entry["num_transitions"]):
                raise SHARD.damaged(path, "its attempts, demonstrations and transitions are not those on the card")
            self._shards[number] = Shard(arrays)
        return self._shards[number]

    def _locate(self, position: int) -> tuple[Shard, int]:
        number = int(np.searchsorted(self._firsts, position, side="right")) - 1
        shard = self.shard(number)
        return shard, int(shard.demonstrations[position - self._firsts[number]])

    def _collect(self, name: str) -> IntArray:
        shards = (self.shard(number) for number in range(len(self.card["shards"])))
        return np.concatenate([np.empty(0, np.int64), *(shard.arrays[name][shard.demonstrations] for shard in shards)])


def check_action_space(arrays: Mapping[str, npt.NDArray[Any]], action_space: ActionSpaceName, what: str) -> None:
    """Check that the actions in the arrays of ``what`` are of ``action_space``.

    Raises:
        DataError: they are not.
    """
    found = "discrete" if arrays["actions"].ndim == 1 else "continuous"
    if found != action_space:
        raise DataError(f"{what} holds {found} actions where {action_space} ones are expected.")


def _damage(path: Path, expected: Mapping[str, Any]) -> str | None:
    """Describe the damage of a shard file; None if it matches the card."""
    if objection := SHARD.objection(path):
        return str(objection)
    try:
        size = path.stat().st_size
        if size != expected["bytes"]:
            return str(SHARD.unusable(path, f"has {size} bytes, but {expected['bytes']} on the card: it is damaged"))
        if file_hash(path) != expected["sha256"]:
            return str(SHARD.unusable(path, "does not have the SHA-256 checksum on the card: it is damaged"))
    except OSError as error:
        return str(SHARD.unreadable(path, error))
    return None


def file_hash(path: Path) -> str:
    """SHA-256 of the content of a file, as on the card."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
