"""Tables of the learning studies (Fig. 5 and 6), from the output folders of their sweeps."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import pandas as pd

from visualrhp.documents import files_named, shown_path
from visualrhp.errors import DataError
from visualrhp.evaluation.curves import CURVES, read_curve_table
from visualrhp.evaluation.episodes import read_episodes
from visualrhp.evaluation.methods import ACTION_SPACES

TASKS_PER_BATCH: Final = 20
"""Tasks over which a success rate of Fig. 5 is taken (Sec. 7.4)."""


def demonstration_batches(folder: Path) -> pd.DataFrame:
    """One row per batch of tasks, from ``<number>/evaluation/<action space>/episodes.parquet``.

    Returns:
        A table with the columns action_space, num_demonstrations, success_rate.

    Raises:
        DataError: there is no such file, or one is damaged or in a folder of another name.
    """
    rows = []
    for path in files_named(folder, "*/evaluation/*", "episodes.parquet"):
        number = path.parts[-4]
        if not re.fullmatch("[0-9]{1,9}", number) or path.parts[-2] not in ACTION_SPACES:
            raise DataError(
                f"{shown_path(path)} is not in a folder <number of demonstrations>/evaluation/<action space>, as jobs "
                "of the sweep are; move it away, or run the sweep again"
            )
        episodes = read_episodes(path).sort_values("episode")
        batch = episodes["episode"] // TASKS_PER_BATCH
        for _, tasks in episodes.groupby(batch):
            point = {"action_space": path.parts[-2], "num_demonstrations": int(number)}
            rows.append(point | {"success_rate": float(tasks["success"].to_numpy().mean())})
    if not rows:
        raise _no_sweep("demonstrations", folder, "fig5_evaluation")
    return pd.DataFrame(rows)


def stability_trials(folder: Path) -> pd.DataFrame:
    """One row per greedy evaluation of a training, from ``baseline_step_<bool>/seed_<number>/curves.csv``.

    Returns:
        A table with the columns algorithm ("C3PO" or "PPO"), trial, transitions, success_rate.

    Raises:
        DataError: there is no such file, or one is damaged.
    """
    tables = []
    for path in files_named(folder, "baseline_step_*/seed_*", "curves.csv"):
        curves = read_curve_table(path, "greedy/success_rate", "collection/transitions")
        rates = curves.loc[curves["greedy/success_rate"].notna()]
        if rates.empty:
            raise CURVES.unusable(path, "has no evaluation of the greedy policy")
        transitions = rates["collection/transitions"].fillna(0)  # none before the first iteration
        tables.append(
            pd.DataFrame(
                {
                    "algorithm": "C3PO" if path.parts[-3].endswith("True") else "PPO",
                    "trial": path.parts[-2],
                    "transitions": transitions,
                    "success_rate": rates["greedy/success_rate"],
                }
            )
        )
    if not tables:
        raise _no_sweep("stability", folder, "fig6")
    return pd.concat(tables, ignore_index=True)


def _no_sweep(key: str, folder: Path, experiment: str) -> DataError:
    return DataError(
        f"sweeps.{key}={folder} has no finished job; the first lines of conf/experiment/{experiment}.yaml say how to "
        "run it"
    )
