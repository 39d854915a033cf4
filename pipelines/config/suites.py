"""Suites of settings for ``evaluate``."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any


def suite_overrides(suite: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Overrides of every setting of a suite, in order: the product of the values within each block.

    A list stands for alternatives; a value that is itself a list is written as [[1, 7]].

    >>> suite_overrides({"sizes": {"planner": ["greedy"], "scene.num_objects": [[1, 7]], "seed": [0, 1]}})
    [['planner=greedy', 'scene.num_objects=[1,7]', 'seed=0'], ['planner=greedy', 'scene.num_objects=[1,7]', 'seed=1']]
    """
    points: list[list[str]] = []
    for block in suite.values():
        alternatives = [
            [f"{key}={_override_value(value)}" for value in (values if isinstance(values, list | tuple) else [values])]
            for key, values in block.items()
        ]
        points += [list(combination) for combination in itertools.product(*alternatives)]
    return points


def _override_value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{','.join(_override_value(item) for item in value)}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(value)
