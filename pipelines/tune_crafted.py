"""Search the weights of the handcrafted heuristic (Sec. 7.5): ``python -m pipelines.tune_crafted``.

The paper's weights "were empirically optimized"; here that is a recorded search with Optuna, on task instances of the
split for tuning, which nothing is evaluated on, in three steps on disjoint instances:

1. search: a tree-structured Parzen estimator proposes weights, and every trial runs the planner on the same instances,
   block by block; a trial that is below the median of the finished ones is stopped. The first trial is the weights of
   the configuration.
2. selection: the best trials and the first, on other instances; the best of them wins.
3. check: the winner and the first, on further instances. Nothing is chosen by it.

The artefact is a folder with

- ``trials.csv``: one row per trial and step: weights, objective, and by action space the success rate, drop rate,
  actions and share of pushes from behind;
- ``best.yaml``: the winner, as it would stand in ``conf/planner/crafted_heuristic_rhp.yaml``;
- ``search.png``, ``pushes.png``: the search, and from where the object is pushed with the first and the best weights;
- ``tune_crafted.json``: the card: configuration, seed, commit, results of all steps, versions.

Results are a function of configuration and seed: a proposal depends on the finished trials before it and on a
generator of its own, and the episodes of a block, which the workers share, are summed in their order. Not a DVC stage:
the weights are a part of the configuration.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.app import app, command_line_overrides, override_keys
from pipelines.config import ActionSpaceName, CraftedHeuristicConfig, RecedingHorizonConfig, TuneCraftedConfig

if TYPE_CHECKING:
    import optuna
    import pandas as pd
    from matplotlib.figure import Figure

    from pipelines.tracking import Run

STAGE = "tune_crafted"

_log = logging.getLogger(__name__)

_EPISODES = "episodes.jsonl"
_DIGITS = 3
"""Significant digits of a weight: more would promise more than a search among noise can find."""

Weights = dict[str, float]


@dataclass(frozen=True)
class Unit:
    """One episode to run: all that a worker has to know."""

    config: TuneCraftedConfig = field(repr=False)
    weights: Weights
    action_space: ActionSpaceName
    index: int

    @property
    def key(self) -> str:
        """Text that is equal for equal episodes of a search."""
        return json.dumps([self.weights, self.action_space, self.index], sort_keys=True)


@dataclass(frozen=True)
class Episode:
    """What counts of an episode; ``push_angles`` are those of :func:`visualrhp.evaluation.behaviour.push_angles`."""

    success: bool
    dropped: bool
    num_actions: int
    push_angles: tuple[float, ...]


@dataclass(frozen=True)
class Record:
    """A trial in one of the three steps, finished.

    Attributes:
        step: ``search``, ``selection`` or ``check``.
        trial: number of the trial in the search that the weights are from.
        weights: those that are searched.
        curve: objective after so many instances per action space.
        episodes: by action space, in the order of the instances.
    """

    step: str
    trial: int
    weights: Weights
    curve: dict[int, float]
    episodes: dict[str, list[Episode]]
    is_pruned: bool

    @property
    def objective(self) -> float:
        """Over all instances that were run."""
        return self.curve[self.num_instances]

    @property
    def num_instances(self) -> int:
        """Task instances that were run in each action space."""
        return max(self.curve)


@app(STAGE, TuneCraftedConfig)
def main(config: TuneCraftedConfig) -> None:
    """Search, select, check; and publish the artefact."""
    from pipelines.tracking import open_run
    from pipelines.work import discard, git_commit, publish, work_folder
    from visualrhp.errors import ConfigError

    if "action_space" in override_keys(command_line_overrides()):
        raise ConfigError("action_space is not read here: say in which to search as action_spaces=[discrete].")
    check_libraries(config)
    work = work_folder(config, STAGE, {"commit": git_commit() or ""})
    with open_run(config, STAGE, f"tune crafted heuristic, {' and '.join(config.action_spaces)}", work) as run:
        publish(tune(config, work, run), config.paths.artefact)
    discard(work)


def check_libraries(config: TuneCraftedConfig) -> None:
    """Fail before any work starts, if it is going to.

    Raises:
        ConfigError: Optuna is not installed, or a parameter of the scenes is out of range.
    """
    from visualrhp.errors import ConfigError
    from visualrhp.scene import SceneDistribution

    try:
        import optuna  # noqa: F401
    except ImportError as error:
        raise ConfigError("The search needs the package optuna, which is not installed: pip install optuna.") from error
    SceneDistribution(**asdict(config.scene))


def tune(config: TuneCraftedConfig, work: Path, run: Run) -> Path:
    """Do what is not done yet in ``work``; the folder of the artefact.

    A killed search is gone through again from its beginning, with the episodes that were run: proposals and stops
    follow from them, so that it gets where it was at once.
    """
    runner = Runner(config, work / _EPISODES)
    searched = search(config, runner, run)
    selected, best = select(config, runner, searched)
    checked = check(config, runner, searched[0], best)
    return write_artefact(config, [*searched, *selected, *checked], best, work / "artefact", run)


# ---------------------------------------------------------------------------------------------------------- three steps
def search(config: TuneCraftedConfig, runner: Runner, run: Run) -> list[Record]:
    """Step 1: try weights, one set after another; the records of all trials."""
    from tqdm import tqdm

    if runner.num_known:
        _log.info("%d episodes are done already.", runner.num_known)
    records: list[Record] = []
    for number in tqdm(range(config.search.num_trials), desc="trials", unit="trial"):
        trial, weights = propose(config, records)
        known = runner.num_known
        record = run_trial(config, runner, "search", number, weights, range(config.search.num_instances), trial)
        records.append(record)
        if runner.num_known > known:  # else it is in the tracker
            best = max((other.objective for other in records if not other.is_pruned), default=None)
            tried = {f"search/{name}": value for name, value in weights.items()}
            run.log_metrics({"search/objective": record.objective, "search/best": best, **tried}, step=number)
    return records


def select(config: TuneCraftedConfig, runner: Runner, searched: Sequence[Record]) -> tuple[list[Record], Record]:
    """Step 2: compare the best trials and the first on other instances; the records of that, and the winner's search.

    The first trial is never stopped, so there is one at least.
    """
    finished = [record for record in searched if not record.is_pruned]
    ranking = sorted(finished, key=lambda record: -record.objective)  # stable: the earlier of equals first
    finalists = {record.trial: record for record in [*ranking[: config.selection.num_finalists], searched[0]]}
    first = config.search.num_instances
    instances = range(first, first + config.selection.num_instances)
    selected = [
        run_trial(config, runner, "selection", trial, record.weights, instances) for trial, record in finalists.items()
    ]
    winner = max(selected, key=lambda record: record.objective)
    return selected, finalists[winner.trial]


def check(config: TuneCraftedConfig, runner: Runner, start: Record, best: Record) -> list[Record]:
    """Step 3: the first weights and the winner on further instances."""
    first = config.search.num_instances + config.selection.num_instances
    instances = range(first, first + config.check.num_instances)
    compared = {record.trial: record for record in (start, best)}
    return [run_trial(config, runner, "check", trial, record.weights, instances) for trial, record in compared.items()]


def propose(config: TuneCraftedConfig, past: Sequence[Record]) -> tuple[optuna.trial.Trial, Weights]:
    """Optuna's trial number ``len(past)`` and its weights: a function of the seed and of the trials before it."""
    import optuna

    distributions: dict[str, optuna.distributions.BaseDistribution] = {
        name: optuna.distributions.FloatDistribution(low, high, log=True)
        for name, (low, high) in config.search.ranges.items()
    }
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        direction="maximize",
        sampler=optuna.samplers.TPESampler(
            seed=_seed_of_trial(config.seed, len(past)),
            n_startup_trials=config.search.num_random_trials,
            multivariate=True,
        ),
        # With the running mean over the same instances, in the same order, trials are compared like with like.
        pruner=optuna.pruners.MedianPruner(n_startup_trials=min(5, config.search.num_random_trials)),
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
        return trial, {name: getattr(_heuristic(config), name) for name in config.search.ranges}
    rounded = {name: float(f"{value:.{_DIGITS}g}") for name, value in trial.params.items()}
    ranges = config.search.ranges
    return trial, {name: min(max(value, ranges[name][0]), ranges[name][1]) for name, value in rounded.items()}


