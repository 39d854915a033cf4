"""Tables of the execution phase from its evaluations, and those in the repository."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines import report_execution
from pipelines.config import ReportExecutionConfig
from pipelines.workflow.app import compose
from pipelines.workflow.publishing import publish
from tests.evaluation.test_execution_tables import OURS, evaluation
from visualrhp.errors import DataError
from visualrhp.evaluation.execution_tables import read_rows, results_document
from visualrhp.files import write_json

RESULTS = Path(__file__).parents[2] / "docs" / "results" / "execution"


def run(*overrides: str) -> Path:
    config = compose("report_execution", ReportExecutionConfig, list(overrides))
    report_execution.main.__wrapped__(config)  # type: ignore[attr-defined]
    return Path(config.paths.artefact)


@pytest.fixture
def evaluated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "new").mkdir()
    card = {"commit": "abcdef0", "config": {"world": "cell"}, "networks": {}, "versions": {}}
    write_json(evaluation(tmp_path / "new") / "execution.json", card)
    publish(tmp_path / "new", tmp_path / "outputs" / "execution" / "network" / "6-7", "evaluate_execution")
    return tmp_path


def test_evaluations_at_any_depth_become_tables(evaluated: Path) -> None:
    folder = run()
    rows = read_rows(folder / "executions.csv")
    assert rows["method"].tolist() == [OURS] and rows["commit"].tolist() == ["abcdef0"]
    assert (folder / "results.md").read_text() == results_document(rows, OURS)
    assert '"network/6-7": {' in (folder / "report_execution.json").read_text()


def test_what_is_missing_is_named(evaluated: Path) -> None:
    with pytest.raises(DataError, match=r"method=Magic was not evaluated; choose one of VisualRHP\+ 3x3"):
        run("method=Magic")
    with pytest.raises(DataError, match=r"nothing has no evaluation of the execution phase"):
        run("evaluations=nothing")
    (evaluated / "outputs/execution/network/6-7/execution.json").write_text("{}")
    with pytest.raises(DataError, match=r"execution\.json is damaged.*make it again"):
        run()


def test_the_results_in_the_repository_are_those_of_their_rows() -> None:
    rows = read_rows(RESULTS / "executions.csv")
    document = (RESULTS / "results.md").read_text(encoding="utf-8")
    assert document == results_document(rows, OURS)
    text = (RESULTS.parents[1] / "execution.md").read_text(encoding="utf-8")
    results = text[text.index("## Results") : text.index("## Situations")]
    tables = [line for line in results.splitlines() if line.startswith("|")]
    assert len(tables) > 10 and set(tables) <= set(document.splitlines()), "docs/execution.md shows other results"
