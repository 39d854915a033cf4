"""The report: one page that needs nothing but itself and says what the episodes say."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipelines import report, report_page
from pipelines.app import compose
from pipelines.config import ReportConfig
from visualrhp.errors import CheckpointError, DataError
from visualrhp.files import write_json
from visualrhp.rendering.video import read_video

METHODS = [("VisualRHP", 3, 3, 9), ("Greedy", None, None, 5), ("K.RRT", None, None, 10)]
COLUMNS = {
    "scale": "smoke",
    "seed": 0,
    "commit": "0123456789abcdef",
    "versions": {"visualrhp": "1"},
    "config": {"seed": 0},
}


def episodes_table() -> pd.DataFrame:
    """Ten episodes a cell, as many successes as METHODS says."""
    rows = []
    for planner, n, h, successes in METHODS:
        for space in ("continuous", "discrete"):
            for size, requested, level in (("mixed", "1-7", "none"), ("small", "1-7", "none"), ("mixed", "4", "high")):
                for episode in range(10):
                    objects = 4 if requested == "4" else 1 + episode % 7
                    success = episode < successes
                    rows.append(
                        {
                            "experiment": "mixed",
                            "planner": planner,
                            "num_rollouts": n,
                            "horizon": h,
                            "action_space": space,
                            "object_size": size,
                            "scene_num_objects": requested,
                            "noise_level": level,
                            "seed": 0,
                            "episode": episode,
                            "num_objects": objects,
                            "success": success,
                            "dropped": not success,
                            "num_actions": 10,
                            "action_efficiency": objects / 10 if success else np.nan,
                            "decision_time_s": 0.5,
                            "simulation_time_s": 0.01,
                        }
                    )
    table = pd.DataFrame(rows)
    return table.astype({"num_rollouts": "Int64", "horizon": "Int64"})


def evaluation_card(episodes: pd.DataFrame) -> dict[str, object]:
    keys = ["experiment", "planner", "num_rollouts", "horizon", "action_space", "object_size", "scene_num_objects"]
    keys.append("noise_level")
    rows = pd.DataFrame(episodes[keys]).drop_duplicates().to_dict("records")
    points = [{str(key): None if pd.isna(value) else value for key, value in row.items()} for row in rows]
    for point in points:
        point |= {"num_episodes": 10, "num_skipped": 3 if point["planner"] == "VisualRHP" else 0}
    return COLUMNS | {
        "points": points,
        "networks": {},
        "num_episodes": len(episodes),
        "wall_time_s": 61.0,
        "num_workers": 2,
    }


@pytest.fixture
def outputs(tmp_path: Path) -> Path:
    episodes = episodes_table()
    (tmp_path / "evaluate").mkdir()
    episodes.to_parquet(tmp_path / "evaluate" / "episodes.parquet", index=False)
    write_json(tmp_path / "evaluate" / "evaluation.json", evaluation_card(episodes))
    return tmp_path


def configure(outputs: Path, *overrides: str) -> ReportConfig:
    settings = ["scale=smoke", "tracking=none", "executor.num_workers=1", f"paths.outputs={outputs}"]
    return compose("report", ReportConfig, [*settings, *overrides])


def test_the_page_needs_nothing_but_itself(outputs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(outputs)
    curves = outputs / "train_rl" / "continuous" / "image" / "curves.csv"
    curves.parent.mkdir(parents=True)
    rows = {"network": "image", "iteration": [0, 1], "greedy/success_rate": [0.5, 0.7], "policy/kl": [np.nan, 0.01]}
    pd.DataFrame(rows).to_csv(curves, index=False)
    config = configure(outputs, "videos.planners=[kinodynamic_rrt]", "videos.num_objects=[1]", "videos.size_px=64")
    config = replace(config, paths=replace(config.paths, artefact=str(outputs / "report")))
    folder = make(config, outputs / "work")
    page = (folder / "index.html").read_text(encoding="utf-8")

    assert not re.findall(r"(?:https?:)?//[\w.-]+\.\w", page.split("<script>")[0])
    sources = re.findall(r'(?:src|href)="([^"]{0,40})', page)
    assert sources and all(source.startswith(("data:", "#")) for source in sources)
    for name in ("figure_7a", "figure_7b", "figure_8a", "figure_8b", "figure_9", "figure_10", "training_train_rl"):
        assert (folder / "figures" / f"{name}.svg").is_file() and (folder / "figures" / f"{name}.png").is_file()
    assert page.count("<svg") == 7
    videos = [base64.b64decode(data) for data in re.findall(r"data:video/webm;base64,([\w+/=]+)", page)]
    files = sorted((folder / "videos").glob("scene_*.webm"))
    assert len(videos) == len(files) == 2  # continuous and discrete
    assert {path.read_bytes() for path in files} == set(videos)
    assert len(read_video(files[0])) > 3
    assert (folder / "videos" / "comparison.webm").is_file()


def make(config: ReportConfig, work: Path) -> Path:
    """What the pipeline does between composing and publishing."""
    from pipelines.tracking import open_run

    with open_run(config, "report", "test") as run:
        return report.make_report(config, work, run)


def page_of(outputs: Path) -> str:
    config = configure(outputs, "videos.num_scenes=0")
    episodes, card = report.load_evaluation(Path(config.evaluation))
    named = report_page.episode_figures(episodes)
    return report_page.render(report.page_content(config, episodes, card, named, []))


def test_the_page_says_what_the_episodes_say(outputs: Path) -> None:
    text = re.sub(r"<style>.*?</style>|<svg.*?</svg>|<script>.*?</script>", "", page_of(outputs), flags=re.DOTALL)
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text))
    assert "VisualRHP 3x3 completes 90% of the tasks (65% to 98%) with continuous actions" in text
    assert "Greedy 50%" in text and "K.RRT 100%" in text
    # success [Wilson], efficiency of the nine completed tasks [t], time, decision, dropped, episodes
    row = "VisualRHP 3x3 continuous 90% 65–98 0.34 0.21–0.48 510 ms 510–510 ms 50 ms 10% 10"
    assert row in text
    assert "VisualRHP 3x3 with continuous actions has no network for some numbers of objects: 9 of 39 tasks" in text
    assert "0123456789" in text and "180" in text


def test_missing_or_damaged_episodes_are_one_clear_error(outputs: Path) -> None:
    with pytest.raises(DataError, match=r"no file episodes\.parquet; make it with python -m pipelines\.evaluate"):
        report.load_evaluation(outputs)
    path = outputs / "evaluate" / "episodes.parquet"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(DataError, match="damaged"):
        report.load_evaluation(outputs / "evaluate")
    episodes_table().drop(columns=["success"]).to_parquet(path)
    with pytest.raises(DataError, match="lacks the columns success"):
        report.load_evaluation(outputs / "evaluate")


def test_videos_need_the_networks_of_their_planners(outputs: Path) -> None:
    with pytest.raises(CheckpointError, match=r"heuristic\.safetensors"):
        report.video_tasks(configure(outputs, "videos.planners=[greedy]"))
    (first, *_) = report.video_tasks(configure(outputs, "videos.planners=[cartesian_rhp]"))
    filmed = report.film_task(first)
    assert (filmed.data, filmed.label) == (b"", "CartesianRHP 3x3: no network for 4 objects")


def test_small_tables_make_a_page_too(outputs: Path) -> None:
    """One planner, one setting: only the figures that make sense."""
    path = outputs / "evaluate" / "episodes.parquet"
    table = episodes_table()
    table = table.loc[
        (table["planner"] == "Greedy") & (table["noise_level"] == "none") & (table["object_size"] == "mixed")
    ]
    table = table.loc[table["action_space"] == "discrete"].assign(success=False, action_efficiency=np.nan)
    table.to_parquet(path, index=False)
    page = page_of(outputs)
    assert "Greedy completes 0% of the tasks" in page
    assert "Success rate by object size" not in page and "Success rate under noise" not in page
    assert page == page_of(outputs)
