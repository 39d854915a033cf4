"""Times that remain, by hand."""

from __future__ import annotations

import math

from pipelines.workflow.forecast import Forecast


def test_the_remaining_time_is_that_of_the_kinds_that_remain() -> None:
    forecast = Forecast({"slow": 3, "fast": 11})
    assert math.isnan(forecast.remaining_s(5.0))
    forecast.finished("slow", 8.0)
    assert forecast.remaining_s(4.0) == 4.0 * (2 * 8.0 + 11 * 8.0) / 8.0  # a kind without a cost counts as the others
    forecast.finished("fast", 2.0)
    # 10 units in 5 s; 2 slow and 10 fast ones remain
    assert forecast.remaining_s(5.0) == 0.5 * (2 * 8.0 + 10 * 2.0)
    forecast.finished("fast", 4.0)
    assert forecast.remaining_s(7.0) == 0.5 * (2 * 8.0 + 9 * 3.0)


def test_nothing_remains_at_the_end() -> None:
    forecast = Forecast({"only": 1})
    forecast.finished("only", 3.0)
    assert forecast.remaining_s(1.0) == 0.0
