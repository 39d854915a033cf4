import itertools

import numpy as np
import pandas as pd
import pytest

from visualrhp.errors import DataError
from visualrhp.evaluation import figures
from visualrhp.evaluation.metrics import wilson_interval

METHODS = [("VisualRHP", 3, 3), ("VisualRHP", 6, 6), ("Greedy", None, None), ("mine", 2, 5)]


def episodes_table():
    """Ten episodes a cell; the number of successes tells the cell."""
    rows = []
    cells = itertools.product(METHODS, ("continuous", "discrete"), ("small", "mixed", "large"), ("1", "4", "1-7"))
    for number, ((planner, n, h), space, size, requested) in enumerate(cells):
        for level in ("none", "high") if size == "mixed" and space == "continuous" else ("none",):
            for episode in range(10):
                success = episode < number % 11
                objects = 1 + episode % 7 if requested == "1-7" else int(requested)
                rows.append(
                    {
                        "planner": planner,
                        "num_rollouts": n,
                        "horizon": h,
                        "action_space": space,
                        "object_size": size,
                        "noise_level": level,
                        "scene_num_objects": requested,
                        "num_objects": objects,
                        "episode": episode,
                        "success": success,
                        "dropped": not success,
                        "num_actions": 10,
                        "action_efficiency": objects / 10 if success else np.nan,
                        "decision_time_s": 0.1 * (episode + 1),
                        "simulation_time_s": 0.01,
                    }
                )
    return pd.DataFrame(rows)


@pytest.fixture(scope="module")
def episodes():
    return episodes_table()


def error_bars(axes):
    """(x, y, low, high) of every error bar drawn, in the order of drawing."""
    bars = []
    for container in axes.containers:
        line, _, (segments,) = container
        for x, y, segment in zip(line.get_xdata(), line.get_ydata(), segments.get_segments(), strict=True):
            bars.append((x, y, segment[:, 1].min(), segment[:, 1].max()))
    return bars


def test_labels_are_the_papers():
    assert figures.method_label("VisualRHP", 3, 3) == "VisualRHP 3x3"
    assert figures.method_label("VisualRHP 3x3", 3, 3) == "VisualRHP 3x3"
    assert figures.method_label("Greedy", None, None) == "Greedy"
    assert figures.method_label("Greedy", np.nan, np.nan) == "Greedy"
    assert figures.order_methods(["mine 2x5", "Greedy", "VisualRHP 3x3", "Greedy"]) == [
        "VisualRHP 3x3",
        "Greedy",
        "mine 2x5",
    ]


def test_every_method_has_its_own_look():
    labels = ["a", "b", "VisualRHP 3x3", "VisualRHP 6x6", "CartesianRHP 3x3", "Greedy", "K.RRT"]
    assert len({figures.method_style(label, labels) for label in labels}) == len(labels)


def test_success_by_density_shows_rates_with_wilson_intervals(episodes):
    figure = figures.by_density(episodes)
    continuous, discrete = figure.axes
    assert (continuous.get_title("left"), discrete.get_title("left")) == ("Continuous actions", "Discrete actions")
    bars = error_bars(continuous)
    assert len(bars) == len(METHODS) * 2  # the densities asked for: 1 and 4
    rows = episodes.loc[
        (episodes["planner"] == "Greedy")
        & (episodes["action_space"] == "continuous")
        & (episodes["object_size"] == "mixed")
        & (episodes["noise_level"] == "none")
        & (episodes["num_objects"] == 4)
    ]
    expected = wilson_interval(int(rows["success"].sum()), len(rows))
    _, y, low, high = bars[2 * 2 + 1]  # third method in the legend's order, second density
    assert (y, low, high) == pytest.approx((expected.value, expected.low, expected.high))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["VisualRHP 6x6", "VisualRHP 3x3", "Greedy", "mine 2x5"]


def test_sizes_come_from_random_densities_only(episodes):
    figure = figures.by_size(episodes)
    axes = figure.axes[0]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["small", "mixed", "large"]
    bars = error_bars(axes)
    rows = episodes.loc[
        (episodes["planner"] == "VisualRHP")
        & (episodes["horizon"] == 6)
        & (episodes["action_space"] == "continuous")
        & (episodes["scene_num_objects"] == "1-7")
        & (episodes["noise_level"] == "none")
    ]
    expected = rows.groupby("object_size")["success"].mean()
    assert [bar[1] for bar in bars[:3]] == pytest.approx([expected[size] for size in ("small", "mixed", "large")])


def test_execution_times_are_drawn_per_method_and_action_space(episodes):
    axes = figures.execution_time(episodes).axes[0]
    assert [tick.get_text() for tick in axes.get_yticklabels()] == [
        "VisualRHP 6x6",
        "VisualRHP 3x3",
        "Greedy",
        "mine 2x5",
    ]
    values = [container[0].get_xdata()[0] for container in axes.containers]
    assert values == pytest.approx([0.56] * 8)
    assert axes.get_xscale() == "log"


def test_robustness_has_a_panel_per_method_that_met_noise(episodes):
    quiet = (episodes["planner"] == "mine") & (episodes["noise_level"] != "none")
    figure = figures.robustness(episodes.loc[~quiet])
    titles = [axes.get_title("left") for axes in figure.axes if axes.get_visible()]
    assert titles == ["VisualRHP 6x6", "VisualRHP 3x3", "Greedy"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["no noise", "high noise"]
    assert len(figure.axes[0].containers) == 2


def test_sweep_and_stability_average_batches_and_trials():
    batches = pd.DataFrame(
        {"action_space": "continuous", "num_demonstrations": [10, 10, 20, 20], "success_rate": [0.2, 0.4, 0.5, 0.7]}
    )
    axes = figures.demonstrations_sweep(batches).axes[0]
    assert [bar[:2] for bar in error_bars(axes)] == [(10, pytest.approx(0.3)), (20, pytest.approx(0.6))]
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
    figure = figures.training_curves(histories, "step", ["loss", "success", "absent"], "iteration")
    visible = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title("left") for axes in visible] == ["loss", "success"]
    assert [len(axes.lines) for axes in visible] == [2, 1]


def test_svg_for_a_page_is_self_contained_and_reproducible(episodes):
    svg = figures.to_svg(figures.by_density(episodes))
    assert svg.startswith("<svg") and svg.endswith("</svg>")
    assert "http" not in svg
    assert "currentColor" in svg and 'id="axes' not in svg
    assert svg == figures.to_svg(figures.by_density(episodes))


def test_files_are_reproducible(episodes, tmp_path):
    for name in ("a.svg", "b.svg", "a.png", "b.png"):
        figures.save(figures.by_size(episodes, "action_efficiency"), tmp_path / name)
    for suffix in ("svg", "png"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


@pytest.mark.parametrize("draw", [figures.by_density, figures.by_size, figures.execution_time, figures.robustness])
def test_a_figure_without_rows_is_refused(draw, episodes):
    with pytest.raises(DataError, match="no rows for this figure"):
        draw(episodes.iloc[:0])
