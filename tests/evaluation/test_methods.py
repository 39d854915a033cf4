"""Names of methods and their order."""

import numpy as np
import pandas as pd

from visualrhp.evaluation.methods import (
    KNOWN_METHODS,
    Method,
    method_description,
    method_label,
    order_methods,
    with_labels,
)
from visualrhp.planning.decision_task import RecedingHorizonParameters


def test_labels_are_the_papers():
    assert method_label("VisualRHP", 3, 3) == "VisualRHP 3x3"
    assert method_label("VisualRHP 3x3", 3, 3) == "VisualRHP 3x3"
    assert method_label("Greedy", None, None) == "Greedy"
    assert method_label("Greedy", np.nan, np.nan) == "Greedy"


def test_known_methods_come_first():
    assert order_methods(["mine 2x5", "Greedy", "VisualRHP 3x3", "Greedy", "a"]) == [
        "VisualRHP 3x3",
        "Greedy",
        "a",
        "mine 2x5",
    ]


def test_a_deadline_names_the_method_instead_of_the_number_of_roll_outs():
    planner = RecedingHorizonParameters(num_rollouts=3, horizon=4, name="VisualRHP")
    assert Method.of(planner) == Method("VisualRHP", 3, 4)
    assert Method.of(planner).label == "VisualRHP 3x4"
    limited = RecedingHorizonParameters(num_rollouts=3, horizon=4, deadline_s=0.05, name="VisualRHP")
    assert Method.of(limited) == Method("VisualRHP in 50 ms", None, 4)
    assert Method.of(limited).label == "VisualRHP in 50 ms"
    assert Method.of(RecedingHorizonParameters(deadline_s=0.05)).label == "RHP 3x3 in 50 ms"


def test_known_planners_are_described():
    assert all(method_description(label) for label in KNOWN_METHODS)
    assert method_description("VisualRHP 6x6") == method_description("VisualRHP in 50 ms") != ""
    assert "searches again" in method_description("K.RRT closed loop")
    assert method_description("mine") == method_description("VisualRHPs") == ""


def test_tables_are_labelled_by_their_columns():
    table = pd.DataFrame({"planner": ["a", "b"], "num_rollouts": [2, None], "horizon": [3, None]}, index=[7, 9])
    assert with_labels(table)["method"].to_dict() == {7: "a 2x3", 9: "b"}
    assert "method" not in table.columns
