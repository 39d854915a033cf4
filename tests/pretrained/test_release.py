"""The released networks: their files and cards, and their skill on fixed task instances."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import visualrhp
from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.execution import run_task
from visualrhp.heuristics.checkpoint import load_heuristic, read_network
from visualrhp.planning import RecedingHorizon
from visualrhp.pretrained import PROCEDURES, load_pretrained, pretrained_folder, pretrained_path
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.simulation import make_action_space
from visualrhp.streams import Split
from visualrhp.types import ActionSpaceName

FILES = sorted(path for procedure in PROCEDURES for path in pretrained_folder(procedure).rglob("*.safetensors"))
SPACES: tuple[ActionSpaceName, ...] = ("continuous", "discrete")


@pytest.mark.parametrize("path", FILES, ids=lambda path: "-".join(path.with_suffix("").parts[-4:]))
def test_every_network_has_a_card_that_says_where_it_comes_from(path: Path) -> None:
    card = read_network(path).card
    assert path.with_suffix(".json").is_file()
    assert len(card["commit"]) == 40 and card["stage"] in ("train_rl", "expert_iteration")
    assert {"config", "seed", "metrics", "inputs", "versions"} <= set(card)
    assert load_heuristic(path, card["config"]["action_space"]["name"]).observation.name == path.parent.name


@pytest.mark.parametrize("space", SPACES)
def test_both_procedures_have_an_image_network(space: ActionSpaceName) -> None:
    for procedure in PROCEDURES:
        assert pretrained_path(space, procedure=procedure) in FILES
    assert load_pretrained(space).action_space == space
    assert load_pretrained(space, "cartesian", 4, procedure="paper").observation.num_objects == 4


def test_the_networks_take_a_few_megabytes() -> None:
    assert sum(path.stat().st_size for path in FILES) < 5e6


def test_what_was_not_released_is_an_error_that_lists_what_was() -> None:
    with pytest.raises(ConfigError, match=r"no released network continuous/cartesian/heuristic_m8.*discrete/image"):
        load_pretrained("continuous", "cartesian", 8, procedure="paper")
    with pytest.raises(ConfigError, match="num_objects is missing"):
        load_pretrained("continuous", "cartesian")
    with pytest.raises(ConfigError, match="choose best or paper"):
        pretrained_folder("good")  # pyright: ignore[reportArgumentType]


def test_a_damaged_file_is_reported(tmp_path: Path) -> None:
    content = bytearray(pretrained_path("discrete").read_bytes())
    content[-100] ^= 1
    (tmp_path / "heuristic.safetensors").write_bytes(content)
    with pytest.raises(CheckpointError, match="checksum"):
        load_heuristic(tmp_path / "heuristic.safetensors")


def test_a_network_is_loaded_in_one_line_without_torch() -> None:
    code = "import sys, visualrhp; visualrhp.load_pretrained('continuous'); assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    assert visualrhp.load_pretrained is load_pretrained
    with pytest.raises(AttributeError, match="no attribute 'load'"):
        _ = visualrhp.load  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(("space", "most_actions"), [("continuous", 6.0), ("discrete", 15.0)])
def test_visualrhp_plus_is_skilled_with_the_best_networks(space: ActionSpaceName, most_actions: float) -> None:
    planner = RecedingHorizon.plus(load_pretrained(space))
    results = []
    for index in range(30):
        task = sample_task_instance(SceneDistribution(num_objects=(1, 7)), 11, Split.TUNING, index)
        results.append(run_task(planner, task, 11, Split.TUNING, index, action_space=make_action_space(space)))
    assert sum(result.success for result in results) >= 29
    assert np.mean([result.num_actions for result in results if result.success]) <= most_actions


@pytest.mark.parametrize("wrong", ["", "../best", "x" * 5000, "a\0b"])
def test_names_of_networks_that_were_not_released_are_refused(wrong: str) -> None:
    with pytest.raises(ConfigError):
        load_pretrained(wrong)
    with pytest.raises(ConfigError):
        load_pretrained("discrete", wrong)
    with pytest.raises(ConfigError):
        load_pretrained("discrete", "cartesian", wrong, "paper")
