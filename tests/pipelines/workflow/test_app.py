"""The command line: what mistakes lead to, and how fast it answers."""

from __future__ import annotations

import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pipelines.config import EvaluateConfig, ReportConfig, TrainRLConfig
from pipelines.workflow import app as app_module
from pipelines.workflow.app import app, command_line_overrides, compose, override_keys
from visualrhp.errors import ConfigError, DataError

STAGES = ("generate_demos", "train_il", "train_rl", "expert_iteration", "evaluate", "report")
SEGMENTER = ("generate_frames", "train_segmenter", "evaluate_segmenter")
PIPELINES = (
    *STAGES,
    *SEGMENTER,
    "play",
    "tune_crafted",
    "verify_demos",
    "export_demos",
    "execute",
    "evaluate_execution",
)
Run = Callable[..., tuple[int, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a pipeline's main function in an empty folder; returns its exit code and what it wrote to stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HYDRA_FULL_ERROR", raising=False)

    def call(main: str | Callable[[], None], *arguments: str) -> tuple[int, str]:
        function = importlib.import_module(f"pipelines.{main}").main if isinstance(main, str) else main
        monkeypatch.setattr(sys, "argv", ["pipeline", *arguments[:1], "tracking=none", *arguments[1:]])
        monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
        with pytest.raises(SystemExit) as ended:
            function()
        code = ended.value.code
        assert isinstance(code, int)
        return code, capsys.readouterr().err

    return call


@pytest.mark.parametrize(
    ("pipeline", "arguments", "words"),
    [
        ("train_il", ["learner.ephocs=3"], "There is no key learner.ephocs. Did you mean epochs?"),
        ("train_il", ["+learner.ephocs=3"], "There is no key learner.ephocs. Did you mean epochs?"),
        ("train_il", ["sede=3"], "There is no key sede. Did you mean seed?"),
        ("evaluate", ["planer=greedy"], "There is no key planer. Did you mean planner?"),
        ("evaluate", ["planner=gredy"], "planner=gredy is not known. Did you mean greedy?"),
        (
            "evaluate",
            ["+experiment=fig10"],
            "experiment already has a value: write experiment=fig10, without a plus sign.",
        ),
        ("evaluate", ["suite=nothing"], "suite=nothing is not known."),
        ("evaluate", ["scale=huge"], "scale=huge is not known. Choose from paper, quick, smoke."),
        ("train_rl", ["experiment=fig7"], "This pipeline has no group suite."),
        (
            "evaluate",
            ["scene.density=-1"],
            "scene.density=-1 is out of range: it should be a number, above 0 and",
        ),
        (
            "evaluate",
            ["planner.horizon=0"],
            "planner.horizon=0 is out of range: it should be an integer, at least 1.",
        ),
        ("evaluate", ["scene.num_objects=0"], "scene.num_objects=0 is out of range"),
        ("evaluate", ["noise_level=hihg"], "noise_level=hihg is not known: it should be none, low, medium or high."),
        ("evaluate", ["num_episodes=many"], "num_episodes=many has the wrong type: it should be an integer"),
        ("train_rl", ["learner.lr=fast"], "learner.lr=fast has the wrong type: it should be a number, above 0."),
        ("train_rl", ["learner=dqn"], "learner.algorithm=dqn learns in the discrete action space"),
        ("train_rl", ["device=tpu"], "device=tpu is not known: it should be cpu, cuda"),
        (
            "report",
            ["seed=-1"],
            "seed=-1 is out of range: it should be an integer, at least 0 and at most 9",
        ),
        ("report", ["seed=1,2"], "seed=1,2 lists several values, which is a sweep: add -m"),
        ("report", ["title=(a"], "The argument title=(a cannot be read"),
        ("play", ["scene_file=szenen/müller.yaml"], """'scene_file="szenen/müller.yaml"'."""),
        ("play", ["planner.name=a=b"], "The argument planner.name=a=b cannot be read"),
        ("play", ["planner.name=a&b"], "The argument planner.name=a&b cannot be read"),
        ("play", ["scene_file=~/a.yaml"], "The argument scene_file=~/a.yaml cannot be read"),
        ("play", ["planner.name='a"], "The argument planner.name='a cannot be read"),
        ("play", ["planner.name={a"], "The argument planner.name={a cannot be read"),
        ("play", ["=3"], "A group has a value that is not the name of one of its files"),
        ("play", ["scale=null"], "A group has a value that is not the name of one of its files"),
        ("play", ["planner=[a,b]"], "planner=b is not known"),
        ("play", ["paths.outputs=' '"], "paths.outputs=' ' is not the path of a folder"),
        ("play", ["paths.outputs="], "paths.outputs= is not the path of a folder"),
        ("play", ["paths.outputs='~/x'"], "paths.outputs='~/x' is not the path of a folder"),
        ("play", ["planner.name=' '"], "planner.name=' ' cannot be shown"),
        ("evaluate", ["seed=99999999999999999999"], "seed=99999999999999999999 is out of range"),
        ("report", ["training=[a/train_il,b/train_il]"], "several folders called train_il"),
        ("report", ["paths.artefact=outputs/work/x"], "belongs to the pipelines"),
        ("report", ["paths.artefact=outputs/mlflow.db"], "belongs to the pipelines"),
        ("play", ["paths.artefact=''"], "paths.artefact is empty"),
        ("train_il", ["device=cuda:99"], "device=cuda:99"),
        (
            "export_demos",
            ["dataset_id=../../thesis-v0"],
            "dataset_id=../../thesis-v0 is not a name of a Minari data set",
        ),
        ("export_demos", ["dataset_id=demos"], "dataset_id=demos is not a name of a Minari data set"),
        ("report", [f"seed={'x' * 5000}"], "seed=xxx"),
        ("report", ["executor=dask"], "executor.address is missing"),
        ("report", ["paths.artefact=???"], "paths.artefact"),
        (
            "train_il",
            ["observation=cartesian", "observation.num_objects=[]"],
            "observation.num_objects is empty",
        ),
        ("generate_demos", ["scene.num_objects=[5,2]"], "num_objects=[5, 2]"),
        ("train_il", ["scale=smoke"], "outputs/generate_demos/continuous"),
        ("train_rl", ["scale=smoke"], "outputs/train_il/continuous/image/heuristic.safetensors"),
        ("expert_iteration", ["scale=smoke"], "outputs/train_rl/continuous/image/heuristic.safetensors"),
        ("expert_iteration", ["learner.rounds=0"], "learner.rounds=0 is out of range"),
        ("expert_iteration", ["planner=greedy"], "planner"),
        ("evaluate", ["scale=smoke"], "outputs/train_rl/continuous/image/heuristic.safetensors"),
        ("report", ["scale=smoke"], "outputs/evaluate"),
        ("play", ["live=maybe"], "live=maybe is not known: it should be auto, true or false."),
        ("play", ["video.size_px=20"], "video.size_px=20 is out of range: it should be an integer, at least 64"),
        (
            "play",
            ["video.label_image=insert"],
            "insert is not known: it should be none, panel or inset",
        ),
        ("play", ["index=-1"], "index=-1 is out of range"),
        ("play", ["planner.num_rollouts=0"], "planner.num_rollouts=0 is out of range"),
        ("play", ["scene.num_objects=[5,2]"], "num_objects=[5, 2]"),
        ("evaluate", ["planner=visual_rhp_plus"], "outputs/expert_iteration/continuous/image/heuristic.safetensors"),
        ("play", ["heuristics=outputs/train_il"], "outputs/train_il/continuous/image/heuristic.safetensors does not"),
        ("play", ["planner=cartesian_rhp", "scene.num_objects=8"], "heuristic_m8.safetensors does not exist"),
        ("tune_crafted", ["planner=greedy"], "has no handcrafted heuristic, whose weights are searched"),
        ("tune_crafted", ["action_space=discrete"], "action_space has no effect here"),
        ("tune_crafted", ["scene.num_objects=[5,2]"], "num_objects=[5, 2]"),
    ],
)
def test_a_mistake_is_one_paragraph_and_no_work(
    run: Run, tmp_path: Path, pipeline: str, arguments: list[str], words: str
) -> None:
    code, message = run(pipeline, *arguments)
    assert words in message
    assert code == 2
    assert message.startswith("Error: ")
    assert message.count("\n") == 1, "one paragraph"
    assert len(message) < 2000
    made = {path.name for path in tmp_path.glob("outputs/*")}
    assert made <= {"hydra", "work"}


@pytest.mark.parametrize("text", ["a: [1\n", "a: b: c\n", "\ta: 1\n", "a: 1\na: 2\n"])
def test_a_configuration_file_with_a_mistake_is_named(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    conf = tmp_path / "conf"
    shutil.copytree(app_module.CONFIG_FOLDER, conf)
    (conf / "planner" / "greedy.yaml").write_text(text)
    monkeypatch.setattr(app_module, "CONFIG_FOLDER", conf)
    code, message = run("evaluate", "planner=greedy")
    assert code == 2
    assert "planner/greedy.yaml" in message and "line" in message


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError(13, "Permission denied", "outputs/a"), "outputs/a: Permission denied; make it accessible"),
        (OSError(28, "No space left on device"), "no space left on a disk"),
        (OSError(30, "Read-only file system", "a"), "a: Read-only file system"),
    ],
)
def test_an_error_of_the_system_is_one_paragraph(run: Run, error: OSError, words: str) -> None:
    @app("report")
    def main(config: ReportConfig) -> None:
        raise error

    code, message = run(main)
    assert code == 2
    assert words in message and message.count("\n") == 1


