"""Names of the compared methods, and their order in tables and legends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import pandas as pd

METHOD: Final = ("planner", "num_rollouts", "horizon")
"""Columns of an episodes table that together name a method."""

KNOWN_METHODS: Final = (
    "VisualRHP+ 3x3",
    "VisualRHP 6x6",
    "VisualRHP 3x3",
    "CartesianRHP+ 3x3",
    "CartesianRHP 3x3",
    "CraftedHeuristicRHP+ 8x4",
    "CraftedHeuristicRHP 8x4",
    "Greedy",
    "K.RRT",
    "K.RRT closed loop",
    "dhRRT",
)
"""Labels of the paper's methods and of the further baselines, in the order of legends and tables."""

_DESCRIPTIONS: Final = {
    "VisualRHP": "Receding horizon planning (Algorithm 1): simulates roll-outs of a network's policy, which reads an "
    "image, takes the first action of the best one, and observes again.",
    "VisualRHP+": "VisualRHP with options of the planner beyond Algorithm 1.",
    "CartesianRHP": "VisualRHP with networks that read the poses of a fixed number of objects instead of an image.",
    "CartesianRHP+": "CartesianRHP with the options of VisualRHP+.",
    "CraftedHeuristicRHP": "VisualRHP with a handcrafted formula and random roll-outs in place of the network.",
    "CraftedHeuristicRHP+": "CraftedHeuristicRHP with the options of VisualRHP+.",
    "Greedy": "The policy of VisualRHP's network alone, without looking ahead.",
    "K.RRT": "Kinodynamic RRT: searches for a plan once and follows it without looking again (open loop).",
    "K.RRT closed loop": "K.RRT that searches again in every state that its plan did not predict.",
    "dhRRT": "K.RRT that searches again whenever the object has come a part of the way; after Ren et al., 2022.",
}

ACTION_SPACES: Final = ("continuous", "discrete")
SIZES: Final = ("small", "mixed", "large")
NOISE_ORDER: Final = ("none", "low", "medium", "high")


@dataclass(frozen=True, slots=True)
class Method:
    """A planner with its number and depth of roll-outs: the unit of comparison.

    Attributes:
        planner: its name, with the deadline if it has one.
        num_rollouts: n; None without roll-outs, and with a deadline, where the number that fits depends on the machine.
        horizon: h; None without roll-outs.
    """

    planner: str
    num_rollouts: int | None = None
    horizon: int | None = None

    @classmethod
    def of(cls, planner: Any) -> Method:
        """The method of a planner or of its parameters: ``name``, and where they exist, those of receding horizons."""
        deadline_s = getattr(planner, "deadline_s", None)
        name = planner.name + (f" in {1e3 * deadline_s:g} ms" if deadline_s is not None else "")
        num_rollouts = getattr(planner, "num_rollouts", None) if deadline_s is None else None
        return cls(name, num_rollouts, getattr(planner, "horizon", None))

    @property
    def label(self) -> str:
        """See :func:`method_label`."""
        return method_label(self.planner, self.num_rollouts, self.horizon)


def method_label(planner: str, num_rollouts: float | None = None, horizon: float | None = None) -> str:
    """A method's name as the paper writes it: the planner, then n x h if it rolls out ("VisualRHP 3x3").

    A planner whose name ends in its n x h already keeps its name; None, NaN and 0 mean no roll-outs.
    """
    if not _is_count(num_rollouts) or not _is_count(horizon):
        return planner
    suffix = f"{int(num_rollouts or 0)}x{int(horizon or 0)}"
    return planner if planner.endswith(suffix) else f"{planner} {suffix}"


def method_description(planner: str) -> str:
    """What a planner of this name does, in a sentence; empty for one that is not known.

    Args:
        planner: name, also one with n x h ("VisualRHP 6x6") or a deadline ("VisualRHP in 50 ms").
    """
    fitting = [name for name in _DESCRIPTIONS if planner == name or planner.startswith(f"{name} ")]
    return _DESCRIPTIONS[max(fitting, key=len)] if fitting else ""


def with_labels(table: pd.DataFrame) -> pd.DataFrame:
    """A copy of an episodes or summary table with the column ``method`` (see :func:`method_label`)."""
    labels = [method_label(*key) for key in table[list(METHOD)].itertuples(index=False)]
    return table.assign(method=pd.Series(labels, index=table.index, dtype="object"))


def order_methods(labels: Sequence[str]) -> list[str]:
    """The distinct ``labels`` in the order of legends and tables: known methods first, then the others by name."""
    known = list(KNOWN_METHODS)
    return sorted(set(labels), key=lambda label: (known.index(label) if label in known else len(known), label))


def _is_count(number: float | None) -> bool:
    return number is not None and not pd.isna(number) and number > 0
