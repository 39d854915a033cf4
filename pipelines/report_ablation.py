"""Results of an ablation to publish: ``python -m pipelines.report_ablation``.

Reads an evaluation, such as that of ``experiment=ablation``. The artefact is a folder with

- ``results.md``: tables, figures, the claims of the paper and whether they hold, why episodes fail, the commands;
- ``episodes.parquet``, ``evaluation.json``: the rows, from which all numbers are computed, and their card;
- the figures, as SVG and PNG;
- ``<kind of failure>.webm``: a film of the commonest of each kind; ``race.webp``: methods side by side on a hard task.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.workflow.app import app
from visualrhp.evaluation.methods import method_label

if TYPE_CHECKING:
    import pandas as pd

    from pipelines.config import ReportAblationConfig
    from pipelines.filming import VideoTask
    from visualrhp.evaluation.films import Film
    from visualrhp.evaluation.report_videos import Attempt

STAGE = "report_ablation"

COMMANDS = ("python -m pipelines.evaluate experiment=ablation", "python -m pipelines.report_ablation")
"""That make the results in the repository."""

_log = logging.getLogger(__name__)


@app(STAGE)
def main(config: ReportAblationConfig) -> None:
    """Write the results and publish them."""
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.workspace import open_work

    inputs = {"artefact": os.path.abspath(config.paths.artefact), "evaluation": os.path.abspath(config.evaluation)}
    with open_work(config, STAGE, inputs) as work:
        publish(make_results(config, work), config.paths.artefact, STAGE)
    _log.info("The results are %s", Path(config.paths.artefact) / "results.md")


def make_results(config: ReportAblationConfig, work: Path) -> Path:
    """Read the evaluation and write the results; return the folder of the artefact.

    Raises:
        DataError: the evaluation is missing or damaged.
    """
    from pipelines.workflow.publishing import copy_artefacts
    from pipelines.workflow.workspace import empty_folder
    from visualrhp.evaluation.ablation_results import results_document
    from visualrhp.evaluation.episodes import read_evaluation, write_episodes
    from visualrhp.evaluation.report_figures import result_figures
    from visualrhp.evaluation.styles import save
    from visualrhp.files import write_json, write_text

    read_evaluation(Path(config.evaluation))  # its errors name this folder, not the copy
    episodes, card = read_evaluation(copy_artefacts(Path(config.evaluation), empty_folder(work / "inputs")))
    artefact = empty_folder(work / "artefact")
    figures = [figure for section in result_figures(episodes).values() for figure in section]
    for figure in figures:
        for suffix in ("svg", "png"):
            save(figure.figure, artefact / f"{figure.stem}.{suffix}")
    write_text(artefact / "results.md", results_document(episodes, figures, facts(card), COMMANDS))
    write_episodes(artefact / "episodes.parquet", episodes)
    write_json(artefact / "evaluation.json", card)
    write_films(config, episodes, card, work, artefact)
    return artefact


def write_films(
    config: ReportAblationConfig, episodes: pd.DataFrame, card: Mapping[str, Any], work: Path, artefact: Path
) -> None:
    """Run the commonest failures and the race again, and film them. What does not end as before gets no film."""
    from tqdm import tqdm

    from pipelines.workflow.executor import run_tasks
    from visualrhp.evaluation.ablation_results import commonest_failures, film_name, race
    from visualrhp.evaluation.films import write_comparison
    from visualrhp.files import atomic_path

    failures = {film_name(kind): row for kind, row in commonest_failures(episodes).items()}
    racers = race(episodes)
    rows = [*failures.values(), *racers]
    tasks = [(number, _task_of(config, row, card, work)) for number, row in enumerate(rows)]
    films: dict[int, Film] = {}
    for number, attempt in tqdm(run_tasks(_film, tasks, config.executor), total=len(tasks), desc="films", unit="film"):
        row = rows[number]
        as_before = attempt.description.endswith(f": {row['outcome']}, {row['num_actions']} actions")
        if as_before and attempt.film is not None:
            films[number] = attempt.film
        else:
            _log.warning("Task %d of %s ends otherwise than in the evaluation; no film.", row["episode"], row["method"])
    for number, name in enumerate(failures):
        if number in films:
            with atomic_path(artefact / name) as path:
                path.write_bytes(films[number].data)
    shown = [films[number] for number in range(len(failures), len(rows)) if number in films]
    if racers and len(shown) == len(racers):
        write_comparison(shown, artefact / "race.webp", config.fps, cell_px=config.size_px // 2)


def _task_of(config: ReportAblationConfig, row: Mapping[str, Any], card: Mapping[str, Any], work: Path) -> VideoTask:
    """The episode of a row, to be filmed."""
    from pipelines.filming import evaluated_task
    from visualrhp.evaluation.episodes import SETTING_COLUMNS

    (point,) = (
        point
        for point in card["points"]
        if all(
            str(point[name]) == str(row[name]) for name in SETTING_COLUMNS if name not in ("num_rollouts", "horizon")
        )
        and method_label(point["planner"], point["num_rollouts"], point["horizon"]) == row["method"]
    )
    return evaluated_task(point, row["seed"], row["num_objects"], row["episode"], config.fps, config.size_px, work)


def _film(numbered: tuple[int, VideoTask]) -> tuple[int, Attempt]:
    from pipelines.filming import film_task

    number, task = numbered
    return number, film_task(task)


def facts(card: Mapping[str, Any]) -> dict[str, str]:
    """What the document says about the runs, from the card of the evaluation."""
    versions = ", ".join(f"{name} {number}" for name, number in card["versions"].items() if number)
    skipped = sum(point["num_skipped"] for point in card["points"])
    told = {
        "Episodes": f"{card['num_episodes']:,} in {len(card['points'])} settings, seed {card['seed']}",
        "Networks": ", ".join(f"`{name}`" for name in card["networks"]),
        "Commit": f"`{card['commit']}`",
        "Versions": versions,
        "Machine": f"{card['machine']}, {card['num_workers']} processes",
        "Finished": card["date"],
    }
    if skipped:
        told["Not run"] = f"{skipped:,} episodes without a network for their number of objects"
    return told


if __name__ == "__main__":
    main()
