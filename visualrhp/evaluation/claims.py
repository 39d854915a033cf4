"""The ordinal claims of the paper (Sec. 8 and 10), as comparisons of cells of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import pandas as pd

from visualrhp.evaluation.methods import ACTION_SPACES

Metric = Literal["success", "efficiency", "time"]


@dataclass(frozen=True, slots=True)
class Cell:
    """Episodes of one method in one setting; the defaults are those of the main comparison."""

    method: str
    action_space: str = "continuous"
    objects: str = "1-7"
    size: str = "mixed"
    noise: str = "none"

    def rows(self, labelled: pd.DataFrame) -> pd.DataFrame:
        """Those of a table with the column ``method``, indexed by task instance."""
        chosen = {
            "method": self.method,
            "action_space": self.action_space,
            "scene_num_objects": self.objects,
            "object_size": self.size,
            "noise_level": self.noise,
            "layout": "uniform",
        }
        found = labelled.loc[np.logical_and.reduce([labelled[name] == value for name, value in chosen.items()])]
        return found.drop_duplicates(["seed", "episode"]).set_index(["seed", "episode"])


@dataclass(frozen=True, slots=True)
class Comparison:
    """A statement about two cells, or about one.

    Attributes:
        one: a cell.
        other: that it is compared with; None to claim that its success rate is high.
        relation: what is claimed: ``one`` is more than ``other``, less, or much the same.
        metric: which is compared.
        minus: two more cells, of which the difference is subtracted, for claims such as "A loses less than B".
    """

    one: Cell
    other: Cell | None
    relation: Literal["more", "less", "same"] = "more"
    metric: Metric = "success"
    minus: tuple[Cell, Cell] | None = None


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim of the paper.

    Attributes:
        words: what it says.
        place: section or figure.
        comparisons: that it consists of; none if episodes cannot decide it.
        remark: for readers of the table.
    """

    words: str
    place: str
    comparisons: tuple[Comparison, ...]
    remark: str = ""


# ---------------------------------------------------------------------------------------------------------- the claims
_OURS, _DEEP, _CARTESIAN, _CRAFTED = "VisualRHP 3x3", "VisualRHP 6x6", "CartesianRHP 3x3", "CraftedHeuristicRHP 8x4"
_GREEDY, _RRT, _AGAIN = "Greedy", "K.RRT", "K.RRT closed loop"
_CLOSED_LOOP = (_OURS, _DEEP, _CARTESIAN, _CRAFTED, _GREEDY)


def _each(
    ones: Sequence[str], others: Sequence[str], spaces: Sequence[str] = ACTION_SPACES, **words: Any
) -> tuple[Comparison, ...]:
    """Every method of ``ones`` against every one of ``others``, in every action space."""
    relation, metric = words.pop("relation", "more"), words.pop("metric", "success")
    return tuple(
        Comparison(Cell(one, space, **words), Cell(other, space, **words), relation, metric)
        for space in spaces
        for one in ones
        for other in others
    )