def test_jobs_of_a_sweep_do_not_share_an_artefact(run: Run) -> None:
    folders = []

    @app("report")
    def main(config: ReportConfig) -> None:
        folders.append(config.paths.artefact)

    assert run(main, "-m", "evaluation=nets/a/b,nets/a_b,nets/a?b")[0] == 0
    assert len({Path(folder).name for folder in folders}) == 3
    code, message = run(main, "-m", "seed=0,1", "paths.sweep=here")
    assert code == 2
    assert message.count("Two jobs of the sweep would write their results to here") == 1


def test_every_failure_of_a_sweep_is_reported(run: Run) -> None:
    @app("report")
    def main(config: ReportConfig) -> None:
        if config.seed:
            raise DataError(f"no data for seed {config.seed}")

    code, message = run(main, "-m", "seed=0,1,2")
    assert code == 2
    assert [message.count(f"Error: no data for seed {seed}") for seed in range(3)] == [0, 1, 1]
    assert "The job seed=2 failed.\nError: no data for seed 2\n" in message


def test_a_configuration_file_of_another_encoding_is_named(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    conf = tmp_path / "conf"
    shutil.copytree(app_module.CONFIG_FOLDER, conf)
    monkeypatch.setattr(app_module, "CONFIG_FOLDER", conf)
    (conf / "planner" / "greedy.yaml").write_bytes(b"# f\xfcr\n")
    code, message = run("evaluate", "planner=greedy")
    assert code == 2 and "greedy.yaml is not UTF-8" in message


def test_an_error_of_the_task_is_one_paragraph(run: Run) -> None:
    @app("report")
    def main(config: ReportConfig) -> None:
        raise DataError(f"{config.evaluation} is\n  damaged")

    assert run(main) == (2, "Error: outputs/evaluate is damaged\n")


def test_ctrl_c_is_130(run: Run) -> None:
    @app("report")
    def main(config: ReportConfig) -> None:
        raise KeyboardInterrupt

    code, message = run(main)
    assert code == 130
    assert "rerun the command to resume" in message


def test_sigterm_is_143(run: Run) -> None:
    @app("report")
    def main(config: ReportConfig) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)

    code, message = run(main)
    assert code == 143
    assert "rerun the command to resume" in message


