"""The three metrics of Sec. 7.3, with intervals.

They are computed from a table of episodes (:data:`visualrhp.evaluation.episodes.EPISODE_COLUMNS`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import special, stats

from visualrhp.errors import ConfigError, DataError
from visualrhp.evaluation.episodes import RESULT_COLUMNS, episode_row
from visualrhp.execution.episode import EpisodeResult

CONFIDENCE = 0.9
"""The paper reports 90% confidence intervals (Sec. 7.4)."""

NUM_RESAMPLES = 999
"""Of a bootstrap interval."""

_MOST_DRAWN = 1 << 20
"""Numbers of a bootstrap in memory at a time."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value estimated from ``count`` samples, between the bounds of its confidence interval.

    Without samples all three numbers are NaN; so are the bounds of a mean of a single sample.
    """

    value: float
    low: float
    high: float
    count: int


def wilson_interval(num_successes: int, num_trials: int, confidence: float = CONFIDENCE) -> Estimate:
    """A rate with its Wilson score interval, which stays within [0, 1] and is accurate near both ends.

    With p = successes / trials and z the normal quantile of (1 + confidence) / 2, the bounds solve
    (p - q)^2 = z^2 q (1 - q) / trials for q.

    Raises:
        ConfigError: ``num_successes`` is not in [0, ``num_trials``], or ``confidence`` not in (0, 1).
    """
    _check_confidence(confidence)
    if not 0 <= num_successes <= num_trials:
        raise ConfigError(f"{num_successes} successes of {num_trials} trials: successes range from 0 to the trials")
    if num_trials == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    z = float(special.ndtri(0.5 + confidence / 2.0))
    rate = num_successes / num_trials
    scale = 1.0 + z**2 / num_trials
    centre = (rate + z**2 / (2.0 * num_trials)) / scale
    half = z / scale * math.sqrt(rate * (1.0 - rate) / num_trials + (z / (2.0 * num_trials)) ** 2)
    low = 0.0 if num_successes == 0 else centre - half  # exact, where rounding would leave 1e-17
    high = 1.0 if num_successes == num_trials else centre + half
    return Estimate(rate, low, high, num_trials)


def mean_interval(values: npt.ArrayLike, confidence: float = CONFIDENCE) -> Estimate:
    """A mean of few values, such as trials of a training, with Student's t interval; NaN values are ignored.

    Raises:
        ConfigError: ``confidence`` is not in (0, 1).
    """
    _check_confidence(confidence)
    samples = _without_nan(values)
    count, mean = len(samples), _mean(samples)
    if count < 2:
        return Estimate(mean, math.nan, math.nan, count)
    half = float(special.stdtrit(count - 1, 0.5 + confidence / 2.0) * samples.std(ddof=1) / math.sqrt(count))
    return Estimate(mean, mean - half, mean + half, count)


def bootstrap_interval(values: npt.ArrayLike, confidence: float = CONFIDENCE) -> Estimate:
    """A mean of episodes with its bootstrap interval (percentiles of ``NUM_RESAMPLES`` means, always the same ones).

    Efficiencies, times and numbers of actions have skewed distributions. NaN values are ignored: an efficiency exists
    only for completed tasks.

    Raises:
        ConfigError: ``confidence`` is not in (0, 1).
    """
    _check_confidence(confidence)
    samples = _without_nan(values)
    count, mean = len(samples), _mean(samples)
    if count < 2:
        return Estimate(mean, math.nan, math.nan, count)
    if np.ptp(samples) == 0.0:
        return Estimate(mean, mean, mean, count)
    # Of both signs, so that an exchange of two methods changes the sign of their difference, and nothing else.
    (low, high), (low_of_negative, high_of_negative) = (
        _percentiles(sign * samples, confidence) for sign in (1.0, -1.0)
    )
    return Estimate(mean, (low - high_of_negative) / 2.0, (high - low_of_negative) / 2.0, count)


def _percentiles(samples: npt.NDArray[np.float64], confidence: float) -> tuple[float, float]:
    """The bounds of the means of resamples."""
    found = stats.bootstrap(
        (np.sort(samples),),  # the order of rows does not matter
        np.mean,
        n_resamples=NUM_RESAMPLES,
        batch=max(1, _MOST_DRAWN // len(samples)),
        confidence_level=confidence,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)


def _without_nan(values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    samples = np.asarray(values, dtype=np.float64).ravel()
    return samples[~np.isnan(samples)]


def _mean(samples: npt.NDArray[np.float64]) -> float:
    return float(samples.mean()) if len(samples) else math.nan


def evaluation_metrics(episodes: pd.DataFrame, confidence: float = CONFIDENCE) -> dict[str, Estimate]:
    """The metrics of Sec. 7.3 over all rows of a table of episodes, and two that explain them.

    - ``success_rate``: completed in under 50 actions and nothing dropped. Wilson interval.
    - ``action_efficiency``: objects in the scene / actions until completion, mean over the completed tasks.
    - ``execution_time_s``: number of actions times the time to select one, plus the time to execute them in the
      simulator; mean over all tasks.
    - ``drop_rate``: an object fell off the surface. Wilson interval.
    - ``num_actions``: mean over all tasks.
    """
    return {
        "success_rate": wilson_interval(int(np.count_nonzero(episodes["success"])), len(episodes), confidence),
        "action_efficiency": bootstrap_interval(episodes["action_efficiency"], confidence),
        "execution_time_s": bootstrap_interval(episodes["decision_time_s"] + episodes["simulation_time_s"], confidence),
        "drop_rate": wilson_interval(int(np.count_nonzero(episodes["dropped"])), len(episodes), confidence),
        "num_actions": bootstrap_interval(episodes["num_actions"], confidence),
    }


def metrics_of_results(results: Iterable[EpisodeResult], confidence: float = CONFIDENCE) -> dict[str, Estimate]:
    """:func:`evaluation_metrics` of episodes that were just run."""
    rows = [episode_row(result) for result in results]
    return evaluation_metrics(pd.DataFrame(rows, columns=list(RESULT_COLUMNS)), confidence)


def summarize(episodes: pd.DataFrame, by: Sequence[str], confidence: float = CONFIDENCE) -> pd.DataFrame:
    """A table with one row per group of episodes that have the same values in the columns ``by``, sorted by them.

    Its columns are ``by``, ``episodes`` (their number), and for each metric of :func:`evaluation_metrics` the value
    and, with the suffixes ``_low`` and ``_high``, the bounds of its interval. A missing value in ``by`` (the horizon of
    a planner that has none) is a separate group; groups without episodes do not appear; without columns in ``by``, one
    row summarizes all episodes.

    Raises:
        DataError: a column of ``by``, or one that the metrics are computed from, is missing.
    """
    missing = [name for name in (*by, *_METRIC_COLUMNS) if name not in episodes.columns]
    if missing:
        raise DataError(
            f"the table of episodes has no column {', '.join(missing)}; it has {', '.join(episodes.columns)}"
        )
    if by:
        groups: Any = episodes.groupby(list(by), dropna=False, observed=True, sort=True)
        rows = [_summary_row(dict(zip(by, key, strict=True)), group, confidence) for key, group in groups]
    else:
        rows = [_summary_row({}, episodes, confidence)]
    columns = list(_summary_row(dict.fromkeys(by), episodes.iloc[:0], confidence))
    return pd.DataFrame(rows, columns=columns)


_METRIC_COLUMNS = ("success", "dropped", "num_actions", "action_efficiency", "decision_time_s", "simulation_time_s")


def _summary_row(key: Mapping[str, Any], episodes: pd.DataFrame, confidence: float) -> dict[str, Any]:
    row: dict[str, Any] = {**key, "episodes": len(episodes)}
    for name, estimate in evaluation_metrics(episodes, confidence).items():
        row |= {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
    return row


def _check_confidence(confidence: float) -> None:
    if not 0.0 < confidence < 1.0:
        raise ConfigError(f"confidence={confidence}: the probability of an interval must be between 0 and 1")