CLAIMS: Final = (
    Claim(
        "VisualRHP and CartesianRHP succeed more often than CraftedHeuristicRHP and Greedy",
        "Sec. 8.1, Fig. 7",
        _each((_OURS, _CARTESIAN), (_CRAFTED, _GREEDY)),
    ),
    Claim(
        "More and deeper roll-outs have a slight advantage in success", "Sec. 8.1, Fig. 7", _each((_DEEP,), (_OURS,))
    ),
    Claim(
        "With one object, all approaches have a high success rate",
        "Sec. 8.1, Fig. 7a",
        tuple(
            Comparison(Cell(name, space, objects="1"), None)
            for space in ACTION_SPACES
            for name in (*_CLOSED_LOOP, _RRT)
        ),
    ),
    Claim(
        "More objects lower the success of every closed-loop method",
        "Sec. 8.1, Fig. 7a",
        tuple(
            Comparison(Cell(name, space, objects="7"), Cell(name, space, objects="1"), "less")
            for space in ACTION_SPACES
            for name in _CLOSED_LOOP
        ),
    ),
    Claim(
        "Greedy loses most by more objects",
        "Sec. 8.1, Fig. 7a",
        tuple(
            Comparison(
                Cell(_GREEDY, space, objects="7"),
                Cell(_GREEDY, space, objects="1"),
                "less",
                minus=(Cell(name, space, objects="7"), Cell(name, space, objects="1")),
            )
            for space in ACTION_SPACES
            for name in (_OURS, _DEEP, _CARTESIAN, _CRAFTED)
        ),
    ),
    Claim(
        "Large objects are harder than small ones",
        "Sec. 8.1, Fig. 7b",
        tuple(
            Comparison(Cell(name, space, size="large"), Cell(name, space, size="small"), "less")
            for space in ACTION_SPACES
            for name in _CLOSED_LOOP
        ),
    ),
    Claim(
        "Receding horizon planning loses less by large objects than Greedy",
        "Sec. 8.1, Fig. 7b",
        tuple(
            Comparison(
                Cell(name, space, size="large"),
                Cell(name, space, size="small"),
                "more",
                minus=(Cell(_GREEDY, space, size="large"), Cell(_GREEDY, space, size="small")),
            )
            for space in ACTION_SPACES
            for name in (_OURS, _DEEP)
        ),
    ),
    Claim(
        "Continuous or discrete actions have no significant effect on success",
        "Sec. 8.1, Fig. 7",
        tuple(Comparison(Cell(name), Cell(name, "discrete"), "same") for name in _CLOSED_LOOP),
    ),
    Claim(
        "Continuous actions are more efficient",
        "Sec. 8.1, Fig. 8",
        tuple(Comparison(Cell(name), Cell(name, "discrete"), "more", "efficiency") for name in _CLOSED_LOOP),
    ),
    Claim(
        "More and deeper roll-outs have no noticeable advantage in efficiency over fewer, or over none",
        "Sec. 8.1, Fig. 8",
        _each((_DEEP,), (_OURS, _GREEDY), relation="same", metric="efficiency"),
    ),
    Claim("CartesianRHP succeeds as often as VisualRHP", "Sec. 8.1", _each((_CARTESIAN,), (_OURS,), relation="same")),
    Claim(
        "CartesianRHP is less efficient than all that read images",
        "Sec. 8.1, Fig. 8",
        _each((_CARTESIAN,), (_OURS, _DEEP, _GREEDY), relation="less", metric="efficiency"),
    ),
    Claim(
        "Runs take less time with continuous actions",
        "Sec. 8.1, Fig. 9",
        tuple(Comparison(Cell(name), Cell(name, "discrete"), "less", "time") for name in (*_CLOSED_LOOP, _RRT)),
    ),
    Claim(
        "VisualRHP 6x6 and CraftedHeuristicRHP 8x4 take the longest, Greedy the shortest, K.RRT between them",
        "Sec. 8.1, Fig. 9",
        (
            *_each((_DEEP, _CRAFTED), (_OURS, _CARTESIAN, _RRT), metric="time"),
            *_each((_GREEDY,), (_OURS, _CARTESIAN, _RRT), relation="less", metric="time"),
        ),
        "Of times on our machine and with our simulator.",
    ),
    Claim(
        "K.RRT has a high success rate without noise",
        "Sec. 8.2, Fig. 10",
        (Comparison(Cell(_RRT), None),),
    ),
    Claim(
        "Noise lowers the success of K.RRT",
        "Sec. 8.2, Fig. 10",
        (Comparison(Cell(_RRT, objects="7", noise="high"), Cell(_RRT, objects="7"), "less"),),
    ),
    Claim(
        "Greedy copes with high noise when there is one object",
        "Sec. 8.2, Fig. 10",
        (Comparison(Cell(_GREEDY, objects="1", noise="high"), None),),
    ),
    Claim(
        "Greedy fails in high clutter with high noise, compared with VisualRHP",
        "Sec. 8.2, Fig. 10",
        (Comparison(Cell(_GREEDY, objects="7", noise="high"), Cell(_OURS, objects="7", noise="high"), "less"),),
    ),
    Claim(
        "With high noise, CartesianRHP succeeds more often than VisualRHP",
        "Sec. 8.2, Fig. 10",
        (Comparison(Cell(_CARTESIAN, objects="7", noise="high"), Cell(_OURS, objects="7", noise="high")),),
    ),
    Claim(
        "A learned heuristic succeeds more often than a handcrafted one, and than open-loop execution",
        "Sec. 10",
        _each((_OURS,), (_CRAFTED, _RRT), objects="7", noise="high"),
        "At high noise, where open-loop execution is to fail.",
    ),
    Claim(
        "A learned heuristic is more efficient than a handcrafted one, and than open-loop execution",
        "Sec. 10",
        _each((_OURS,), (_CRAFTED, _RRT), metric="efficiency"),
    ),
    Claim(
        "Look-ahead with a learned heuristic beats searching again in every state",
        "Sec. 8.2 (K.RRT's time limits re-planning in real time)",
        _each((_OURS,), (_AGAIN,)),
        "The paper could not search again in every state, since its simulator took seconds; ours takes milliseconds.",
    ),
    Claim(
        "VisualRHP+ beats searching again in every state, with high noise",
        "not in the paper",
        _each(("VisualRHP+ 3x3",), (_AGAIN,), objects="7", noise="high"),
    ),
)
