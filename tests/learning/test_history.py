"""Summaries of training histories."""

from __future__ import annotations

from visualrhp.learning.history import expert_iteration_summary, imitation_summary, reinforcement_summary


def test_the_summary_leaves_times_out() -> None:
    history = [{"epoch": 2.0, "lr": 0.1, "samples_per_s": 5.0, "train/loss": 1.5, "greedy/success_rate": 0.5}]
    assert imitation_summary(history) == {"epochs": 2, "train": {"loss": 1.5}, "greedy": {"success_rate": 0.5}}


def test_summary_names_the_initial_the_best_and_the_last() -> None:
    history = [
        {"iteration": 0.0, "greedy/success_rate": 0.5},
        {"iteration": 1.0, "collection/transitions": 10.0},
        {"iteration": 2.0, "greedy/success_rate": 0.7, "greedy/evaluation_time_s": 3.0, "collection/transitions": 20.0},
        {"iteration": 3.0, "greedy/success_rate": 0.6, "collection/transitions": 30.0},
    ]
    assert reinforcement_summary(history, best_iteration=2) == {
        "iterations": 3,
        "transitions": 30,
        "best_iteration": 2,
        "initial": {"success_rate": 0.5},
        "best": {"success_rate": 0.7},
        "last": {"success_rate": 0.6},
    }


def test_expert_iteration_shows_the_initial_the_best_and_the_last() -> None:
    history = [
        {"round": 0.0, "validation/score": 0.5, "greedy/success_rate": 0.25},
        {"round": 1.0, "validation/score": 0.75, "greedy/success_rate": 0.5, "imitation/pairs": 4.0},
    ]
    assert expert_iteration_summary(history, 1) == {
        "rounds": 1,
        "best_round": 1,
        "initial": {"validation": {"score": 0.5}, "greedy": {"success_rate": 0.25}},
        "best": {"validation": {"score": 0.75}, "greedy": {"success_rate": 0.5}},
        "last": {"validation": {"score": 0.75}, "greedy": {"success_rate": 0.5}},
    }
