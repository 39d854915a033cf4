"""Fig. 7 to 10 from a synthetic table: what is drawn where."""

import pytest

from tests.evaluation.samples import METHODS, ablation_table
from visualrhp.errors import DataError
from visualrhp.evaluation import episode_figures as figures
from visualrhp.evaluation.metrics import wilson_interval


@pytest.fixture(scope="module")
def episodes():
    return ablation_table()


def error_bars(axes):
    """(x, y, low, high) of every error bar, in the order of drawing."""
    bars = []
    for container in axes.containers:
        line, _, (segments,) = container
        for x, y, segment in zip(line.get_xdata(), line.get_ydata(), segments.get_segments(), strict=True):
            bars.append((x, y, segment[:, 1].min(), segment[:, 1].max()))
    return bars


def test_success_by_num_objects_shows_rates_with_wilson_intervals(episodes):
    figure = figures.by_num_objects(episodes)
    continuous, discrete = figure.axes
    assert (continuous.get_title("left"), discrete.get_title("left")) == ("Continuous actions", "Discrete actions")
    bars = error_bars(continuous)
    assert len(bars) == len(METHODS) * 2  # the requested numbers of objects: 1 and 4
    rows = episodes.loc[
        (episodes["planner"] == "Greedy")
        & (episodes["action_space"] == "continuous")
        & (episodes["object_size"] == "mixed")
        & (episodes["noise_level"] == "none")
        & (episodes["num_objects"] == 4)
    ]
    expected = wilson_interval(int(rows["success"].sum()), len(rows))
    _, y, low, high = bars[2 * 2 + 1]  # the third method of the legend, second number of objects
    assert (y, low, high) == pytest.approx((expected.value, expected.low, expected.high))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["VisualRHP 6x6", "VisualRHP 3x3", "Greedy", "mine 2x5"]


def test_sizes_come_from_random_numbers_of_objects_only(episodes):
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


def test_robustness_has_a_panel_per_method_that_was_run_with_noise(episodes):
    quiet = (episodes["planner"] == "mine") & (episodes["noise_level"] != "none")
    figure = figures.robustness(episodes.loc[~quiet])
    titles = [axes.get_title("left") for axes in figure.axes if axes.get_visible()]
    assert titles == ["VisualRHP 6x6", "VisualRHP 3x3", "Greedy"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["no noise", "high noise"]
    assert len(figure.axes[0].containers) == 2


@pytest.mark.parametrize("draw", [figures.by_num_objects, figures.by_size, figures.execution_time, figures.robustness])
def test_a_figure_without_rows_is_refused(draw, episodes):
    with pytest.raises(DataError, match="no rows for this figure"):
        draw(episodes.iloc[:0])


def test_the_axis_has_all_numbers_that_occurred_where_none_was_requested(episodes):
    random = episodes.loc[episodes["scene_num_objects"] == "1-7"]
    ticks = figures.by_num_objects(random).axes[0].get_xticks().tolist()
    assert ticks == [1, 2, 3, 4, 5, 6, 7]
