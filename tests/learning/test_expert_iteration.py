"""Expert iteration with scripted episodes: rounds, the network that is kept, and resuming."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from visualrhp.errors import CheckpointError, ConfigError, DataError
from visualrhp.heuristics.conversion import load_network, save_heuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.learning.configs import ActorCriticImitationConfig, ExpertIterationConfig
from visualrhp.learning.expert_episodes import Arrays
from visualrhp.learning.expert_iteration import BLOCK_SIZE, ExpertIteration, data_of_blocks
from visualrhp.observation import make_observation
from visualrhp.types import Metrics

OBSERVATION = make_observation("cartesian", 1)
CONFIG = ExpertIterationConfig(
    rounds=3,
    episodes_per_round=60,
    max_objects=(2, 6),
    replay_rounds=2,
    imitation=ActorCriticImitationConfig(batch_size=16, epochs=2, lr=1e-3, validation_fraction=0.0),
)


def block_of(indices: Sequence[int]) -> Arrays:
    """Two pairs of every episode."""
    rng = np.random.default_rng(indices[0])
    count = 2 * len(indices)
    return {
        "observation": rng.random((count, *OBSERVATION.shape), np.float32),
        "gripper_closed": np.zeros(count, np.bool_),
        "action": rng.uniform(-1.0, 1.0, (count, 4)).astype(np.float32),
        "returns": -rng.random(count, np.float32),
        "steps_to_go": np.tile([2, 1], len(indices)),
        "episode": np.repeat(np.array(indices), 2),
        "is_target": np.ones(count, np.bool_),
        "is_valued": np.ones(count, np.bool_),
        "num_objects": np.ones(len(indices), np.int64),
        "success": np.ones(len(indices), np.bool_),
        "dropped": np.zeros(len(indices), np.bool_),
        "num_actions": np.full(len(indices), 2),
        "is_greedy": np.zeros(len(indices), np.bool_),
    }


class Scripted:
    """Collects blocks in reverse, and validates with scripted numbers of actions per network."""

    def __init__(self, actions: dict[str, int], stop_after: int | None = None) -> None:
        self.actions = actions
        self.stop_after = stop_after
        self.collected: list[tuple[str, int, range]] = []

    def collect(self, network: Path, max_objects: int, blocks: Sequence[range]) -> Iterator[tuple[range, Arrays]]:
        for block in reversed(blocks):
            if self.stop_after is not None and len(self.collected) >= self.stop_after:
                raise KeyboardInterrupt
            self.collected.append((network.parent.name, max_objects, block))
            yield block, block_of(block)

    def validate(self, network: Path) -> Arrays:
        rows = block_of(range(4))
        rows["num_actions"] = np.full(4, self.actions[network.parent.name])
        return rows


@pytest.fixture
def start(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    path = tmp_path / "start" / "heuristic.safetensors"
    save_heuristic(path, make_network("continuous", OBSERVATION))
    return path


ACTIONS = {"start": 10, "round_001": 8, "round_002": 9, "round_003": 7}


def iteration(start: Path, folder: Path, script: Scripted) -> ExpertIteration:
    return ExpertIteration(start, folder, CONFIG, 5, script.collect, script.validate)


def test_the_best_network_is_kept_and_rounds_go_on_from_the_latest(start: Path, tmp_path: Path) -> None:
    script = Scripted(ACTIONS)
    learner = iteration(start, tmp_path / "work", script)
    rows = list(learner.run())
    assert [row["round"] for row in rows] == [0.0, 1.0, 2.0, 3.0]
    assert [row["validation/kept"] for row in rows] == [1.0, 1.0, 0.0, 1.0]
    assert learner.best_round == 3 and learner.best_score == pytest.approx(1.0 - 0.5 * 7 / 49)
    guides = dict.fromkeys((name, most) for name, most, _ in script.collected)
    assert list(guides) == [("start", 2), ("round_001", 4), ("round_002", 6)], (
        "the latest network guides the next round"
    )
    assert sorted(block.start for _, _, block in script.collected) == [0, 25, 50, 60, 85, 110, 120, 145, 170]
    assert [row["imitation/pairs"] for row in rows[1:]] == [120.0, 240.0, 240.0], "of the last two rounds"


def test_a_killed_iteration_resumes_to_the_same_networks(start: Path, tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    rows = list(iteration(start, whole, Scripted(ACTIONS)).run())
    script = Scripted(ACTIONS, stop_after=4)  # one block of the second round is finished
    with pytest.raises(KeyboardInterrupt):
        list(iteration(start, killed, script).run())
    script.stop_after = None
    resumed = iteration(start, killed, script)
    assert strip(list(resumed.run())) == strip(rows)
    assert len(script.collected) == 9, "no block is computed twice"
    for round_ in (1, 2, 3):
        first, second = (
            load_network(folder / f"round_{round_:03d}" / "network.safetensors")[0].state_dict()
            for folder in (whole, killed)
        )
        assert all(torch.equal(first[name], second[name]) for name in first)


def strip(rows: list[Metrics]) -> list[Metrics]:
    return [{name: value for name, value in row.items() if "time" not in name} for row in rows]


def test_rounds_grow_linearly_and_blocks_cover_them() -> None:
    assert [CONFIG.max_objects_in(round_) for round_ in (1, 2, 3)] == [2, 4, 6]
    assert ExpertIterationConfig(rounds=1).max_objects_in(1) == 7
    for wrong in ((6, 2), (7, 21)):
        with pytest.raises(ConfigError, match="max_objects"):
            ExpertIterationConfig(max_objects=wrong)
    assert CONFIG.episodes_per_round % BLOCK_SIZE, "the last block of a round is smaller"


def test_episodes_without_actions_are_refused() -> None:
    empty = {name: values[:0] for name, values in block_of([0]).items()}
    with pytest.raises(DataError, match="no actions"):
        data_of_blocks([empty], OBSERVATION)


@pytest.mark.parametrize("text", ["", "{", "null", "{}", "[null]", '[{"round": 0.0}]', '[{"round": "0"}]', "\ufeff[]"])
def test_a_damaged_history_says_what_to_delete(start: Path, tmp_path: Path, text: str) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    (folder / "rounds.json").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=r"rounds\.json .*delete the folder it is in"):
        iteration(start, folder, Scripted(ACTIONS))


def test_a_history_in_which_nothing_was_kept_goes_back_to_the_initial_network(start: Path, tmp_path: Path) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    rows = [{"round": 0.0, "validation/kept": 0.0, "validation/score": 0.5}]
    (folder / "rounds.json").write_text(json.dumps(rows))
    assert iteration(start, folder, Scripted(ACTIONS)).best_round == 0


def test_what_stands_in_the_place_of_work_files_is_named(start: Path, tmp_path: Path) -> None:
    folder = tmp_path / "work"
    block = folder / "round_001" / "block_00000000.npz"
    block.mkdir(parents=True)
    with pytest.raises(DataError, match=r"block_00000000\.npz is a folder.*delete it"):
        list(iteration(start, folder, Scripted(ACTIONS)).run())
    block.rmdir()
    (folder / "round_001" / "imitation.safetensors").mkdir()
    with pytest.raises(CheckpointError, match=r"imitation\.safetensors is a folder.*delete this file"):
        list(iteration(start, folder, Scripted(ACTIONS)).run())
