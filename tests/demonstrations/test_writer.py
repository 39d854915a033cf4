"""Sets are written from consecutive attempts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.demonstrations.conftest import SEED, write
from visualrhp.demonstrations.generate import Attempt
from visualrhp.demonstrations.shards import pack
from visualrhp.demonstrations.writer import DemonstrationWriter
from visualrhp.errors import DataError
from visualrhp.types import ActionSpaceName


def test_the_card_counts(tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]) -> None:
    folder = write(tmp_path, attempts["discrete"], "discrete", count=3, shard_size=2)
    card = json.loads((folder / "card.json").read_text())
    assert card["num_demonstrations"] == 3
    assert card["num_attempts"] == 4  # 0, 2 and 3 are demonstrations, 1 a failure; the others are not needed
    assert card["failed_indices"] == [1]
    assert sum(count["failed"] for count in card["by_num_objects"].values()) == 1
    assert sum(count["solved"] for count in card["by_num_objects"].values()) == 3
    assert sum(card["lengths"].values()) == 3
    assert [shard["num_demonstrations"] for shard in card["shards"]] == [2, 1]
    assert card["seed"] == SEED and card["config"] == {"count": 3}


def test_the_same_attempts_give_the_same_bytes_however_they_arrive(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]
) -> None:
    at_once = write(tmp_path / "a", attempts["continuous"], "continuous", shard_size=2)
    writer = DemonstrationWriter(tmp_path / "b", "continuous", 5, shard_size=2)
    for single in attempts["continuous"]:
        writer.add(pack([single], "continuous"))
    writer.finish(seed=SEED, commit="0" * 40, config={"count": 5})
    names = sorted(path.name for path in at_once.iterdir())
    assert names == ["card.json", "shard-00000.npz", "shard-00001.npz", "shard-00002.npz"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_writer_refuses_gaps_other_spaces_and_unfinished_sets(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]
) -> None:
    writer = DemonstrationWriter(tmp_path, "discrete", 5)
    with pytest.raises(DataError, match="indices 0 to 0"):
        writer.add(pack(attempts["discrete"][2:3], "discrete"))
    with pytest.raises(DataError, match="continuous actions"):
        DemonstrationWriter(tmp_path, "discrete", 5).add(pack(attempts["continuous"][:1], "continuous"))
    with pytest.raises(DataError, match="lacks 5"):
        DemonstrationWriter(tmp_path, "discrete", 5).finish()
    assert not any(tmp_path.iterdir())
