"""Results of an ablation from its evaluation, and those in the repository."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines import evaluate, report_ablation
from pipelines.config import EvaluateConfig, ReportAblationConfig
from pipelines.workflow.app import compose
from tests.evaluation.samples import ablation_table, evaluation_card
from visualrhp.errors import DataError
from visualrhp.evaluation.ablation_results import commonest_failures, film_name, results_document
from visualrhp.evaluation.episodes import read_evaluation, write_episodes
from visualrhp.evaluation.report_figures import result_figures
from visualrhp.files import write_json
from visualrhp.rendering.video import read_video


def run(*overrides: str) -> Path:
    config = compose("report_ablation", ReportAblationConfig, list(overrides))
    report_ablation.main.__wrapped__(config)  # type: ignore[attr-defined]
    return Path(config.paths.artefact)


def document_of(folder: Path) -> str:
    """The results in a folder, computed again from its rows."""
    episodes, card = read_evaluation(folder)
    figures = [figure for section in result_figures(episodes).values() for figure in section]
    return results_document(episodes, figures, report_ablation.facts(card), report_ablation.COMMANDS)


def test_an_evaluation_becomes_a_document_with_its_rows_and_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(report_ablation, "write_films", lambda *_: None)  # its episodes are made up
    episodes = ablation_table()
    write_episodes(tmp_path / "outputs" / "ablation" / "episodes.parquet", episodes)
    write_json(tmp_path / "outputs" / "ablation" / "evaluation.json", evaluation_card(episodes))
    folder = run()
    text = (folder / "results.md").read_text(encoding="utf-8")
    assert text == document_of(folder)
    shown = {line.split("](")[1].rstrip(")") for line in text.splitlines() if line.startswith("![")}
    assert {f"figure_{name}.svg" for name in ("7a", "7b", "8a", "8b", "9", "10")} == shown
    assert all((folder / name).is_file() and (folder / name).with_suffix(".png").is_file() for name in shown)
    assert "a processor, 2 cores" in text and "2026-01-31" in text and "episodes without a network" in text


def test_failures_are_run_again_and_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shared = ["tracking=none", "executor.num_workers=1", "scale=smoke"]
    planner = ["planner=crafted_heuristic_rhp", "planner.num_rollouts=2", "planner.horizon=1"]
    scene = ["scene.num_objects=[2,3]", "noise_level=high", "num_episodes=3", "action_space=discrete"]
    evaluate.main.__wrapped__(compose("evaluate", EvaluateConfig, [*shared, *planner, *scene]))  # type: ignore[attr-defined]
    folder = run("evaluation=outputs/evaluate", "size_px=96", *shared)
    episodes, _ = read_evaluation(folder)
    failures = commonest_failures(episodes)
    assert failures, "the planner is too good for this test"
    text = (folder / "results.md").read_text(encoding="utf-8")
    for kind, row in failures.items():
        assert f"[{kind.value}]({film_name(kind)})" in text
        assert row["episode"] == episodes.loc[episodes["failure"] == kind.value, "episode"].min()
        assert len(read_video(folder / film_name(kind))) > row["num_actions"]
    assert not (folder / "race.webp").exists()


def test_a_missing_evaluation_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DataError, match=r"outputs/ablation has no file episodes\.parquet"):
        run()
