"""Parts of figures."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from visualrhp.errors import DataError
from visualrhp.evaluation.axes import error_line, finish_axes, not_empty, offsets, spacing


def test_offsets_are_centred():
    assert offsets(1, 0.3) == [0.0]
    assert offsets(3, 0.3) == pytest.approx([-0.15, 0.0, 0.15])


def test_spacing_is_the_smallest_distance():
    assert (spacing([7, 1, 4, 2]), spacing([3]), spacing(["small", "large"]), spacing([])) == (1, 1.0, 1.0, 1.0)
    axes = Figure().add_subplot()
    finish_axes(axes, "success_rate", [1, 5])
    assert axes.get_xlim() == (-1.0, 7.0)


def test_lines_skip_gaps_and_bars_without_bounds_have_no_length():
    line = pd.DataFrame(
        {"rate": [0.5, np.nan, 0.7], "rate_low": [0.4, np.nan, np.nan], "rate_high": [0.8, np.nan, np.nan]},
        index=pd.Index([1, 2, 4]),
    )
    axes = Figure().add_subplot()
    error_line(axes, line, "rate", 0.25, color="k")
    (container,) = axes.containers
    drawn, _, (segments,) = container
    assert drawn.get_xdata().tolist() == [1.25, 4.25]
    ends = [segment[:, 1].tolist() for segment in segments.get_segments()]
    assert ends == [pytest.approx([0.4, 0.8]), pytest.approx([0.7, 0.7])]


def test_sizes_have_their_places():
    axes = Figure().add_subplot()
    finish_axes(axes, "action_efficiency", ["small", "large"])
    assert axes.get_xticks().tolist() == [0, 2]
    assert axes.get_ylim()[0] == 0.0


def test_what_a_figure_needs_is_named():
    with pytest.raises(DataError, match="it needs objects"):
        not_empty(pd.DataFrame(), "objects")
