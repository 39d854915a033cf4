"""A search for the weights of the handcrafted heuristic with Optuna (Sec. 7.5).

Three steps on disjoint task instances:

1. search: a tree-structured Parzen estimator proposes weights, and every trial runs the planner on the same instances,
   block by block; a trial below the median of the finished ones is pruned. The first trial has the weights to start
   from.
2. selection: the best trials and the first are compared on other instances; the best of them is the result.
3. check: the result and the first weights on further instances, without any choice.

The records are a function of the parameters and the seed: a proposal depends on the finished trials before it and on a
separate random stream, and the episodes of a block, which may run in parallel, are summed in their order.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import ConfigDict

from visualrhp.evaluation.behaviour import push_angles
from visualrhp.evaluation.journal import Journal
from visualrhp.execution.episode import EpisodeResult
from visualrhp.heuristics.crafted import CostToGo
from visualrhp.parameters import AsTuple, Count, NonNegative, Positive, parameters, suggestion
from visualrhp.simulation.rules import MAX_EPISODE_ACTIONS
from visualrhp.streams import search_seed
from visualrhp.types import ActionSpaceName

if TYPE_CHECKING:
    import optuna

Weights = dict[str, float]

_DIGITS = 3
"""Significant digits of a weight: the noise of the objective does not support more."""


# ---------------------------------------------------------------------------------------------------------- parameters
@parameters
class SearchConfig:
    """The search.

    Attributes:
        num_trials: sets of weights that are tried, the first of them the initial ones.
        num_random_trials: number of trials drawn at random, before the sampler proposes weights.
        num_instances: task instances of a trial, per action space.
        block: instances between two evaluations of the pruner.
        action_cost: cost of an episode's actions, as a share of a success; that of a full episode.
        ranges: smallest and largest value of every weight that is searched.
    """

    num_trials: Count
    num_random_trials: Count
    num_instances: Count
    block: Count
    action_cost: NonNegative
    ranges: dict[str, Annotated[tuple[Positive, Positive], AsTuple]]

    def __post_init__(self) -> None:
        weights = [entry.name for entry in fields(CostToGo)]
        if not self.ranges:
            raise ValueError("ranges is empty: no weight would be searched.")
        for name, (low, high) in self.ranges.items():
            if name not in weights:
                raise ValueError(f"ranges.{name} is not a weight. {suggestion(name, weights)}")
            if not low < high:
                raise ValueError(f"ranges.{name}=[{low:g}, {high:g}]: the smaller bound comes first.")


@parameters
class SelectionConfig:
    """Attributes: the ``num_finalists`` best trials, and the first, are compared on ``num_instances`` others."""

    num_finalists: Count
    num_instances: Count


@parameters
class CheckConfig:
    """Attributes: the best and the first weights are compared on ``num_instances`` further task instances."""

    num_instances: Count


# ------------------------------------------------------------------------------------------------------------ episodes
@dataclass(frozen=True)
class TrialTask:
    """One episode of a trial to run.

    Attributes:
        weights: those that are searched.
        action_space: name.
        index: of the task instance.
    """

    weights: Weights
    action_space: ActionSpaceName
    index: int

    @property
    def key(self) -> str:
        """Text that is equal for equal episodes of a search."""
        return json.dumps([self.weights, self.action_space, self.index], sort_keys=True)


@dataclass(frozen=True)
class TrialEpisode:
    """Result of an episode of a trial.

    Attributes:
        success, dropped, num_actions: see :class:`visualrhp.execution.episode.EpisodeResult`.
        push_angles: see :func:`visualrhp.evaluation.behaviour.push_angles`, to four digits [rad].
    """

    __pydantic_config__ = ConfigDict(strict=True, extra="forbid")  # where it is the schema of a journal

    success: bool
    dropped: bool
    num_actions: int
    push_angles: tuple[float, ...]

    @classmethod
    def of(cls, result: EpisodeResult) -> TrialEpisode:
        """The recorded part of the result of an episode."""
        angles = push_angles(result.scene, result.episode.states)
        return cls(
            result.success, result.dropped, result.num_actions, tuple(round(float(angle), 4) for angle in angles)
        )

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> TrialEpisode:
        """The inverse of ``dataclasses.asdict``."""
        return cls(**{**content, "push_angles": tuple(content["push_angles"])})


RunEpisodes = Callable[[Sequence[TrialTask]], Sequence[TrialEpisode]]
"""Runs episodes and returns their results in the order of the tasks."""

RunUnordered = Callable[[Sequence[TrialTask]], Iterable[tuple[TrialTask, TrialEpisode]]]
"""Runs episodes, in parallel perhaps, and yields each task with its result, in any order."""


def run_once(run: RunUnordered, journal: Journal) -> RunEpisodes:
    """Run each episode once: finished ones are read from ``journal``, the others are run and recorded there.

    Args:
        run: runs the episodes that are missing.
        journal: of this search alone, with the schema :class:`TrialEpisode`.
    """

    def run_episodes(tasks: Sequence[TrialTask]) -> list[TrialEpisode]:
        missing = [task for task in tasks if task.key not in journal]
        for task, episode in run(missing) if missing else ():
            journal.append(task.key, asdict(episode))
        return [TrialEpisode.from_json(journal[task.key]) for task in tasks]

    return run_episodes


def objective(episodes: Sequence[TrialEpisode], action_cost: float) -> float:
    """Mean of [success] - ``action_cost`` * actions / 49, where a failure counts 49 actions."""
    scores = [
        1.0 - action_cost * episode.num_actions / MAX_EPISODE_ACTIONS if episode.success else -action_cost
        for episode in episodes
    ]
    return math.fsum(scores) / len(scores)


# -------------------------------------------------------------------------------------------------------------- search
@dataclass(frozen=True)
class TrialRecord:
    """A finished trial of one of the three steps.

    Attributes:
        step: ``search``, ``selection`` or ``check``.
        trial: number of the trial in the search that the weights are from.
        weights: those that are searched.
        curve: objective by number of instances per action space.
        episodes: by action space, in the order of the instances.
        is_pruned: whether it was stopped early.
    """

    step: str
    trial: int
    weights: Weights
    curve: dict[int, float]
    episodes: dict[str, list[TrialEpisode]]
    is_pruned: bool

    @property
    def objective(self) -> float:
        """Over all instances that were run."""
        return self.curve[self.num_instances]

    @property
    def num_instances(self) -> int:
        """Task instances that were run in each action space."""
        return max(self.curve)


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes:
        searched, selected, checked: records of the three steps.
        best: the record of the best weights in ``searched``.
        weights: the best weights, those included that were not searched.
    """

    searched: Sequence[TrialRecord]
    selected: Sequence[TrialRecord]
    checked: Sequence[TrialRecord]
    best: TrialRecord
    weights: Weights

    @property
    def records(self) -> list[TrialRecord]:
        """Those of all steps."""
        return [*self.searched, *self.selected, *self.checked]

    @property
    def start_check(self) -> TrialRecord:
        """The check of the first weights."""
        return self.checked[0]

    @property
    def best_check(self) -> TrialRecord:
        """The check of the best weights; that of the first if nothing better was found."""
        return self.checked[-1]