def run_trial(
    config: TuneCraftedConfig,
    runner: Runner,
    step: str,
    number: int,
    weights: Weights,
    instances: range,
    trial: optuna.trial.Trial | None = None,
) -> Record:
    """Run the planner with ``weights`` on ``instances`` in every action space; with ``trial``, until it is pruned."""
    curve: dict[int, float] = {}
    episodes: dict[str, list[Episode]] = {space: [] for space in config.action_spaces}
    size = len(instances) if trial is None else config.search.block
    for start in range(0, len(instances), size):
        block = instances[start : start + size]
        units = [Unit(config, weights, space, index) for space in config.action_spaces for index in block]
        for unit, episode in zip(units, runner.run(units), strict=True):
            episodes[unit.action_space].append(episode)
        done = start + len(block)
        everything = [episode for space in episodes.values() for episode in space]
        curve[done] = objective(everything, config.search.action_cost)
        if trial is not None:
            trial.report(curve[done], done)
            if done < len(instances) and trial.should_prune():
                return Record(step, number, weights, curve, episodes, is_pruned=True)
    return Record(step, number, weights, curve, episodes, is_pruned=False)


def objective(episodes: Sequence[Episode], action_cost: float) -> float:
    """Mean of [success] - ``action_cost`` * actions / 49, where a failure counts 49 actions, however early it came."""
    from visualrhp.simulation.task import MAX_EPISODE_ACTIONS

    scores = [
        1.0 - action_cost * episode.num_actions / MAX_EPISODE_ACTIONS if episode.success else -action_cost
        for episode in episodes
    ]
    return math.fsum(scores) / len(scores)


