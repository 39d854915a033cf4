"""Fig. 5 and 6, and training curves, from small tables."""

import numpy as np
import pandas as pd
import pytest

from visualrhp.errors import DataError
from visualrhp.evaluation import training_figures as figures


def test_sweep_and_stability_average_batches_and_trials():
    batches = pd.DataFrame(
        {"action_space": "continuous", "num_demonstrations": [10, 10, 20, 20], "success_rate": [0.2, 0.4, 0.5, 0.7]}
    )
    axes = figures.demonstrations_sweep(batches).axes[0]
    assert (axes.containers[0][0].get_xdata().tolist(), axes.containers[0][0].get_ydata().tolist()) == (
        [10, 20],
        pytest.approx([0.3, 0.6]),
    )
    trials = pd.DataFrame(
        {
            "algorithm": ["C3PO"] * 4 + ["PPO"] * 4,
            "transitions": [0, 0, 100, 100] * 2,
            "success_rate": [0.5, 0.7, 0.8, 0.8, 0.5, 0.5, 0.1, 0.3],
        }
    )
    lines = figures.learning_stability(trials).axes[0].lines
    assert [line.get_label() for line in lines] == ["C3PO", "PPO"]
    np.testing.assert_allclose([np.asarray(line.get_ydata()) for line in lines], [[0.6, 0.8], [0.5, 0.2]])


def test_training_curves_have_a_panel_per_column_that_exists():
    histories = {
        "one": pd.DataFrame({"step": [0, 1], "loss": [2.0, 1.0], "success": [np.nan, 0.5]}),
        "two": pd.DataFrame({"step": [0, 1], "loss": [3.0, 2.0]}),
    }
    figure = figures.training_curves(
        histories, "step", {"loss": "Loss", "success": "Success rate", "absent": "Absent"}, "iteration"
    )
    visible = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title("left") for axes in visible] == ["Loss", "Success rate"]
    assert [len(axes.lines) for axes in visible] == [2, 1]


def test_tables_without_anything_to_draw_are_refused():
    with pytest.raises(DataError, match="no rows for this figure"):
        figures.demonstrations_sweep(pd.DataFrame({"action_space": []}))
    with pytest.raises(DataError, match="no rows for this figure"):
        figures.learning_stability(pd.DataFrame({"algorithm": []}))
    with pytest.raises(DataError, match="none of the training histories"):
        figures.training_curves({"one": pd.DataFrame({"step": [0]})}, "step", {"loss": "Loss"}, "iteration")
