"""Sweeps of a stage through Hydra's launchers: every job makes its artefact, with any launcher."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipelines.workflow.app import CONFIG_FOLDER

REPOSITORY = CONFIG_FOLDER.parent
STAGES_WITH_SWEEPS = ("generate_demos", "train_il", "train_rl", "evaluate", "report", "verify_demos", "export_demos")


def start(outputs: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pipelines.generate_demos", *arguments, f"paths.outputs={outputs}"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=120)


SWEEP = ("-m", "scale=smoke", "tracking=none", "executor.num_workers=1", "demonstrations.count=2", "seed=1,2")
SWEEP_WITHOUT_PICTURES = (*SWEEP, "video.num_scenes=0")


@pytest.mark.parametrize(
    "launcher",
    [
        ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"],
        ["hydra/launcher=submitit_local", "hydra.launcher.cpus_per_task=1"],
    ],
    ids=["joblib", "submitit_local"],
)
def test_a_sweep_makes_every_artefact(tmp_path: Path, launcher: list[str]) -> None:
    done = start(tmp_path, *SWEEP_WITHOUT_PICTURES, *launcher)
    assert done.returncode == 0, done.stderr[-2000:]
    cards = [json.loads(path.read_text()) for path in tmp_path.glob("sweeps/generate_demos/*/card.json")]
    assert sorted(card["seed"] for card in cards) == [1, 2]
    assert all(card["num_demonstrations"] == 2 for card in cards)


@pytest.mark.parametrize("launcher", ["sequential", "joblib", "submitit_local", "submitit_slurm"])
@pytest.mark.parametrize("stage", STAGES_WITH_SWEEPS)
def test_every_stage_composes_with_every_launcher(stage: str, launcher: str) -> None:
    from hydra import compose, initialize_config_dir

    with initialize_config_dir(version_base="1.3", config_dir=str(CONFIG_FOLDER)):
        config = compose(stage, [f"hydra/launcher={launcher}"], return_hydra_config=True)
    targets = {"sequential": "JoblibLauncher", "joblib": "JoblibLauncher"}
    targets |= {"submitit_local": "LocalLauncher", "submitit_slurm": "SlurmLauncher"}
    assert config.hydra.launcher._target_.endswith(targets[launcher])
    if launcher == "sequential":
        assert config.hydra.launcher.n_jobs == 1


def test_a_sweep_is_sequential_unless_told_otherwise() -> None:
    for stage in STAGES_WITH_SWEEPS:
        assert "override hydra/launcher: sequential" in (CONFIG_FOLDER / f"{stage}.yaml").read_text(), stage
