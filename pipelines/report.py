"""Present the results on one page: ``python -m pipelines.report``.

The artefact is a folder with ``index.html``, which is self-contained, and the same figures (``figures/*.svg``,
``*.png``) and videos (``videos/*.webm``) as files.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import ReportConfig
    from pipelines.workflow.tracking import Run

_log = logging.getLogger(__name__)


@app("report")
def main(config: ReportConfig) -> None:
    """Make the report and publish it."""
    from pipelines.workflow.artefacts import discard, publish, work_folder
    from pipelines.workflow.tracking import open_run

    work = work_folder(config, "report")
    with open_run(config, "report", "report", work) as run:
        publish(make_report(config, work, run), config.paths.artefact)
    discard(work)
    _log.info("The report is %s", Path(config.paths.artefact) / "index.html")


def make_report(config: ReportConfig, work: Path, run: Run) -> Path:
    """Load the results of other pipelines, film the planners and write the page; return the folder of the artefact."""
    from pipelines.filming import film, video_tasks
    from pipelines.workflow.artefacts import discard, git_commit
    from visualrhp.evaluation.episodes import read_evaluation
    from visualrhp.evaluation.report_content import page_content
    from visualrhp.evaluation.report_figures import curve_figures, result_figures, sweep_figures
    from visualrhp.evaluation.report_page import render
    from visualrhp.evaluation.styles import save
    from visualrhp.files import write_text

    episodes, evaluation = read_evaluation(Path(config.evaluation))
    training = [Path(folder) for folder in config.training]
    demonstrations, stability = (
        None if folder is None else Path(folder) for folder in (config.sweeps.demonstrations, config.sweeps.stability)
    )
    tasks = video_tasks(config)
    artefact = work / "artefact"
    discard(artefact)  # of an interrupted run
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
