"""Results of an ablation to publish: ``python -m pipelines.report_ablation``.

Reads an evaluation, such as that of ``experiment=ablation``. The artefact is a folder with

- ``results.md``: tables, figures, the claims of the paper and whether they hold, why episodes fail, the commands;
- ``episodes.parquet``, ``evaluation.json``: the rows, from which all numbers are computed, and their card;
- the figures, as SVG and PNG.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import ReportAblationConfig

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
    return artefact


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
