"""Blocks of attempts: generated once, resumed, regenerated when damaged; sets are complete in order of index."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pytest

from visualrhp.demonstrations.blocks import BLOCK_SIZE, BlockStore, read_attempts, repair_set, write_set
from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.generate import generate_block
from visualrhp.demonstrations.shards import Arrays, between, concatenate, read_arrays, write_arrays
from visualrhp.demonstrations.writer import DemonstrationWriter
from visualrhp.errors import ConfigError, DataError
from visualrhp.planning import KinodynamicRRT
from visualrhp.scene import SceneDistribution

DISTRIBUTION = SceneDistribution(num_objects=(1, 2))
COUNT, SHARD_SIZE = 11, 4


class Generator:
    """Attempts the blocks in reverse order and remembers which."""

    def __init__(self, max_simulations: int = 150) -> None:
        self.planner = KinodynamicRRT(max_simulations=max_simulations)
        self.attempted: list[range] = []

    def __call__(self, ranges: Sequence[range]) -> Iterable[Arrays]:
        for indices in reversed(ranges):
            self.attempted.append(indices)
            yield generate_block(indices, DISTRIBUTION, "discrete", self.planner, 3)


def write(folder: Path, store: BlockStore) -> DemonstrationSet:
    writer = DemonstrationWriter(folder, "discrete", COUNT, SHARD_SIZE)
    statistics = write_set(store, writer)
    writer.finish()
    stored = DemonstrationSet.open(folder)
    assert statistics.metrics()["attempts"] == stored.card["num_attempts"]
    return stored


def test_a_set_has_the_first_solved_instances(tmp_path: Path) -> None:
    generator = Generator()
    stored = write(tmp_path / "set", BlockStore(tmp_path / "blocks", generator))
    attempts = generate_block(range(stored.card["num_attempts"]), DISTRIBUTION, "discrete", generator.planner, 3)
    solved = np.flatnonzero(attempts["solved"])
    assert stored.card["failed_indices"] == np.flatnonzero(~attempts["solved"]).tolist() != []
    assert stored.indices.tolist() == solved.tolist() and len(solved) == COUNT
    assert solved[-1] == stored.card["num_attempts"] - 1  # no attempt after the last demonstration


def test_finished_blocks_are_not_generated_again(tmp_path: Path) -> None:
    observed: list[tuple[range, int]] = []

    class Killed(Generator):
        def __call__(self, ranges: Sequence[range]) -> Iterable[Arrays]:
            for number, arrays in enumerate(super().__call__(ranges)):
                if number == 1:
                    raise KeyboardInterrupt
                yield arrays

    killed, resumed, reference = Killed(), Generator(), Generator()
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "set", BlockStore(tmp_path / "blocks", killed))
    (tmp_path / "blocks" / ".block-000009.ab12.tmp.npz").write_bytes(b"half")
    store = BlockStore(tmp_path / "blocks", resumed, lambda numbers, done, _: observed.append((numbers, done)))
    assert len(list((tmp_path / "blocks").glob("block-*"))) == 1
    assert not list((tmp_path / "blocks").glob(".*"))
    again = write(tmp_path / "set", store)
    assert killed.attempted[0] not in resumed.attempted
    expected = write(tmp_path / "reference", BlockStore(tmp_path / "others", reference))
    assert again.card["content_hash"] == expected.card["content_hash"]
    assert observed[0] == (range(2), 2)  # one of the first two blocks was finished before


def test_a_damaged_block_is_generated_again(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    generator = Generator()
    store = BlockStore(tmp_path, generator)
    before = list(store.blocks(range(2)))
    path = sorted(tmp_path.iterdir())[1]
    path.write_bytes(path.read_bytes()[:100])
    after = list(store.blocks(range(2)))
    assert generator.attempted[2:] == [range(BLOCK_SIZE, 2 * BLOCK_SIZE)]
    assert path.name in caplog.text
    for old, new in zip(before, after, strict=True):
        assert all(np.array_equal(old[name], new[name]) for name in old if name != "search_time_s")


def test_a_damaged_shard_is_repaired_unless_it_would_differ(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    write(folder, BlockStore(tmp_path / "blocks", Generator()))
    card = json.loads((folder / "card.json").read_text())
    shard = folder / "shard-00001.npz"
    content = shard.read_bytes()
    assert repair_set(folder, card, BlockStore(tmp_path / "blocks", Generator()), tmp_path) is None
    shard.write_bytes(content[:-1])
    other = BlockStore(tmp_path / "other", Generator(max_simulations=1))
    assert repair_set(folder, card, other, tmp_path) is False
    assert shard.read_bytes() == content[:-1]
    assert repair_set(folder, card, BlockStore(tmp_path / "again", Generator()), tmp_path) is True
    assert shard.read_bytes() == content


def test_a_planner_that_solves_hardly_anything_is_an_error_after_200_attempts(tmp_path: Path) -> None:
    template = generate_block(range(BLOCK_SIZE), DISTRIBUTION, "discrete", KinodynamicRRT(max_simulations=1), 3)
    assert not template["solved"].any()

    def hopeless(ranges: Sequence[range]) -> Iterable[Arrays]:
        for indices in ranges:
            yield template | {"index": np.array(indices)}

    writer = DemonstrationWriter(tmp_path / "set", "discrete", 100, SHARD_SIZE)
    with pytest.raises(ConfigError, match="solved 0 of 200 task instances"):
        write_set(BlockStore(tmp_path / "blocks", hopeless), writer)


def test_a_planner_that_solves_an_eighth_is_good_enough(tmp_path: Path) -> None:
    """One attempt of every block of eight is solved; 26 demonstrations need 208 attempts, more than 200."""
    solved = generate_block(range(BLOCK_SIZE), DISTRIBUTION, "discrete", KinodynamicRRT(max_simulations=600), 3)
    position = int(np.flatnonzero(solved["solved"])[0])
    one = between(solved, position, position + 1)
    failed = generate_block(range(BLOCK_SIZE - 1), DISTRIBUTION, "discrete", KinodynamicRRT(max_simulations=1), 3)
    template = concatenate([failed, one])

    def rarely(ranges: Sequence[range]) -> Iterable[Arrays]:
        for indices in ranges:
            yield template | {"index": np.array(indices)}

    writer = DemonstrationWriter(tmp_path / "set", "discrete", 26, SHARD_SIZE)
    metrics = write_set(BlockStore(tmp_path / "blocks", rarely), writer).metrics()
    assert (metrics["demonstrations"], metrics["attempts"]) == (26, 26 * BLOCK_SIZE)


@pytest.mark.parametrize("change", ["other arrays", "no times", "times of another type", "dangling link"])
def test_a_block_of_something_else_is_generated_again(tmp_path: Path, change: str) -> None:
    generator = Generator()
    store = BlockStore(tmp_path, generator)
    before = list(store.blocks(range(2)))
    path = sorted(tmp_path.iterdir())[1]
    arrays = read_arrays(path)
    if change == "dangling link":
        path.unlink()
        path.symlink_to(tmp_path / "nowhere")
    else:
        if change == "other arrays":
            del arrays["solved"]
        elif change == "no times":
            del arrays["search_time_s"]
        else:
            arrays["search_time_s"] = arrays["search_time_s"].astype(complex)
        write_arrays(path, arrays)
        with pytest.raises(DataError, match=rf"{path.name} is damaged: .*delete it"):
            read_attempts(path)
    after = list(store.blocks(range(2)))
    assert generator.attempted[2:] == [range(BLOCK_SIZE, 2 * BLOCK_SIZE)]
    for old, new in zip(before, after, strict=True):
        assert all(np.array_equal(old[name], new[name]) for name in old if name != "search_time_s")


def test_a_folder_in_the_place_of_a_block_is_named(tmp_path: Path) -> None:
    (tmp_path / "block-000001.npz").mkdir()
    (tmp_path / "block-000001.npz" / "thesis.tex").write_text("ten days of work")
    with pytest.raises(DataError, match=r"block-000001\.npz is a folder"):
        list(BlockStore(tmp_path, Generator()).blocks(range(2)))
    assert (tmp_path / "block-000001.npz" / "thesis.tex").is_file()
