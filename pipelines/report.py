"""Present the results on one page: ``python -m pipelines.report``.

The artefact is a folder with ``index.html``, which is self-contained, and the same figures (``figures/*.svg``,
``*.png``) and videos (``videos/*.webm``) as files.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import ReportConfig
    from pipelines.workflow.tracking import Run

STAGE = "report"

_log = logging.getLogger(__name__)


@app(STAGE)
def main(config: ReportConfig) -> None:
    """Make the report and publish it."""
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work

    # What it reads is in its outputs, whose content is not part of the name of the work folder.
    paths = {"artefact": config.paths.artefact, "evaluation": config.evaluation, "training": ", ".join(config.training)}
    inputs = {name: os.path.abspath(path) for name, path in paths.items()}
    with open_work(config, STAGE, inputs) as work, open_run(config, STAGE, STAGE, work) as run:
        publish(make_report(config, work, run), config.paths.artefact, STAGE)
    _log.info("The report is %s", Path(config.paths.artefact) / "index.html")


def make_report(config: ReportConfig, work: Path, run: Run) -> Path:
    """Load the results of other pipelines, film the planners and write the page; return the folder of the artefact."""
    from pipelines.filming import film, video_tasks
    from pipelines.workflow.artefacts import git_commit
    from pipelines.workflow.publishing import copy_artefacts
    from pipelines.workflow.workspace import empty_folder
    from visualrhp.evaluation.episodes import read_evaluation
    from visualrhp.evaluation.report_content import page_content
    from visualrhp.evaluation.report_figures import curve_figures, result_figures, sweep_figures
    from visualrhp.evaluation.report_page import render
    from visualrhp.evaluation.styles import save
    from visualrhp.files import write_text

    read_evaluation(Path(config.evaluation))  # its errors name this folder, not the copy
    # Other stages may publish while the planners are filmed.
    inputs = empty_folder(work / "inputs")
    episodes, evaluation = read_evaluation(copy_artefacts(Path(config.evaluation), inputs / "evaluation"))
    training = [
        copy_artefacts(Path(folder), inputs / "training") for folder in config.training if Path(folder).is_dir()
    ]
    demonstrations, stability = (
        None if folder is None else copy_artefacts(Path(folder), inputs / name)
        for name, folder in (
            ("demonstrations", config.sweeps.demonstrations),
            ("stability", config.sweeps.stability),
        )
    )
    tasks = video_tasks(config, work)
    artefact = empty_folder(work / "artefact")
    figures = result_figures(episodes)
    figures |= {"training": curve_figures(training), "sweeps": sweep_figures(demonstrations, stability)}
    for figure in (figure for section in figures.values() for figure in section):
        for suffix in ("svg", "png"):
            save(figure.figure, artefact / "figures" / f"{figure.stem}.{suffix}")
    scenes = film(config, tasks, artefact / "videos")
    content = page_content(config.title, episodes, evaluation, figures, scenes, training, git_commit())
    write_text(artefact / "index.html", render(content))
    run.log_artifact(artefact)
    return artefact


if __name__ == "__main__":
    main()
