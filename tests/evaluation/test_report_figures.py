"""Which figures a report has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from tests.evaluation.samples import report_table, sample_table
from visualrhp.evaluation.report_figures import curve_figures, result_figures, sweep_figures


def stems(figures) -> list[str]:
    return [figure.stem for figure in figures]


def test_figures_7_to_10_where_there_are_episodes_for_them() -> None:
    table = report_table()
    found = result_figures(table)
    assert stems(found["environments"]) == ["figure_7a", "figure_7b", "figure_8a", "figure_8b", "figure_9"]
    assert stems(found["robustness"]) == ["figure_10"]
    assert found["robustness"][0].caption.endswith("Paper, Fig. 10.")
    noiseless = result_figures(table.loc[(table["noise_level"] == "none") & (table["object_size"] == "mixed")])
    assert stems(noiseless["environments"]) == ["figure_7a", "figure_8a", "figure_9"]
    assert not noiseless["robustness"]
    assert not result_figures(table.loc[table["object_size"] == "small"])["robustness"]


def test_curves_of_the_known_stages_are_drawn(tmp_path: Path) -> None:
    curves = tmp_path / "train_rl" / "continuous" / "image" / "curves.csv"
    curves.parent.mkdir(parents=True)
    rows = {"network": "image", "iteration": [0, 1], "greedy/success_rate": [0.5, 0.7], "policy/kl": [np.nan, 0.01]}
    pd.DataFrame(rows).to_csv(curves, index=False)
    folders = [tmp_path / name for name in ("train_il", "train_rl", "something_else")]
    (figure,) = curve_figures(folders)
    assert (figure.stem, figure.name) == ("training_train_rl", "Reinforcement learning")
    assert "(1)" in figure.caption


def test_sweeps_are_drawn_where_they_are_given(tmp_path: Path) -> None:
    assert sweep_figures(None, None) == []
    folder = tmp_path / "demos" / "10" / "evaluation" / "discrete"
    folder.mkdir(parents=True)
    sample_table({"success": number < 5} for number in range(40)).to_parquet(folder / "episodes.parquet")
    curves = tmp_path / "trials" / "baseline_step_True" / "seed_0" / "curves.csv"
    curves.parent.mkdir(parents=True)
    pd.DataFrame({"greedy/success_rate": [0.5], "collection/transitions": [0]}).to_csv(curves, index=False)
    figures = sweep_figures(tmp_path / "demos", tmp_path / "trials")
    assert stems(figures) == ["demonstrations", "stability"]
    assert "1 trials" in figures[1].caption
