"""Episodes of the planner: what the policy and the value learn from them, with a crafted heuristic."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visualrhp.errors import DataError
from visualrhp.heuristics.conversion import heuristic_of
from visualrhp.heuristics.crafted import CraftedHeuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.learning.expert_episodes import (
    PAIR_ARRAYS,
    Arrays,
    ExpertSetting,
    read_block,
    return_after,
    run_expert_block,
    score,
    validate_block,
    write_block,
)
from visualrhp.observation import make_observation
from visualrhp.planning import RecedingHorizon
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.streams import Split
from visualrhp.types import ActionSpaceName, Outcome

IMAGE = make_observation("image")
FEW = SceneDistribution(num_objects=(1, 3))


def setting(space: ActionSpaceName = "continuous", **parameters: float) -> ExpertSetting:
    return replace(ExpertSetting(FEW, space, IMAGE, seed=3, discount=0.9), **parameters)  # pyright: ignore[reportArgumentType]


def expert(space: ActionSpaceName = "continuous") -> RecedingHorizon:
    return RecedingHorizon(CraftedHeuristic(space), num_rollouts=8, horizon=4, warm_start=True)


def rows_of(block: Arrays, index: int) -> Arrays:
    mask = block["episode"] == index
    return {name: block[name][mask] for name in PAIR_ARRAYS}


def test_every_episode_teaches_the_value_and_successful_ones_the_policy() -> None:
    indices = range(6)
    block = run_expert_block(indices, expert(), setting())
    assert block["observation"].shape == (len(block["returns"]), 64, 64) and block["action"].dtype == np.float32
    assert block["num_actions"].sum() == len(block["returns"]) and not block["is_greedy"].any()
    assert block["is_valued"].all()
    for index, success, dropped, count in zip(
        indices, block["success"], block["dropped"], block["num_actions"], strict=True
    ):
        rows = rows_of(block, index)
        assert rows["is_target"].all() == success
        assert rows["steps_to_go"].tolist() == list(range(count, 0, -1))
        last = -1.0 if success else -50.0 if dropped else -1.0 + 0.9 * return_after(Outcome.OUT_OF_ACTIONS, 0.9)
        assert rows["returns"][-1] == pytest.approx(last)
        np.testing.assert_allclose(rows["returns"][:-1], -1.0 + 0.9 * rows["returns"][1:], rtol=1e-5)
        instance = sample_task_instance(FEW, 3, Split.EXPERT_ITERATION, index)
        np.testing.assert_array_equal(rows["observation"][0], IMAGE(instance.scene, instance.state))


def test_the_value_after_a_truncation_is_that_of_as_many_more_actions() -> None:
    assert return_after(Outcome.OUT_OF_ACTIONS, 0.9) == pytest.approx(-sum(0.9**k for k in range(50)))
    assert return_after(Outcome.OUT_OF_ACTIONS, 1.0) == -50.0
    assert return_after(Outcome.DROPPED, 0.9) == return_after(Outcome.SUCCESS, 0.9) == 0.0


@pytest.mark.parametrize("space", ["continuous", "discrete"])
def test_where_the_greedy_policy_acts_the_planner_labels_its_states(space: ActionSpaceName) -> None:
    planner = RecedingHorizon(heuristic_of(make_network(space, IMAGE)), num_rollouts=2, horizon=1)
    block = run_expert_block(range(3), planner, setting(space, greedy_share=1.0))
    assert block["is_greedy"].all()
    np.testing.assert_array_equal(block["is_valued"], block["is_target"] & (space == "discrete"))
    assert block["is_target"].any()
    # An untrained mode repeats itself; what the planner chooses varies.
    assert len(np.unique(block["action"][block["is_target"]], axis=0)) > 1


def test_a_share_of_the_episodes_is_greedy_and_results_do_not_depend_on_the_blocks() -> None:
    greedy = setting(greedy_share=0.5)
    whole = run_expert_block(range(8), expert(), greedy)
    assert 0 < whole["is_greedy"].sum() < 8
    parts = [run_expert_block(range(start, start + 4), expert(), greedy) for start in (4, 0)]
    for name, values in whole.items():
        np.testing.assert_array_equal(values, np.concatenate([parts[1][name], parts[0][name]]), err_msg=name)


def test_validation_has_other_instances_and_a_row_per_episode() -> None:
    rows = validate_block(range(4), expert(), setting())
    assert set(rows) == {"num_objects", "success", "dropped", "num_actions", "is_greedy"}
    expected = [sample_task_instance(FEW, 3, Split.VALIDATION, index).scene.num_objects for index in range(4)]
    assert rows["num_objects"].tolist() == expected


def test_the_score_counts_a_failure_as_all_actions() -> None:
    rows = {"success": np.array([True, False]), "num_actions": np.array([7, 3])}
    assert score(rows, 0.5) == pytest.approx(((1.0 - 0.5 * 7 / 49) + (0.0 - 0.5)) / 2)


def test_blocks_are_stored_exactly_and_damage_is_reported(tmp_path: Path) -> None:
    block = run_expert_block(range(2), expert(), setting())
    write_block(tmp_path / "block.npz", block)
    stored = read_block(tmp_path / "block.npz")
    assert stored.keys() == block.keys()
    for name, values in block.items():
        np.testing.assert_array_equal(stored[name], values)
        assert stored[name].dtype == values.dtype
    content = bytearray((tmp_path / "block.npz").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "block.npz").write_bytes(content)
    with pytest.raises(DataError, match=r"block\.npz is damaged"):
        read_block(tmp_path / "block.npz")
    with pytest.raises(DataError, match="missing"):
        read_block(tmp_path / "missing.npz")


@pytest.mark.parametrize(
    "change",
    [
        {"observation": None},
        {"returns": None},
        {"success": None},
        {"returns": np.array(1.0, np.float32)},
        {"returns": np.zeros(1, np.float32)},
        {"steps_to_go": np.zeros(3)},
        {"is_target": np.zeros(3)},
        {"action": np.zeros(3, np.complex64)},
        {"action": np.full((3, 4), np.nan)},
        {"num_actions": np.array([3, 4])},
        {"success": np.array(["yes"])},
    ],
    ids=str,
)
def test_blocks_of_other_arrays_are_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    path = tmp_path / "block.npz"
    block: dict[str, Any] = {
        "observation": np.zeros((3, 8, 8), np.uint8),
        "gripper_closed": np.zeros(3, np.bool_),
        "action": np.zeros((3, 4), np.float32),
        "returns": np.zeros(3, np.float32),
        "steps_to_go": np.arange(3, 0, -1),
        "episode": np.zeros(3, np.int64),
        "is_target": np.ones(3, np.bool_),
        "is_valued": np.ones(3, np.bool_),
        "num_objects": np.array([1]),
        "success": np.array([True]),
        "dropped": np.array([False]),
        "num_actions": np.array([3]),
        "is_greedy": np.array([False]),
    }
    write_block(path, block)
    assert read_block(path).keys() == block.keys()
    write_block(path, {name: values for name, values in (block | change).items() if values is not None})
    with pytest.raises(DataError, match=r"block\.npz is damaged: .*delete it"):
        read_block(path)
