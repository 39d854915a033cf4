"""Tables of Fig. 5 and 6 from folders."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.evaluation.samples import sample_table
from visualrhp.errors import DataError
from visualrhp.evaluation.sweeps import demonstration_batches, stability_trials


def test_demonstrations_are_averaged_over_batches_of_20_tasks(tmp_path: Path):
    folder = tmp_path / "100" / "evaluation" / "discrete"
    folder.mkdir(parents=True)
    table = sample_table({"episode": number, "success": number < 25} for number in reversed(range(40)))
    table.to_parquet(folder / "episodes.parquet", index=False)
    batches = demonstration_batches(tmp_path)
    assert batches.to_dict("records") == [
        {"action_space": "discrete", "num_demonstrations": 100, "success_rate": 1.0},
        {"action_space": "discrete", "num_demonstrations": 100, "success_rate": 0.25},
    ]


def test_trials_are_read_with_their_algorithm(tmp_path: Path):
    for step, rate in ((True, 0.75), (False, 0.25)):
        folder = tmp_path / f"baseline_step_{step}" / "seed_3"
        folder.mkdir(parents=True)
        curves = pd.DataFrame(
            {"greedy/success_rate": [0.5, np.nan, rate], "collection/transitions": [np.nan, 100.0, 200.0]}
        )
        curves.to_csv(folder / "curves.csv", index=False)
    trials = stability_trials(tmp_path)
    assert trials.to_dict("records") == [
        {"algorithm": "PPO", "trial": "seed_3", "transitions": 0.0, "success_rate": 0.5},
        {"algorithm": "PPO", "trial": "seed_3", "transitions": 200.0, "success_rate": 0.25},
        {"algorithm": "C3PO", "trial": "seed_3", "transitions": 0.0, "success_rate": 0.5},
        {"algorithm": "C3PO", "trial": "seed_3", "transitions": 200.0, "success_rate": 0.75},
    ]


def test_a_sweep_without_a_finished_job_is_named(tmp_path: Path):
    with pytest.raises(DataError, match=r"sweeps\.demonstrations=.*conf/experiment/fig5_evaluation\.yaml"):
        demonstration_batches(tmp_path)
    with pytest.raises(DataError, match=r"sweeps\.stability=.*conf/experiment/fig6\.yaml"):
        stability_trials(tmp_path)


@pytest.mark.parametrize("place", ["many/evaluation/discrete", "1e3/evaluation/discrete", "100/evaluation/both"])
def test_a_table_in_a_folder_of_another_name_is_named(tmp_path: Path, place: str):
    folder = tmp_path / place
    folder.mkdir(parents=True)
    sample_table([{}]).to_parquet(folder / "episodes.parquet", index=False)
    with pytest.raises(DataError, match=r"episodes\.parquet is not in a folder <number of demonstrations>/evaluation/"):
        demonstration_batches(tmp_path)


def test_damaged_files_of_a_sweep_are_named(tmp_path: Path):
    table = tmp_path / "100" / "evaluation" / "discrete" / "episodes.parquet"
    curves = tmp_path / "baseline_step_True" / "seed_3" / "curves.csv"
    for path in (table, curves):
        path.parent.mkdir(parents=True)
        path.symlink_to(tmp_path / "nowhere")
    with pytest.raises(DataError, match=r"episodes\.parquet is a link"):
        demonstration_batches(tmp_path)
    with pytest.raises(DataError, match=r"curves\.csv is a link"):
        stability_trials(tmp_path)
    curves.unlink()
    for content in (
        "a,b\n1,2\n",
        "greedy/success_rate,collection/transitions\n,1\n",
        "greedy/success_rate,collection/transitions\nx,1\n",
    ):
        curves.write_text(content)
        with pytest.raises(DataError, match=r"curves\.csv"):
            stability_trials(tmp_path)