def test_a_defect_keeps_its_traceback(run: Run) -> None:
    @app("report")
    def main(config: ReportConfig) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(main)


def test_a_sweep_runs_every_job_in_a_separate_folder(run: Run) -> None:
    seen: list[tuple[float, str, list[str]]] = []

    @app("train_rl")
    def main(config: TrainRLConfig) -> None:
        seen.append((config.learner.lr, config.paths.artefact, command_line_overrides()))

    code, _ = run(main, "-m", "learner.lr=0.1,0.2", "seed=4")
    assert code == 0
    assert [lr for lr, *_ in seen] == [0.1, 0.2]
    folders = [folder for _, folder, _ in seen]
    assert folders == [f"outputs/sweeps/train_rl/learner.lr={lr},seed=4" for lr in (0.1, 0.2)]
    assert seen[0][2] == ["tracking=none", "learner.lr=0.1", "seed=4"]
    assert command_line_overrides() == []


def test_a_mistake_in_a_sweep_is_an_error(run: Run) -> None:
    @app("train_rl")
    def main(config: TrainRLConfig) -> None:
        pass

    code, message = run(main, "-m", "learner.lr=0.1,-1")
    assert code == 2
    assert message.endswith("Error: learner.lr=-1 is out of range: it should be a number, above 0.\n")


