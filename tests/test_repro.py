"""The whole pipeline at smoke scale, by DVC, in a copy of the repository; then every experiment of the paper."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pipelines.workflow import artefacts

ROOT = Path(__file__).parents[1]
LESS = {
    "report": ["videos.num_scenes=0"],
    "train_il": ["video.num_scenes=0"],
    "train_rl": ["video.num_scenes=0", "hydra.sweeper.params.seed='0,1'"],  # of five
}
"""Overrides of experiments that leave out what only repeats."""
EXPERIMENTS = ["fig5", "fig6", "fig7", "fig8", "fig9", "fig10"]


def run(command: list[str], folder: Path) -> str:
    # The copy's modules come before the installed ones; its environment is this one's.
    environment = {
        **os.environ,
        "PYTHONPATH": str(folder),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "DVC_NO_ANALYTICS": "true",
    }
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, f"{' '.join(command)}\n{result.stdout[-3000:]}\n{result.stderr[-3000:]}"
    return result.stdout


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The repository's files, as git or an unpacked archive has them, with the pipeline run once at smoke scale.

    Stages use one worker here, and two when they make the same bytes again. One copy serves all tests of this module:
    pytest-xdist has to keep files together (--dist loadfile).
    """
    folder = tmp_path_factory.mktemp("repository")
    for name in ("conf", "pipelines", "visualrhp"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("dvc.yaml", "params.yaml", "pyproject.toml", ".dvcignore"):
        shutil.copy(ROOT / name, folder)
    parameters = (folder / "params.yaml").read_text(encoding="utf-8")
    for old, new in (("scale: quick", "scale: smoke"), ('every_stage: ""', "every_stage: executor.num_workers=1")):
        assert old in parameters
        parameters = parameters.replace(old, new)
    (folder / "params.yaml").write_text(parameters, encoding="utf-8")
    run(["dvc", "init", "--no-scm", "--quiet"], folder)
    run(["dvc", "repro"], folder)
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def run_here(copy: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Runs a pipeline in the copy, in this process: importing everything would take longer than the work."""
    # The copy has no commit to write into cards.
    monkeypatch.setattr(artefacts, "git_commit", lambda: None)
    monkeypatch.chdir(copy)

    def run_pipeline(stage: str, *arguments: str) -> None:
        monkeypatch.setattr(sys, "argv", [stage, *arguments])
        with pytest.raises(SystemExit) as end:
            importlib.import_module(f"pipelines.{stage}").main()
        assert not end.value.code

    return run_pipeline


def test_everything_is_made_and_nothing_is_made_twice(copy: Path) -> None:
    made = [
        "generate_demos/continuous/card.json",
        "train_il/discrete/cartesian/heuristic_m1.safetensors",
        "train_rl/continuous/image/heuristic.safetensors",
        "expert_iteration/discrete/image/heuristic.safetensors",
        "evaluate/episodes.parquet",
        "report/index.html",
        "mlflow.db",
    ]
    assert [name for name in made if not (copy / "outputs" / name).is_file()] == []
    assert "Running stage" not in run(["dvc", "repro"], copy)
    assert "success_rate" in run(["dvc", "metrics", "show"], copy)


@pytest.mark.parametrize(
    ("stage", "observations"),
    [
        ("generate_demos", None),
        ("train_il", "image,cartesian"),
        ("train_rl", "image,cartesian"),
        ("expert_iteration", "image"),
    ],
)
def test_every_stage_makes_the_same_bytes_again(
    copy: Path, run_here: Callable[..., None], stage: str, observations: str | None
) -> None:
    """All but evaluation and report, which hold times; tests/pipelines/test_evaluate.py compares outcomes."""
    overrides = ["scale=smoke", "tracking=none", "executor.num_workers=2", "action_space=continuous,discrete"]
    again = f"paths.sweep=again/{stage}/${{action_space.name}}"
    if observations is not None:
        overrides.append(f"observation={observations}")
        again += "/${observation.name}"
    run_here(stage, "--multirun", *overrides, again)
    assert files(copy / "again" / stage) == files(copy / "outputs" / stage)


def files(folder: Path) -> dict[str, bytes]:
    """Content of every file in ``folder``, by its path in it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_experiment_runs_by_its_own_first_line(run_here: Callable[..., None], experiment: str) -> None:
    lines = (ROOT / "conf" / "experiment" / f"{experiment}.yaml").read_text(encoding="utf-8").splitlines()
    command = next(line.removeprefix("# ") for line in lines if line.startswith("# python -m pipelines."))
    for part in command.split(" && "):
        python, option, module, *overrides = part.split()
        assert (python, option) == ("python", "-m")
        stage = module.removeprefix("pipelines.")
        run_here(stage, *overrides, "scale=smoke", "tracking=none", "executor.num_workers=1", *LESS.get(stage, ()))
