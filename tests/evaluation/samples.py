"""Results of episodes, and tables of them, that no planner has to run for."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from visualrhp.evaluation.episodes import EPISODE_COLUMNS, SETTING_COLUMNS
from visualrhp.execution.episode import EpisodeResult, TimedDecision
from visualrhp.planning.planner import Decision
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.types import Episode, Outcome, State

SQUARE = ObjectShape.centred([[0.0, 0.0], [0.04, 0.0], [0.04, 0.04], [0.0, 0.04]])
METHODS = [("VisualRHP", 3, 3), ("VisualRHP", 6, 6), ("Greedy", None, None), ("mine", 2, 5)]


def sample_scene(num_objects: int = 1) -> Scene:
    """Squares, and a target region on the right."""
    return Scene(TargetRegion(np.array([0.2, 0.0])), (SQUARE,) * num_objects)


def sample_state(gripper: tuple[float, float], desired: tuple[float, float], num_objects: int = 1) -> State:
    """The gripper and the desired object at positions; the others far from both."""
    others = [[-0.2, -0.2 + 0.05 * number, 0.0] for number in range(num_objects - 1)]
    return State.create([*gripper, 0.0], 0.085, False, [[*desired, 0.0], *others])


def sample_result(
    outcome: str = "success",
    num_objects: int = 4,
    num_actions: int = 8,
    decision_time_s: float = 0.3,
    simulation_time_s: float = 0.1,
) -> EpisodeResult:
    """An episode in which the gripper pushes the desired object to the right, from behind."""
    steps = [0.01 * number for number in range(num_actions + 1)]
    states = tuple(sample_state((x - 0.1, 0.0), (x, 0.0), num_objects) for x in steps)
    episode = Episode(states, (0,) * num_actions, (-1.0,) * num_actions, Outcome(outcome))
    decisions = (TimedDecision(states[0], Decision(0), decision_time_s),)
    return EpisodeResult(sample_scene(num_objects), episode, decisions, simulation_time_s)


def sample_table(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """A table of episodes: ``rows`` say what differs from a plain success; times and the like follow."""
    complete = []
    for number, given in enumerate(rows):
        row: dict[str, Any] = {
            "experiment": "mixed",
            "planner": "VisualRHP",
            "action_space": "continuous",
            "num_rollouts": None,
            "horizon": None,
            "scene_num_objects": "4",
            "object_size": "mixed",
            "layout": "uniform",
            "noise_level": "none",
            "seed": 0,
            "episode": number,
            "num_objects": 4,
            "success": True,
            "num_actions": 10,
            "decision_time_s": 0.5,
            "simulation_time_s": 0.01,
            "num_invalid_rollouts": 0,
            **given,
        }
        row.setdefault("dropped", not row["success"])
        row["outcome"] = "success" if row["success"] else "dropped" if row["dropped"] else "out of actions"
        row.setdefault(
            "failure", {"success": "none", "dropped": "obstacle dropped"}.get(row["outcome"], row["outcome"])
        )
        row["action_efficiency"] = row["num_objects"] / row["num_actions"] if row["success"] else np.nan
        row["mean_decision_time_s"] = row["decision_time_s"] / row["num_actions"]
        row["execution_time_s"] = row["decision_time_s"] + row["simulation_time_s"]
        row["return"] = -float(row["num_actions"])
        complete.append(row)
    table = pd.DataFrame(complete, columns=list(EPISODE_COLUMNS))
    return table.astype({"num_rollouts": "Int64", "horizon": "Int64"})


def ablation_table() -> pd.DataFrame:
    """Ten episodes per cell; the number of successes identifies the cell."""
    rows = []
    cells = itertools.product(METHODS, ("continuous", "discrete"), ("small", "mixed", "large"), ("1", "4", "1-7"))
    for number, ((planner, n, h), space, size, requested) in enumerate(cells):
        for level in ("none", "high") if size == "mixed" and space == "continuous" else ("none",):
            for episode in range(10):
                rows.append(
                    {
                        "planner": planner,
                        "num_rollouts": n,
                        "horizon": h,
                        "action_space": space,
                        "object_size": size,
                        "layout": "uniform",
                        "noise_level": level,
                        "scene_num_objects": requested,
                        "num_objects": 1 + episode % 7 if requested == "1-7" else int(requested),
                        "episode": episode,
                        "success": episode < number % 11,
                        "decision_time_s": 0.1 * (episode + 1),
                    }
                )
    return sample_table(rows)


def report_table() -> pd.DataFrame:
    """Ten episodes per cell: 9 successes of VisualRHP, 5 of Greedy, 10 of K.RRT."""
    rows = []
    for planner, n, h, successes in (("VisualRHP", 3, 3, 9), ("Greedy", None, None, 5), ("K.RRT", None, None, 10)):
        for space in ("continuous", "discrete"):
            for size, requested, level in (("mixed", "1-7", "none"), ("small", "1-7", "none"), ("mixed", "4", "high")):
                for episode in range(10):
                    rows.append(
                        {
                            "planner": planner,
                            "num_rollouts": n,
                            "horizon": h,
                            "action_space": space,
                            "object_size": size,
                            "layout": "uniform",
                            "scene_num_objects": requested,
                            "noise_level": level,
                            "episode": episode,
                            "num_objects": 4 if requested == "4" else 1 + episode % 7,
                            "success": episode < successes,
                        }
                    )
    return sample_table(rows)


def evaluation_card(episodes: pd.DataFrame) -> dict[str, Any]:
    """The card of an evaluation that made ``episodes`` and skipped 3 episodes of VisualRHP per setting."""
    rows = pd.DataFrame(episodes[list(SETTING_COLUMNS)]).drop_duplicates().to_dict("records")
    points = [{str(key): None if pd.isna(value) else value for key, value in row.items()} for row in rows]
    for point in points:
        point |= {"num_episodes": 10, "num_skipped": 3 if point["planner"] == "VisualRHP" else 0}
    return {
        "scale": "smoke",
        "seed": 0,
        "commit": "0123456789abcdef",
        "versions": {"visualrhp": "1"},
        "config": {"seed": 0},
        "points": points,
        "networks": {},
        "num_episodes": len(episodes),
        "wall_time_s": 61.0,
        "num_workers": 2,
        "machine": "a processor, 2 cores",
        "date": "2026-01-31",
    }