def test_the_folder_of_an_experiment_is_used_in_its_sweep(run: Run) -> None:
    folders: list[str] = []

    @app("train_rl")
    def main(config: TrainRLConfig) -> None:
        folders.append(config.paths.artefact)

    assert run(main, "experiment=fig6", "hydra.sweeper.params.seed='0,1'")[0] == 0
    expected = [f"outputs/fig6/baseline_step_{step}/seed_{seed}" for step in (True, False) for seed in (0, 1)]
    assert folders == expected


def test_compose_raises_what_is_wrong() -> None:
    with pytest.raises(ConfigError, match=r"There is no key scene.densty. Did you mean density\?"):
        compose("evaluate", EvaluateConfig, ["scene.densty=2"])


def test_override_keys() -> None:
    assert override_keys(["a.b=1", "+c=d=e", "~f", "++g=1", "h@i=j"]) == {"a.b", "c", "f", "g", "h"}


ASK_ALL = """
import contextlib, runpy, sys
pipelines, question = sys.argv[1].split(","), sys.argv[2:]
for pipeline in pipelines:
    sys.argv = [pipeline, *question]
    with contextlib.suppress(SystemExit):
        runpy.run_module(f"pipelines.{pipeline}", run_name="__main__", alter_sys=True)
    print("IMPORTED", *sys.modules)
"""


@pytest.mark.parametrize("question", [["--help"], ["--cfg", "job"]], ids=["help", "cfg"])
def test_questions_are_answered_without_heavy_imports(question: list[str]) -> None:
    """How long it takes is for the benchmarks; that nothing slow is imported can be told exactly.

    One process answers for all pipelines, one after another.
    """
    repository = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        [sys.executable, "-c", ASK_ALL, ",".join(PIPELINES), *question],
        cwd=repository,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    heavy = {"torch", "torchrl", "optuna", "mlflow", "pandas", "scipy", "matplotlib", "cv2", "dvc", "pymunk", "pyarrow"}
    heavy |= {"shapely", "pydantic", "numpy", "gymnasium"}
    answers = re.findall(r"(.*?)^IMPORTED (.*?)$", done.stdout, re.MULTILINE | re.DOTALL)
    for pipeline, (answer, imported) in zip(PIPELINES, answers, strict=True):
        assert "action_space:" in answer, pipeline
        assert not heavy & set(imported.split()), pipeline