def run_unit(unit: Unit) -> tuple[Unit, Episode]:
    """Run one episode; the unit again, since they are done in any order."""
    from pipelines.planners import build_planner
    from visualrhp.evaluation.behaviour import push_angles
    from visualrhp.evaluation.episodes import run_task
    from visualrhp.scene import SceneDistribution, Split, sample_task_instance
    from visualrhp.simulation import Physics, make_action_space

    config, space = unit.config, unit.action_space
    distribution = SceneDistribution(**asdict(config.scene))
    scene = sample_task_instance(distribution, config.seed, Split.TUNING, unit.index).scene
    assert isinstance(config.planner, RecedingHorizonConfig)
    planner = replace(config.planner, heuristic=replace(_heuristic(config), **unit.weights))
    result = run_task(
        build_planner(planner, space, "", scene.num_objects),
        distribution,
        config.seed,
        Split.TUNING,
        unit.index,
        action_space=make_action_space(space),
        physics=Physics(**asdict(config.physics)),
        keep_states=True,
    )
    angles = tuple(round(float(angle), 4) for angle in push_angles(scene, result.states))
    return unit, Episode(result.success, result.dropped, result.num_actions, angles)


class Runner:
    """Runs episodes on the workers, each once: finished ones are kept in a file, one JSON line each.

    An episode is a function of its unit. A line that a kill cut short is dropped.
    """

    def __init__(self, config: TuneCraftedConfig, path: Path) -> None:
        from visualrhp.files import write_text

        self._executor = config.executor
        self._path = path
        self._known: dict[str, Episode] = {}
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        whole = []
        for line in lines:
            try:
                key, episode = json.loads(line)
            except ValueError:
                continue
            self._known[key] = Episode(**episode | {"push_angles": tuple(episode["push_angles"])})
            whole.append(line)
        if len(whole) < len(lines):
            write_text(path, "".join(f"{line}\n" for line in whole))

    @property
    def num_known(self) -> int:
        """Episodes that are done."""
        return len(self._known)

    def run(self, units: Sequence[Unit]) -> list[Episode]:
        """The episodes of ``units``, in their order; those that are not known yet are run."""
        from pipelines.execution import run_tasks

        missing = [unit for unit in units if unit.key not in self._known]
        for unit, episode in run_tasks(run_unit, missing, self._executor) if missing else ():
            self._known[unit.key] = episode
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([unit.key, asdict(episode)]) + "\n")
        return [self._known[unit.key] for unit in units]


