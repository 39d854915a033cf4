"""The history of a training, one row of metrics per epoch, iteration or round: its schema, and summaries."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Annotated, Any, Final

from pydantic import AfterValidator

from visualrhp.documents import FileKind, Finite, document
from visualrhp.parameters import Index
from visualrhp.types import Metrics

WORK_FILE: Final = FileKind(
    "a work file of a training (JSON)", "delete the folder it is in, and rerun the command to train again"
)
"""Files that a training leaves in its work folder for its own process or a later one."""

_REPORTED = ("success_rate", "dropped_rate", "action_efficiency", "num_actions")


def _numbered_by(unit: str, first: Sequence[int], *required: str) -> AfterValidator:
    """The condition that rows are numbered, beginning with one of ``first``, and have further keys."""

    def check(rows: list[Metrics]) -> list[Metrics]:
        for number, row in enumerate(rows):
            missing = next((key for key in (unit, *required) if key not in row), None)
            if missing is not None:
                raise ValueError(f"row {number} of the history lacks {missing}")
            if rows[0][unit] not in first or row[unit] != rows[0][unit] + number:
                raise ValueError(f"row {number} of the history has {unit}={row[unit]:g}, but rows are numbered")
        return rows

    return AfterValidator(check)


EpochHistory = Annotated[list[dict[str, Finite]], _numbered_by("epoch", (1,))]
IterationHistory = Annotated[list[dict[str, Finite]], _numbered_by("iteration", (0, 1))]
RoundHistory = Annotated[list[dict[str, Finite]], _numbered_by("round", (0,), "validation/kept", "validation/score")]
"""The histories of imitation, reinforcement learning and expert iteration."""


@document
class ImitationProgress:
    """The values in the state of an imitation."""

    epoch: Index
    history: EpochHistory

    def __post_init__(self) -> None:
        if self.epoch != len(self.history):
            raise ValueError(f"epoch={self.epoch} does not match its history of {len(self.history)} epochs")


@document
class ReinforcementProgress:
    """The values in the state of a reinforcement learning."""

    iteration: Index
    best_iteration: Index
    best_score: tuple[Finite, Finite] | None
    history: IterationHistory

    def __post_init__(self) -> None:
        last = self.history[-1]["iteration"] if self.history else 0
        if self.iteration != last or self.best_iteration > last:
            raise ValueError(
                f"iteration={self.iteration} and best_iteration={self.best_iteration} do not match its history, which "
                f"ends at {last:g}"
            )


def read_history(path: str | os.PathLike[str], schema: Any) -> list[Metrics]:
    """Read a history (JSON), one of the types above.

    Raises:
        DataError: the file is missing or damaged, or is not such a history.
    """
    rows = WORK_FILE.read_content(path)
    WORK_FILE.check(path, schema, rows)
    return rows


def read_summary(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read one of the summaries below (JSON).

    Raises:
        DataError: the file is missing or damaged.
    """
    return WORK_FILE.read(path, dict[str, Any])


def imitation_summary(history: Sequence[Metrics]) -> dict[str, Any]:
    """The metrics of the last epoch by group, without times."""
    last = history[-1]
    metrics: dict[str, Any] = {"epochs": int(last["epoch"])}
    for group in ("train", "validation", "greedy"):
        prefix = f"{group}/"
        rows = {name.removeprefix(prefix): value for name, value in last.items() if name.startswith(prefix)}
        if rows:
            metrics[group] = {name: value for name, value in rows.items() if not name.endswith("_time_s")}
    return metrics


def expert_iteration_summary(history: Sequence[Metrics], best_round: int) -> dict[str, Any]:
    """Validation of the initial, best and last network, of the planner and of the greedy policy."""
    metrics: dict[str, Any] = {"rounds": int(history[-1]["round"]), "best_round": best_round}
    for name, row in (("initial", history[0]), ("best", history[best_round]), ("last", history[-1])):
        metrics[name] = {
            group: {key.removeprefix(f"{group}/"): value for key, value in row.items() if key.startswith(f"{group}/")}
            for group in ("validation", "greedy")
        }
    return metrics


def reinforcement_summary(history: Sequence[Metrics], best_iteration: int) -> dict[str, Any]:
    """Greedy performance of the initial, best and last network, and the number of transitions; without times."""
    evaluated = [row for row in history if "greedy/success_rate" in row]
    metrics: dict[str, Any] = {"iterations": int(history[-1]["iteration"])}
    if evaluated:
        best = next(row for row in evaluated if row["iteration"] == best_iteration)
        metrics["best_iteration"] = best_iteration
        for name, row in (("initial", evaluated[0]), ("best", best), ("last", evaluated[-1])):
            metrics[name] = {key: row[f"greedy/{key}"] for key in _REPORTED if f"greedy/{key}" in row}
    if "collection/transitions" in history[-1]:
        metrics["transitions"] = int(history[-1]["collection/transitions"])
    return metrics
