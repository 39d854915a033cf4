"""Replay a set of demonstrations through the simulator, to the bit: ``python -m pipelines.verify_demos``.

Every demonstration is simulated from its first state, every state and reward is compared to the bit, and the last state
has to be a goal. The count is printed and written to ``verification.json``. The first demonstrations that differ are
named, by shard and index, and the command fails (exit code 2).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.app import app
from pipelines.config import VerifyDemosConfig

if TYPE_CHECKING:
    from visualrhp.learning.demonstrations import Arrays, DemonstrationSet
    from visualrhp.simulation import Physics

STAGE = "verify_demos"

_BLOCK_SIZE = 32
"""Attempts per task of a worker."""

_MOST_NAMED = 5
"""Demonstrations that differ are many or none: a few names will do."""


@dataclass(frozen=True)
class Block:
    """Attempts to replay; sent whole, so that workers on other machines need no file.

    Attributes:
        shard: name of the file they are from.
        arrays: of a shard.
        physics: what they were made with.
    """

    shard: str
    arrays: Arrays = field(repr=False)
    physics: Physics = field(repr=False)


@app(STAGE, VerifyDemosConfig)
def main(config: VerifyDemosConfig) -> None:
    verify(config)


def verify(config: VerifyDemosConfig) -> Path:
    """Replay the set; return the file that says what came of it.

    Raises:
        DataError: the set is missing or damaged, or of the other action space; or a demonstration does not replay.
    """
    from tqdm import tqdm

    from pipelines.execution import run_tasks
    from pipelines.work import card
    from visualrhp.errors import DataError
    from visualrhp.files import write_json
    from visualrhp.learning.demonstrations import DemonstrationSet

    demonstrations = DemonstrationSet.open(config.demonstrations, config.action_space.name)
    physics = physics_of(demonstrations, config.demonstrations)
    num_exact = num_transitions = 0
    differing: list[tuple[str, int, str]] = []
    results = run_tasks(replay, blocks(demonstrations, physics), config.executor)
    with tqdm(total=len(demonstrations), desc=f"Replay, {config.action_space.name}", unit="demonstration") as progress:
        for shard, exact, transitions, different in results:
            num_exact, num_transitions = num_exact + exact, num_transitions + transitions
            differing += [(shard, index, what) for index, what in different]
            progress.update(exact + len(different))
    if num_exact + len(differing) != len(demonstrations):
        raise DataError(
            f"{config.demonstrations} has {num_exact + len(differing)} demonstrations where its card says "
            f"{len(demonstrations)}; generate them again."
        )
    if differing:
        named = "; ".join(f"{shard}, index {index}: {what}" for shard, index, what in sorted(differing)[:_MOST_NAMED])
        raise DataError(
            f"{len(differing)} of {len(demonstrations)} demonstrations in {config.demonstrations} do not replay: "
            f"{named}{'; ...' if len(differing) > _MOST_NAMED else ''}. They were made by other code or on another "
            "kind of machine, or altered; generate them again."
        )
    print(
        f"{num_exact} of {len(demonstrations)} demonstrations ({num_transitions} transitions) replay to the bit and "
        "end in a goal."
    )
    path = Path(config.paths.artefact) / "verification.json"
    content = {
        "demonstrations": num_exact,
        "transitions": num_transitions,
        "content_hash": demonstrations.card["content_hash"],
        "made_by_commit": demonstrations.card.get("commit"),
    }
    write_json(path, card(config, STAGE, **content))
    return path


def physics_of(demonstrations: DemonstrationSet, folder: str) -> Physics:
    """The parameters of the simulator that made the set, from its card.

    Raises:
        DataError: the card does not say, or the simulator has other parameters now.
    """
    from visualrhp.errors import ConfigError, DataError
    from visualrhp.simulation import Physics

    try:
        return Physics(**demonstrations.card["config"]["physics"])
    except (KeyError, TypeError, ConfigError) as error:
        raise DataError(
            f"the card in {folder} does not say with which parameters of the simulator the set was made, or says "
            f"others than there are now ({error}); generate it again."
        ) from error


def blocks(demonstrations: DemonstrationSet, physics: Physics) -> Iterator[Block]:
    """The set in parts that are cheap to send around."""
    import numpy as np

    from visualrhp.learning.demonstrations import between

    for number, shard in enumerate(demonstrations.card["shards"]):
        arrays = demonstrations.shard(number).arrays
        for start in range(0, shard["num_attempts"], _BLOCK_SIZE):
            part = between(arrays, start, min(start + _BLOCK_SIZE, shard["num_attempts"]))
            yield Block(shard["file"], {name: np.array(array) for name, array in part.items()}, physics)


def replay(block: Block) -> tuple[str, int, int, list[tuple[int, str]]]:
    """A worker's task: (shard, exact ones, their transitions, [(index, what differs)])."""
    from visualrhp.learning.demonstrations import replay_block

    result: tuple[int, int, Any] = replay_block(block.arrays, block.physics)
    return block.shard, *result


if __name__ == "__main__":
    main()