@dataclass(frozen=True)
class WeightSearch:
    """The search (see the module).

    Attributes:
        start: the first trial's weights; a weight without a range keeps its value.
        action_spaces: in which every trial runs; the weights are one set for all of them.
        seed: of the proposals.
        search, selection, check: parameters of the steps.
        run: runs the episodes.
    """

    start: CostToGo
    action_spaces: Sequence[ActionSpaceName]
    seed: int
    search: SearchConfig
    selection: SelectionConfig
    check: CheckConfig
    run: RunEpisodes

    def trials(self) -> Iterator[TrialRecord]:
        """Step 1: try weights, one set after another."""
        records: list[TrialRecord] = []
        for number in range(self.search.num_trials):
            trial, weights = self.propose(records)
            records.append(self._run_trial("search", number, weights, range(self.search.num_instances), trial))
            yield records[-1]

    def select(self, searched: Sequence[TrialRecord]) -> tuple[list[TrialRecord], TrialRecord]:
        """Step 2: compare the best trials and the first on other instances.

        The first trial is never pruned, so there is at least one.

        Returns:
            The records of the comparison, and the winner's record in ``searched``.
        """
        finished = [record for record in searched if not record.is_pruned]
        ranking = sorted(finished, key=lambda record: -record.objective)  # stable: the earlier of equals first
        finalists = {record.trial: record for record in [*ranking[: self.selection.num_finalists], searched[0]]}
        first = self.first_instances["selection"]
        instances = range(first, first + self.selection.num_instances)
        selected = [
            self._run_trial("selection", trial, record.weights, instances) for trial, record in finalists.items()
        ]
        winner = max(selected, key=lambda record: record.objective)
        return selected, finalists[winner.trial]

    def checks(self, start: TrialRecord, best: TrialRecord) -> list[TrialRecord]:
        """Step 3: the first weights and the best on further instances; one record if they are the same."""
        first = self.first_instances["check"]
        instances = range(first, first + self.check.num_instances)
        compared = {record.trial: record for record in (start, best)}
        return [self._run_trial("check", trial, record.weights, instances) for trial, record in compared.items()]

    def finish(self, searched: Sequence[TrialRecord]) -> SearchResult:
        """Steps 2 and 3, after all :meth:`trials`."""
        selected, best = self.select(searched)
        weights = {entry.name: getattr(self.start, entry.name) for entry in fields(CostToGo)} | best.weights
        return SearchResult(searched, selected, self.checks(searched[0], best), best, weights)

    @property
    def first_instances(self) -> dict[str, int]:
        """Index of the first task instance of each step; no two steps share one."""
        first = self.search.num_instances
        return {"search": 0, "selection": first, "check": first + self.selection.num_instances}

    def propose(self, past: Sequence[TrialRecord]) -> tuple[optuna.trial.Trial, Weights]:
        """Optuna's trial number ``len(past)`` and its weights: a function of the seed and of the trials before it."""
        import optuna

        ranges = self.search.ranges
        distributions: dict[str, optuna.distributions.BaseDistribution] = {
            name: optuna.distributions.FloatDistribution(low, high, log=True) for name, (low, high) in ranges.items()
        }
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        study = optuna.create_study(
            direction="maximize",
            sampler=optuna.samplers.TPESampler(
                seed=search_seed(self.seed, len(past)),
                n_startup_trials=self.search.num_random_trials,
                multivariate=True,
            ),
            # Trials have the same instances in the same order, so that their running means can be compared.
            pruner=optuna.pruners.MedianPruner(n_startup_trials=min(5, self.search.num_random_trials)),
        )
        for record in past:
            study.add_trial(
                optuna.trial.create_trial(
                    state=optuna.trial.TrialState.PRUNED if record.is_pruned else optuna.trial.TrialState.COMPLETE,
                    params=record.weights,
                    distributions=distributions,
                    value=record.objective,
                    intermediate_values=dict(record.curve),
                )
            )
        trial = study.ask(distributions) if past else study.ask()
        if not past:
            return trial, {name: getattr(self.start, name) for name in ranges}
        rounded = {name: float(f"{value:.{_DIGITS}g}") for name, value in trial.params.items()}
        return trial, {name: min(max(value, ranges[name][0]), ranges[name][1]) for name, value in rounded.items()}

    def _run_trial(
        self, step: str, number: int, weights: Weights, instances: range, trial: optuna.trial.Trial | None = None
    ) -> TrialRecord:
        """Run ``weights`` on ``instances`` in every action space; with ``trial``, block by block until it is pruned."""
        curve: dict[int, float] = {}
        episodes: dict[str, list[TrialEpisode]] = {space: [] for space in self.action_spaces}
        size = len(instances) if trial is None else self.search.block
        for start in range(0, len(instances), size):
            block = instances[start : start + size]
            tasks = [TrialTask(weights, space, index) for space in self.action_spaces for index in block]
            for task, episode in zip(tasks, self.run(tasks), strict=True):
                episodes[task.action_space].append(episode)
            done = start + len(block)
            everything = [episode for of_space in episodes.values() for episode in of_space]
            curve[done] = objective(everything, self.search.action_cost)
            if trial is not None:
                trial.report(curve[done], done)
                if done < len(instances) and trial.should_prune():
                    return TrialRecord(step, number, weights, curve, episodes, is_pruned=True)
        return TrialRecord(step, number, weights, curve, episodes, is_pruned=False)