# ------------------------------------------------------------------------------------------------------------- artefact
def write_artefact(config: TuneCraftedConfig, records: Sequence[Record], best: Record, folder: Path, run: Run) -> Path:
    """Write what was found to ``folder``, and log it."""
    from pipelines.work import card, git_commit
    from visualrhp.evaluation.figures import save
    from visualrhp.files import atomic_path, write_json, write_text

    folder.mkdir(exist_ok=True)
    searched, selected, checked = (
        [record for record in records if record.step == step] for step in ("search", "selection", "check")
    )
    table = trials_table(records, config.action_spaces)
    with atomic_path(folder / "trials.csv") as path:
        table.to_csv(path, index=False, float_format="%.4g")
    weights = {name: value for name, value in asdict(_heuristic(config)).items() if name != "kind"} | best.weights
    origin = f"# Trial {best.trial} of {len(searched)}: seed {config.seed}, commit {git_commit()}."
    lines = [origin, "heuristic:", "  kind: crafted", *(f"  {name}: {value}" for name, value in weights.items())]
    write_text(folder / "best.yaml", "\n".join(lines) + "\n")
    start, found = checked[0], checked[-1]  # one and the same if nothing better was found
    save(search_figure(searched, best), folder / "search.png")
    save(pushes_figure({"first weights": start, "best weights": found}), folder / "pushes.png")
    results = {
        step: {str(record.trial): _summary(record) for record in of_step}
        for step, of_step in (("selection", selected), ("check", checked))
    }
    content = {
        "best": {"trial": best.trial, "weights": weights},
        "num_trials": len(searched),
        "num_pruned": sum(record.is_pruned for record in searched),
        "num_episodes": sum(len(episodes) for record in records for episodes in record.episodes.values()),
        "instances": {"split": "TUNING", "search": 0, **_first_instances(config)},
        "results": results,
        "optuna": _optuna_version(),
    }
    write_json(folder / "tune_crafted.json", card(config, STAGE, **content))
    run.log_metrics({f"best/{name}": value for name, value in weights.items()})
    for space, numbers in _summary(found)["by_action_space"].items():
        run.log_metrics({f"check/{name} {space}": value for name, value in numbers.items()})
    run.log_artifact(folder)
    _log.info("%s", report_lines(start, found, weights))
    return folder


def trials_table(records: Sequence[Record], action_spaces: Sequence[str]) -> pd.DataFrame:
    """One row per record.

    Columns: step, trial, the weights, is_pruned, num_instances (per action space), objective, and for each action space
    those of :func:`space_metrics` with its name behind.
    """
    import pandas as pd

    rows = []
    for record in records:
        row: dict[str, Any] = {"step": record.step, "trial": record.trial, **record.weights}
        row |= {"is_pruned": record.is_pruned, "num_instances": record.num_instances, "objective": record.objective}
        for space in action_spaces:
            metrics = space_metrics(record.episodes[space])
            row |= {f"{name}_{space}": value for name, value in metrics.items() if not name.endswith(("_low", "_high"))}
        rows.append(row)
    return pd.DataFrame(rows)


def space_metrics(episodes: Sequence[Episode]) -> dict[str, float | None]:
    """Success rate with its 90% interval, drop rate, mean actions (of completed episodes), share of pushes from behind.

    The last two are None if there is nothing to take the mean of.
    """
    from visualrhp.evaluation.behaviour import FROM_BEHIND
    from visualrhp.evaluation.metrics import wilson_interval

    rate = wilson_interval(sum(episode.success for episode in episodes), len(episodes))
    actions = [episode.num_actions for episode in episodes if episode.success]
    angles = [angle for episode in episodes for angle in episode.push_angles]
    return {
        "success_rate": rate.value,
        "success_rate_low": rate.low,
        "success_rate_high": rate.high,
        "drop_rate": sum(episode.dropped for episode in episodes) / len(episodes),
        "actions": sum(actions) / len(actions) if actions else None,
        "from_behind": sum(angle < FROM_BEHIND for angle in angles) / len(angles) if angles else None,
    }


def report_lines(start: Record, best: Record, weights: Mapping[str, float]) -> str:
    """The outcome of the check as a few lines of text."""
    found = ", ".join(f"{name} {value:g}" for name, value in weights.items())
    lines = [f"Best: trial {best.trial}: {found}. On {best.num_instances} further instances, first and best weights:"]
    for space in best.episodes:
        for label, record in (("first", start), ("best", best)):
            numbers = space_metrics(record.episodes[space])
            rate, low, high = (numbers[f"success_rate{end}"] or 0.0 for end in ("", "_low", "_high"))
            lines.append(
                f"  {space:<11} {label:<6} {rate:.1%} [{low:.1%}, {high:.1%}]  "
                f"{_or_dash(numbers['actions'], '.1f')} actions  "
                f"{_or_dash(numbers['from_behind'], '.0%')} of pushes from behind"
            )
    return "\n".join(lines)


