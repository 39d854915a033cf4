"""K.RRT against OMPL's control::RRT on the same task instances (see the section rrt). OMPL is an optional extra."""

from __future__ import annotations

import importlib.util

from tests.benchmarks.rrt import ACTION_SPACES, NUM_OBJECTS, against_ompl, planner_for
from tests.benchmarks.timing import Effort


def run(effort: Effort) -> None:
    if importlib.util.find_spec("ompl") is None:
        print('\nOMPL is not installed: the comparison with it is skipped. Install it with pip install -e ".[ompl]"')
        return
    for space in ACTION_SPACES:
        against_ompl(space, NUM_OBJECTS, effort.instances, planner_for(effort))
