"""Settings of an evaluation: what a suite stands for, and what can be run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipelines.config import EvaluateConfig
from pipelines.planners import fixes_num_objects
from pipelines.points import Point, compose_points, network_hashes, prepare
from pipelines.workflow.app import compose
from visualrhp.errors import CheckpointError, ConfigError, DataError

SETTINGS = (
    "scale=smoke",
    "tracking=none",
    "planner=crafted_heuristic_rhp",
    "num_episodes=3",
    "scene.num_objects=[1,3]",
)


def configure(*overrides: str, suite: dict[str, dict[str, Any]] | None = None) -> EvaluateConfig:
    return replace(compose("evaluate", EvaluateConfig, [*SETTINGS, *overrides]), suite=suite)


def test_a_suite_is_the_product_of_its_values_and_counts_no_episode_twice() -> None:
    suite = {
        "noise": {"noise_level": ["none", "high"], "scene.num_objects": [1, [1, 2]]},
        "again": {"scene.num_objects": [[1, 2]], "num_episodes": [5]},
    }
    points = compose_points(configure(suite=suite))
    found = [(p.experiment, p.config.noise_level, p.config.scene.num_objects, p.config.num_episodes) for p in points]
    assert found == [
        ("noise", "none", (1, 1), 3),
        ("noise", "none", (1, 2), 5),  # the other block has the same tasks, and more of them
        ("noise", "high", (1, 1), 3),
        ("noise", "high", (1, 2), 3),
    ]
    assert {p.config.planner.name for p in points} == {"CraftedHeuristicRHP"}
    assert len({p.identity for p in points}) == 4


def test_a_wrong_key_in_a_suite_is_an_error_before_any_work() -> None:
    with pytest.raises(ConfigError, match="noise"):
        compose_points(configure(suite={"block": {"noise": ["high"]}}))


def cartesian(untrained_heuristics: Path, *overrides: str) -> EvaluateConfig:
    config = compose(
        "evaluate", EvaluateConfig, [*SETTINGS[:2], "planner=cartesian_rhp", "num_episodes=12", *overrides]
    )
    return replace(config, heuristics=str(untrained_heuristics))


def test_numbers_of_objects_without_a_network_are_skipped_and_counted(
    untrained_heuristics: Path, caplog: pytest.LogCaptureFixture
) -> None:
    points = prepare(compose_points(cartesian(untrained_heuristics, "scene.num_objects=[1,3]")))
    (point,) = points
    assert sorted(point.episodes + point.skipped) == list(range(12))
    assert point.episodes and point.skipped
    assert f"no network for 3 objects: {len(point.skipped)} of 12" in caplog.text


def test_networks_that_are_missing_or_of_another_kind_are_an_error_before_any_work(untrained_heuristics: Path) -> None:
    with pytest.raises(CheckpointError, match=r"heuristic_m5\.safetensors"):
        prepare(compose_points(cartesian(untrained_heuristics, "scene.num_objects=5")))
    with pytest.raises(CheckpointError, match="discrete"):
        prepare(compose_points(cartesian(untrained_heuristics, "planner=greedy", "action_space=discrete")))
    suite = {"block": {"planner": ["cartesian_rhp"], "scene.num_objects": [5, 6]}}
    points = compose_points(replace(configure(suite=suite), heuristics=str(untrained_heuristics)))
    with pytest.raises(DataError, match="nothing can be evaluated"):
        prepare(points)


def test_a_point_is_identified_by_what_its_results_depend_on() -> None:
    def identity(*overrides: str) -> str:
        return Point("block", configure(*overrides)).identity

    assert identity() == identity("num_episodes=9") == identity("paths.artefact=a", "executor.num_workers=1")
    assert len({identity(), identity("seed=1"), identity("planner.horizon=2"), identity("noise_level=low")}) == 4


def test_the_card_describes_a_point() -> None:
    (point,) = prepare(compose_points(configure("noise_level=low", "seed=4")))
    card = point.card
    assert (card["experiment"], card["planner"], card["num_rollouts"], card["horizon"]) == (
        *("single", "CraftedHeuristicRHP", 8, 4),
    )
    assert (card["scene_num_objects"], card["noise_level"], card["seed"]) == ("1-3", "low", 4)
    assert (card["num_episodes"], card["num_skipped"]) == (3, 0)
    assert card["planner_config"]["heuristic"]["kind"] == "crafted"
    assert list(card["scene"]["num_objects"]) == [1, 3] and card["physics"]["time_step"] > 0.0


def test_networks_are_listed_with_their_hashes(untrained_heuristics: Path) -> None:
    points = compose_points(cartesian(untrained_heuristics, "scene.num_objects=[1,3]"))
    hashes = network_hashes(prepare(points))
    assert list(hashes) == [f"continuous/cartesian/heuristic_m{m}.safetensors" for m in (1, 2)]
    assert all(len(value) == 64 for value in hashes.values())
    assert network_hashes(prepare(compose_points(configure()))) == {}


@pytest.mark.parametrize(
    ("planner", "expected"),
    [("cartesian_rhp", True), ("visual_rhp", False), ("crafted_heuristic_rhp", False), ("kinodynamic_rrt", False)],
)
def test_cartesian_networks_are_for_one_number_of_objects(planner: str, expected: bool) -> None:
    assert fixes_num_objects(compose("evaluate", EvaluateConfig, [f"planner={planner}"]).planner) == expected
