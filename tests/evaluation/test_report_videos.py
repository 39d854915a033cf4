"""Arrangement of videos."""

from __future__ import annotations

from visualrhp.evaluation.report_videos import Attempt, arrange_attempts


def attempt(scene_index: int, action_space: str, method: str) -> Attempt:
    return Attempt(scene_index, action_space, method, "", None)


def test_attempts_are_arranged_by_scene_action_space_and_method() -> None:
    attempts = [
        attempt(1, "discrete", "Greedy"),
        attempt(0, "continuous", "K.RRT"),
        attempt(0, "continuous", "VisualRHP 3x3"),
        attempt(0, "discrete", "Greedy"),
    ]
    first, second = arrange_attempts(attempts, {0: 1, 1: 7}, ["continuous", "discrete"], seed=3)
    assert (first.title, first.subtitle) == ("One object", "mixed sizes, task 0 of seed 3")
    assert (second.title, second.subtitle) == ("7 objects", "mixed sizes, task 1 of seed 3")
    assert [row.title for row in first.rows] == ["Continuous actions", "Discrete actions"]
    assert [row.attempts for row in first.rows] == [[attempts[2], attempts[1]], [attempts[3]]]
    assert [row.attempts for row in second.rows] == [[], [attempts[0]]]


def test_files_are_named_by_scene_action_space_and_method() -> None:
    assert attempt(2, "discrete", "VisualRHP 3x3").stem == "scene_2_discrete_VisualRHP_3x3"
