"""The report: one self-contained page with figures and videos."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipelines import report
from pipelines.config import ReportConfig
from pipelines.workflow.app import compose
from pipelines.workflow.tracking import open_run
from tests.evaluation.samples import evaluation_card, report_table
from visualrhp.errors import DataError
from visualrhp.files import write_json
from visualrhp.rendering.video import read_video


@pytest.fixture
def outputs(tmp_path: Path) -> Path:
    episodes = report_table()
    (tmp_path / "evaluate").mkdir()
    episodes.to_parquet(tmp_path / "evaluate" / "episodes.parquet", index=False)
    write_json(tmp_path / "evaluate" / "evaluation.json", evaluation_card(episodes))
    return tmp_path


def configure(outputs: Path, *overrides: str) -> ReportConfig:
    settings = ["scale=smoke", "tracking=none", "executor.num_workers=1", f"paths.outputs={outputs}"]
    return compose("report", ReportConfig, [*settings, *overrides])


def make(config: ReportConfig, work: Path) -> Path:
    """What the pipeline does between composing and publishing."""
    with open_run(config, "report", "test") as run:
        return report.make_report(config, work, run)


def test_the_page_needs_nothing_but_itself(outputs: Path) -> None:
    curves = outputs / "train_rl" / "continuous" / "image" / "curves.csv"
    curves.parent.mkdir(parents=True)
    rows = {"network": "image", "iteration": [0, 1], "greedy/success_rate": [0.5, 0.7], "policy/kl": [np.nan, 0.01]}
    pd.DataFrame(rows).to_csv(curves, index=False)
    config = configure(outputs, "videos.planners=[kinodynamic_rrt]", "videos.num_objects=[1]", "videos.size_px=64")
    folder = make(config, outputs / "work")
    page = (folder / "index.html").read_text(encoding="utf-8")

    assert not re.findall(r"(?:https?:)?//[\w.-]+\.\w", page.split("<script>")[0])
    sources = re.findall(r'(?:src|href)="([^"]{0,40})', page)
    assert sources and all(source.startswith(("data:", "#")) for source in sources)
    for name in ("figure_7a", "figure_7b", "figure_8a", "figure_8b", "figure_9", "figure_10", "training_train_rl"):
        assert (folder / "figures" / f"{name}.svg").is_file() and (folder / "figures" / f"{name}.png").is_file()
    assert len(re.findall(r"<figure[^>]*>\s*<svg", page)) == 7
    videos = [base64.b64decode(data) for data in re.findall(r"data:video/webm;base64,([\w+/=]+)", page)]
    files = sorted((folder / "videos").glob("scene_*.webm"))
    assert len(videos) == len(files) == 2  # continuous and discrete
    assert {path.read_bytes() for path in files} == set(videos)
    assert len(read_video(files[0])) > 3
    assert (folder / "videos" / "comparison.webm").is_file()


def test_a_missing_evaluation_is_an_error_before_any_work(outputs: Path) -> None:
    config = configure(outputs, f"evaluation={outputs}/nothing")
    with pytest.raises(DataError, match=r"nothing has no file episodes\.parquet"):
        make(config, outputs / "work")
    assert not (outputs / "work").exists()
