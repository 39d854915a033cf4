"""Search the weights of the handcrafted heuristic (Sec. 7.5): ``python -m pipelines.tune_crafted``.

The paper's weights "were empirically optimized"; here they come from a recorded search
(:mod:`visualrhp.evaluation.weight_search`) on task instances of the tuning split, which the evaluation does not use.
The first trial has the weights of the configuration. The artefact is a folder with

- ``trials.csv``: one row per trial and step: weights, objective, and by action space the success rate, drop rate,
  actions and share of pushes from behind;
- ``best.yaml``: the best weights, in the form of ``conf/planner/crafted_heuristic_rhp.yaml``;
- ``search.png``, ``pushes.png``: the search, and the side from which the object is pushed with the first and the best
  weights;
- ``tune_crafted.json``: the card: configuration, seed, commit, results of all steps, versions.

Not a DVC stage: the weights are a part of the configuration.
"""

from __future__ import annotations

import functools
import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.app import app, command_line_overrides, override_keys

if TYPE_CHECKING:
    from pipelines.config import CraftedHeuristicConfig, TuneCraftedConfig
    from pipelines.workflow.tracking import Run
    from visualrhp.evaluation.weight_search import SearchResult, TrialEpisode, TrialRecord, TrialTask, WeightSearch

STAGE = "tune_crafted"

_log = logging.getLogger(__name__)

_JOURNAL = "episodes.jsonl"


@app(STAGE)
def main(config: TuneCraftedConfig) -> None:
    """Search, select and check weights, and publish the artefact."""
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work
    from visualrhp.errors import ConfigError

    if "action_space" in override_keys(command_line_overrides()):
        raise ConfigError("action_space has no effect here: set action_spaces, as in action_spaces=[discrete].")
    check_libraries()
    name = f"tune crafted heuristic, {' and '.join(config.action_spaces)}"
    with (
        open_work(config, STAGE) as work,
        open_run(config, STAGE, name, work) as run,
    ):
        publish(tune(config, work, run), config.paths.artefact, STAGE)


def check_libraries() -> None:
    """Check that Optuna is installed, before any work starts.

    Raises:
        ConfigError: it is not.
    """
    from visualrhp.errors import ConfigError

    try:
        import optuna  # noqa: F401
    except ImportError as error:
        raise ConfigError("The search needs the package optuna, which is not installed: pip install optuna.") from error


def tune(config: TuneCraftedConfig, work: Path, run: Run) -> Path:
    """Run the episodes that are missing in ``work``; return the folder of the artefact.

    An interrupted search is repeated from its beginning with the finished episodes. They determine the proposals and
    the pruning, so that the search immediately reaches the point of the interruption.
    """
    from tqdm import tqdm

    from pipelines.workflow.executor import run_tasks
    from visualrhp.evaluation.journal import Journal
    from visualrhp.evaluation.weight_search import TrialEpisode, WeightSearch, run_once

    journal = Journal(work / _JOURNAL, TrialEpisode)
    if journal:
        _log.info("%d episodes are finished.", len(journal))
    run_one = functools.partial(run_unit, config)
    episodes = run_once(lambda tasks: run_tasks(run_one, tasks, config.executor), journal)
    search = WeightSearch(
        start_weights(config),
        config.action_spaces,
        config.seed,
        config.search,
        config.selection,
        config.check,
        episodes,
    )
    searched: list[TrialRecord] = []
    for record in tqdm(search.trials(), total=config.search.num_trials, desc="trials", unit="trial"):
        searched.append(record)
        best = max((other.objective for other in searched if not other.is_pruned), default=None)
        tried = {f"search/{name}": value for name, value in record.weights.items()}
        run.log_metrics({"search/objective": record.objective, "search/best": best, **tried}, step=record.trial)
    return write_artefact(config, search, search.finish(searched), work / "artefact", run)


def run_unit(config: TuneCraftedConfig, task: TrialTask) -> tuple[TrialTask, TrialEpisode]:
    """Run one episode; also return the task, since tasks finish in any order."""
    from pipelines.planners import build_planner
    from visualrhp.evaluation.weight_search import TrialEpisode
    from visualrhp.execution.episode import run_task
    from visualrhp.scene import sample_task_instance
    from visualrhp.simulation import make_action_space
    from visualrhp.streams import Split

    instance = sample_task_instance(config.scene, config.seed, Split.TUNING, task.index)
    planner = replace(config.planner, heuristic=replace(start_weights(config), **task.weights))
    result = run_task(
        build_planner(planner, task.action_space, instance.scene.num_objects),
        instance,
        config.seed,
        Split.TUNING,
        task.index,
        action_space=make_action_space(task.action_space),
        physics=config.physics,
    )
    return task, TrialEpisode.of(result)


def start_weights(config: TuneCraftedConfig) -> CraftedHeuristicConfig:
    """The handcrafted heuristic of the configuration, whose weights are the first trial."""
    planner = config.planner
    assert planner.algorithm == "receding_horizon"  # both are checked by TuneCraftedConfig
    assert planner.heuristic.kind == "crafted"
    return planner.heuristic


def write_artefact(
    config: TuneCraftedConfig, search: WeightSearch, result: SearchResult, folder: Path, run: Run
) -> Path:
    """Write the results to ``folder``, and log them; return the folder."""
    import optuna

    from pipelines.workflow.artefacts import card, git_commit
    from pipelines.workflow.workspace import empty_folder
    from visualrhp.evaluation.styles import save
    from visualrhp.evaluation.weight_search_figures import pushes_figure, search_figure
    from visualrhp.evaluation.weight_search_tables import (
        check_lines,
        heuristic_yaml,
        result_card,
        space_metrics,
        trials_table,
    )
    from visualrhp.files import atomic_path, write_json, write_text

    empty_folder(folder)
    with atomic_path(folder / "trials.csv") as path:
        trials_table(result.records, config.action_spaces).to_csv(path, index=False, float_format="%.4g")
    origin = f"# Trial {result.best.trial} of {len(result.searched)}: seed {config.seed}, commit {git_commit()}."
    write_text(folder / "best.yaml", f"{origin}\n{heuristic_yaml(result)}")
    save(search_figure(result.searched, result.best), folder / "search.png")
    compared = {"first weights": result.start_check, "best weights": result.best_check}
    save(pushes_figure(compared), folder / "pushes.png")
    content = result_card(result) | {
        "instances": {"split": "TUNING", **search.first_instances},
        "optuna": optuna.__version__,
    }
    write_json(folder / "tune_crafted.json", card(config, STAGE, **content))
    run.log_metrics({f"best/{name}": value for name, value in result.weights.items()})
    for space, episodes in result.best_check.episodes.items():
        run.log_metrics({f"check/{name} {space}": value for name, value in space_metrics(episodes).items()})
    run.log_artifact(folder)
    _log.info("%s", check_lines(result))
    return folder


if __name__ == "__main__":
    main()