def search_figure(records: Sequence[Record], best: Record) -> Figure:
    """The objective of every trial in order, and over each weight."""
    import numpy as np
    from matplotlib.figure import Figure

    names = list(best.weights)
    columns = 3
    rows = -(-(len(names) + 1) // columns)
    figure = Figure(figsize=(9.0, 2.6 * rows), layout="constrained")
    finished = [record for record in records if not record.is_pruned]
    pruned = [record for record in records if record.is_pruned]
    for number, name in enumerate([None, *names]):
        axes = figure.add_subplot(rows, columns, number + 1)
        for group, colour, label in ((pruned, "#b9c0ca", "pruned"), (finished, "#0072b2", "finished")):
            x = [record.trial if name is None else record.weights[name] for record in group]
            axes.plot(x, [record.objective for record in group], "o", color=colour, markersize=3.5, label=label)
        x = best.trial if name is None else best.weights[name]
        axes.plot([x], [best.objective], "*", color="#d55e00", markersize=11, label="selected")
        axes.set_xlabel("trial" if name is None else name)
        if name is not None:
            axes.set_xscale("log")
            tried = [record.weights[name] for record in records]
            ticks = np.geomspace(min(tried), max(tried), 4)
            axes.set_xticks(ticks, [f"{tick:.2g}" for tick in ticks])
            axes.minorticks_off()
        if number % columns == 0:
            axes.set_ylabel("objective")
        if name is None:
            axes.legend(fontsize="small", loc="lower right")
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def pushes_figure(records: Mapping[str, Record]) -> Figure:
    """Histograms of the angles of all pushes, one line per record, one panel per action space."""
    import numpy as np
    from matplotlib.figure import Figure

    from visualrhp.evaluation.behaviour import FROM_BEHIND

    spaces = list(next(iter(records.values())).episodes)
    figure = Figure(figsize=(4.5 * len(spaces), 3.0), layout="constrained")
    bins = np.linspace(0.0, 180.0, 13)
    for number, space in enumerate(spaces):
        axes = figure.add_subplot(1, len(spaces), number + 1)
        axes.axvspan(0.0, math.degrees(FROM_BEHIND), color="#e8f1f8", lw=0)
        for (label, record), colour in zip(records.items(), ("#6f7885", "#0072b2"), strict=True):
            angles = np.degrees([angle for episode in record.episodes[space] for angle in episode.push_angles])
            share = np.mean(angles < math.degrees(FROM_BEHIND)) if len(angles) else math.nan
            heights = np.histogram(angles, bins)[0] / max(1, len(angles))
            axes.stairs(heights, bins, color=colour, lw=1.6, label=f"{label}: {share:.0%} below 60°")
        axes.set(title=space, xlabel="gripper off straight behind the object (°)", xticks=range(0, 181, 30))
        if number == 0:
            axes.set_ylabel("share of pushes")
        axes.legend(fontsize="small")
        axes.spines[["top", "right"]].set_visible(False)
    return figure


# ---------------------------------------------------------------------------------------------------------------- small
def _heuristic(config: TuneCraftedConfig) -> CraftedHeuristicConfig:
    heuristic = getattr(config.planner, "heuristic", None)
    assert isinstance(heuristic, CraftedHeuristicConfig)  # the configuration is checked
    return heuristic


def _seed_of_trial(seed: int, number: int) -> int:
    """A seed of its own for the proposal of every trial, so that a restarted search goes on as if nothing happened."""
    import numpy as np

    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


def _summary(record: Record) -> dict[str, Any]:
    return {
        "objective": record.objective,
        "num_instances": record.num_instances,
        "by_action_space": {space: space_metrics(episodes) for space, episodes in record.episodes.items()},
    }


def _first_instances(config: TuneCraftedConfig) -> dict[str, int]:
    first = config.search.num_instances
    return {"selection": first, "check": first + config.selection.num_instances}


def _optuna_version() -> str:
    import optuna

    return optuna.__version__


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


if __name__ == "__main__":
    main()
