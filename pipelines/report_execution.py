"""Tables of the execution phase: ``python -m pipelines.report_execution``.

Reads every artefact of :mod:`pipelines.evaluate_execution` in a folder, such as those of the sweeps
``experiment=execution_worlds``, ``execution_camera`` and ``execution_planners``. The artefact is a folder with

- ``executions.csv``: one row per episode of all of them;
- ``results.md``: rates with intervals, paired comparisons, what each step to the cell costs, and causes of failure;
- ``report_execution.json``: the card, with the configuration and commit of every evaluation.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import ReportExecutionConfig

STAGE = "report_execution"

_log = logging.getLogger(__name__)

_CARD = "execution.json"


@app(STAGE)
def main(config: ReportExecutionConfig) -> None:
    """Make the tables and publish them."""
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.workspace import open_work

    inputs = {"artefact": os.path.abspath(config.paths.artefact), "evaluations": os.path.abspath(config.evaluations)}
    with open_work(config, STAGE, inputs) as work:
        publish(make_tables(config, work), config.paths.artefact, STAGE)
    _log.info("The tables are %s", Path(config.paths.artefact) / "results.md")


def make_tables(config: ReportExecutionConfig, work: Path) -> Path:
    """Join the evaluations and write the tables; return the folder of the artefact.

    Raises:
        DataError: there is no evaluation, or one is damaged.
    """
    from pipelines.workflow.artefacts import card
    from pipelines.workflow.workspace import empty_folder
    from visualrhp.errors import DataError
    from visualrhp.evaluation.execution_tables import joined, read_executions, results_document, write_rows
    from visualrhp.files import write_json, write_text

    folders = evaluations(Path(config.evaluations))
    if not folders:
        raise DataError(
            f"{config.evaluations} has no evaluation of the execution phase. Make some with "
            "python -m pipelines.evaluate_execution experiment=execution_camera, or name their folder with "
            "evaluations=<folder>."
        )
    cards = {name: _read_card(folder / _CARD) for name, folder in folders.items()}
    tables = [read_executions(folder, cards[name]["commit"]) for name, folder in folders.items()]
    rows = joined(tables)
    methods = set(rows["method"])
    if config.method not in methods:
        raise DataError(f"method={config.method} was not evaluated; choose one of {', '.join(sorted(methods))}")
    artefact = empty_folder(work / "artefact")
    write_rows(artefact / "executions.csv", rows)
    write_text(artefact / "results.md", results_document(rows, config.method))
    sources = {
        name: {key: content.get(key) for key in ("commit", "config", "networks", "versions")}
        for name, content in cards.items()
    }
    write_json(artefact / "report_execution.json", card(config, STAGE, evaluations=sources))
    return artefact


def evaluations(folder: Path) -> dict[str, Path]:
    """Every published artefact of ``evaluate_execution`` in a folder, by its path in it."""
    from pipelines.workflow.publishing import MARK

    found = sorted(path.parent for path in folder.rglob(_CARD) if (path.parent / MARK).is_file())
    return {path.relative_to(folder).as_posix(): path for path in found}


def _read_card(path: Path) -> dict[str, Any]:
    from visualrhp.evaluation.execution_tables import EXECUTION_CARD, ExecutionCard

    content = EXECUTION_CARD.read_content(path)
    EXECUTION_CARD.check(path, ExecutionCard, content)
    return content


if __name__ == "__main__":
    main()
