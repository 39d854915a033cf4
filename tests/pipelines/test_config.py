"""Everything in ``conf/`` composes, fits its schema, and agrees with the library."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipelines.config import (
    C3POLearnerConfig,
    DQNLearnerConfig,
    EvaluateConfig,
    ExportDemosConfig,
    GenerateDemosConfig,
    KinodynamicRRTConfig,
    PipelineConfig,
    PlayConfig,
    RecedingHorizonConfig,
    ReportConfig,
    TrainILConfig,
    TrainRLConfig,
    TuneCraftedConfig,
    VerifyDemosConfig,
    suite_overrides,
)
from pipelines.workflow.app import CONFIG_FOLDER, compose

SCHEMAS: dict[str, type[PipelineConfig]] = {
    "generate_demos": GenerateDemosConfig,
    "train_il": TrainILConfig,
    "train_rl": TrainRLConfig,
    "evaluate": EvaluateConfig,
    "report": ReportConfig,
    "play": PlayConfig,
    "tune_crafted": TuneCraftedConfig,
    "verify_demos": VerifyDemosConfig,
    "export_demos": ExportDemosConfig,
}
NO_STAGE = {"play", "tune_crafted", "verify_demos", "export_demos"}  # nothing depends on what they make
SCALES = ("smoke", "quick", "paper")
EXPERIMENTS = {
    "fig5": "train_il",
    "fig5_evaluation": "evaluate",
    "fig6": "train_rl",
    "fig7": "evaluate",
    "fig8": "evaluate",
    "fig9": "evaluate",
    "fig10": "evaluate",
}
REPOSITORY = CONFIG_FOLDER.parent


def options(group: str) -> list[str]:
    return sorted(path.stem for path in (CONFIG_FOLDER / group).glob("*.yaml"))


@pytest.mark.parametrize(("pipeline", "scale"), list(itertools.product(SCHEMAS, SCALES)))
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_every_pipeline_composes_at_every_scale(pipeline: str, scale: str, action_space: str) -> None:
    config = compose(pipeline, SCHEMAS[pipeline], [f"scale={scale}", f"action_space={action_space}"])
    assert config.scale["name"] == scale
    assert config.action_space.name == action_space
    assert config.paths.artefact.startswith("outputs/")


def test_every_file_of_every_group_composes() -> None:
    for planner in options("planner"):
        assert compose("evaluate", EvaluateConfig, [f"planner={planner}"]).planner.name
    for suite in options("suite"):
        assert compose("evaluate", EvaluateConfig, [f"suite={suite}"]).suite
    for observation in options("observation"):
        config = compose("train_il", TrainILConfig, [f"observation={observation}"])
        assert config.observation.name == observation
    for executor in options("executor"):
        config = compose("report", ReportConfig, [f"executor={executor}", "executor.address=tcp://127.0.0.1:8786"])
        assert config.executor.name == executor
    for tracking in options("tracking"):
        assert compose("report", ReportConfig, [f"tracking={tracking}"]).tracking.name == tracking
    for learner in options("learner"):
        pipeline = "train_il" if learner.startswith("imitation") else "train_rl"
        space = "discrete" if learner in ("imitation_discrete", "reinforcement_discrete", "dqn") else "continuous"
        compose(pipeline, SCHEMAS[pipeline], [f"learner={learner}", f"action_space={space}"])


@pytest.mark.parametrize("experiment", options("experiment"))
@pytest.mark.parametrize("scale", SCALES)
def test_every_experiment_composes_and_says_how_to_run_it(experiment: str, scale: str) -> None:
    pipeline = EXPERIMENTS[experiment]
    config = compose(pipeline, SCHEMAS[pipeline], [f"experiment={experiment}", f"scale={scale}"])
    package, command = (CONFIG_FOLDER / "experiment" / f"{experiment}.yaml").read_text().splitlines()[:2]
    assert package == "# @package _global_"
    assert f"python -m pipelines.{pipeline} experiment={experiment}" in command
    folder = config.paths.sweep or config.paths.artefact
    assert folder != f"outputs/{pipeline}", "an experiment must not replace what DVC made"


def test_there_is_an_experiment_for_every_figure_of_results() -> None:
    assert {f"fig{number}" for number in range(5, 11)} <= set(options("experiment"))


def test_the_figures_have_what_the_paper_shows() -> None:
    def settings(experiment: str) -> list[dict[str, str]]:
        suite = compose("evaluate", EvaluateConfig, [f"experiment={experiment}", "scale=paper"]).suite
        assert suite is not None
        return [dict(override.split("=") for override in overrides) for overrides in suite_overrides(suite)]

    ablation = {"visual_rhp", "visual_rhp_6x6", "cartesian_rhp", "crafted_heuristic_rhp", "greedy"}
    for experiment in ("fig7", "fig8"):
        by_num_objects = [s for s in settings(experiment) if s["scene.num_objects"] in "1234567"]
        found = {(s["planner"], s["action_space"], s["scene.num_objects"]) for s in by_num_objects}
        assert found >= set(itertools.product(ablation, ("discrete", "continuous"), "1234567"))
        by_size = [s for s in settings(experiment) if s["scene.num_objects"] == "[1,7]"]
        found = {(s["planner"], s["action_space"], s.get("scene.object_size", "mixed")) for s in by_size}
        assert found >= set(itertools.product(ablation, ("discrete", "continuous"), ("small", "mixed", "large")))
    found = {(s["planner"], s["action_space"]) for s in settings("fig9")}
    assert found == set(itertools.product(ablation | {"kinodynamic_rrt"}, ("discrete", "continuous")))
    found = {(s["planner"], s.get("noise_level", "none"), s["scene.num_objects"]) for s in settings("fig10")}
    planners = ("visual_rhp", "cartesian_rhp", "greedy", "kinodynamic_rrt")
    assert found == set(itertools.product(planners, ("none", "low", "medium", "high"), "1234567"))
    assert {s["action_space"] for s in settings("fig10")} == {"continuous"}


# -------------------------------------------------- agreement with the paper
def test_the_paper_scale_is_the_paper() -> None:
    """Sec. 7.4 and 7.5, number by number."""
    for space in ("discrete", "continuous"):
        overrides = ["scale=paper", f"action_space={space}"]
        assert compose("generate_demos", GenerateDemosConfig, overrides).demonstrations.count == 14_000
        imitation = compose("train_il", TrainILConfig, overrides).learner
        assert (imitation.batch_size, imitation.lr, imitation.discount) == (2000, 1e-4, 0.995)
        assert imitation.lr_schedule == "constant"
    discrete = asdict(compose("train_il", TrainILConfig, ["scale=paper", "action_space=discrete"]).learner)
    assert (discrete["margin_actions"], discrete["margin_cost"]) == (3, 1.0)
    continuous = asdict(compose("train_il", TrainILConfig, ["scale=paper", "action_space=continuous"]).learner)
    assert continuous["likelihood_coefficient"] == 0.5
    assert (continuous["value_coefficient"], continuous["entropy_coefficient"]) == (0.7, 0.01)

    dqn = compose("train_rl", TrainRLConfig, ["scale=paper", "action_space=discrete"]).learner
    assert isinstance(dqn, DQNLearnerConfig)
    assert (dqn.batch_size, dqn.lr, dqn.discount, dqn.num_envs) == (2000, 1e-5, 0.995, 10)
    assert (dqn.epsilon, dqn.num_rollouts, dqn.horizon) == (0.2, 3, 3)
    assert (dqn.buffer_size, dqn.collected, dqn.epochs) == (500_000, 2000, 3)
    assert dqn.target_update_interval is None
    c3po = compose("train_rl", TrainRLConfig, ["scale=paper"]).learner
    assert isinstance(c3po, C3POLearnerConfig)
    assert (c3po.batch_size, c3po.lr, c3po.discount, c3po.num_envs) == (2000, 1e-5, 0.995, 10)
    assert (c3po.clip_epsilon, c3po.buffer_size) == (0.075, 10_000)
    coefficients = (c3po.value_coefficient, c3po.entropy_coefficient, c3po.baseline_value_coefficient)
    assert coefficients == (0.7, 0.1, 0.35)
    assert (c3po.baseline_epochs, c3po.policy_epochs, c3po.gae_lambda) == (20, 15, 0.0)

    evaluation = compose("evaluate", EvaluateConfig, ["scale=paper"])
    assert evaluation.num_episodes == 300
    cartesian = compose("train_il", TrainILConfig, ["scale=paper", "observation=cartesian"]).observation
    assert cartesian.num_objects == (1, 2, 3, 4, 5, 6, 7)


def test_the_planners_are_those_of_the_paper() -> None:
    sizes = {"visual_rhp": (3, 3), "visual_rhp_6x6": (6, 6), "cartesian_rhp": (3, 3), "crafted_heuristic_rhp": (8, 4)}
    for name, size in sizes.items():
        planner = compose("evaluate", EvaluateConfig, [f"planner={name}"]).planner
        assert isinstance(planner, RecedingHorizonConfig)
        assert (planner.num_rollouts, planner.horizon) == size
    planner = compose("evaluate", EvaluateConfig, ["planner=kinodynamic_rrt"]).planner
    assert isinstance(planner, KinodynamicRRTConfig)
    assert (planner.num_children, planner.time_limit_s) == (8, 180.0)


# -------------------------------------------------- agreement with the library
def library_groups() -> Iterator[tuple[str, Any, Any, set[str]]]:
    """(name, library's dataclass, config's content, keys that are the pipeline's own)."""
    from visualrhp.heuristics.crafted import CostToGo
    from visualrhp.learning.c3po import C3POConfig
    from visualrhp.learning.dqn import DQNConfig
    from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT
    from visualrhp.scene import SceneDistribution
    from visualrhp.simulation import Physics

    evaluate = compose("evaluate", EvaluateConfig, ["scale=paper"])
    yield "scene", SceneDistribution, asdict(evaluate.scene), set()
    yield "physics", Physics, asdict(evaluate.physics), set()
    planner = compose("generate_demos", GenerateDemosConfig, ["scale=paper"]).planner
    yield "kinodynamic_rrt", KinodynamicRRT, asdict(planner), {"algorithm", "name"}
    crafted = compose("evaluate", EvaluateConfig, ["planner=crafted_heuristic_rhp"]).planner
    yield "crafted", CostToGo, asdict(crafted)["heuristic"], {"kind"}
    dqn = compose("train_rl", TrainRLConfig, ["scale=paper", "action_space=discrete"]).learner
    own = {"algorithm", "iterations", "num_envs", "num_rollouts", "horizon", "temperature"}
    yield "dqn", DQNConfig, asdict(dqn), own
    c3po = compose("train_rl", TrainRLConfig, ["scale=paper"]).learner
    yield "c3po", C3POConfig, asdict(c3po), {"algorithm", "iterations", "num_envs"}


def test_configuration_and_library_have_the_same_names_and_defaults() -> None:
    for name, library, content, own in library_groups():
        defaults = {field.name: field.default for field in fields(library)}
        assert set(content) - own == set(defaults), name
        assert {key: content[key] for key in defaults} == defaults, name


# -------------------------------------------------- nothing is unused
def test_every_value_of_a_scale_is_used() -> None:
    text = "\n".join(path.read_text() for path in CONFIG_FOLDER.rglob("*.yaml") if path.parent.name != "scale")
    used = {
        re.sub(r"\$\{[\w.]+\}", "*", match)  # one of the choices
        for match in re.findall(r"\$\{scale\.((?:[\w.]|\$\{[\w.]+\})+)\}", text)
    }
    choices = ({"discrete", "continuous"}, {"image", "cartesian"})

    def leaves(content: Any, prefix: str = "") -> Iterator[str]:
        for key, value in content.items():
            name = prefix + ("*" if set(content) in choices else key)
            if isinstance(value, dict):
                yield from leaves(value, f"{name}.")
            else:
                yield name

    contents = [
        set(leaves(yaml.safe_load((CONFIG_FOLDER / "scale" / f"{scale}.yaml").read_text()))) for scale in SCALES
    ]
    assert contents[0] == contents[1] == contents[2], "the scales have the same keys"
    assert contents[0] - {"name"} == used


def test_every_key_is_read_by_some_code() -> None:
    """Every field of every configuration class is named somewhere in the pipelines, or belongs to a mirrored class."""
    import pipelines.config as module

    mirrored = {"SceneConfig", "PhysicsConfig", "KinodynamicRRTConfig", "CraftedHeuristicConfig"}
    mirrored |= {"DQNLearnerConfig", "C3POLearnerConfig", "QImitationConfig", "ActorCriticImitationConfig"}
    paths = [path for path in (REPOSITORY / "pipelines").glob("*.py") if path.name != "config.py"]
    code = "\n".join(path.read_text() for path in paths)
    for name, schema in vars(module).items():
        if not name.endswith("Config") or name in mirrored or not isinstance(schema, type):
            continue
        for field in fields(schema):
            assert re.search(rf"\b{field.name}\b", code), f"nobody reads {name}.{field.name}"


# -------------------------------------------------- suites
def test_suite_overrides_are_the_product_within_each_block() -> None:
    suite = {
        "a": {"planner": ["greedy", "visual_rhp"], "scene.num_objects": [1, [1, 7]]},
        "b": {"seed": 3, "x": [None, True]},
    }
    assert suite_overrides(suite) == [
        ["planner=greedy", "scene.num_objects=1"],
        ["planner=greedy", "scene.num_objects=[1,7]"],
        ["planner=visual_rhp", "scene.num_objects=1"],
        ["planner=visual_rhp", "scene.num_objects=[1,7]"],
        ["seed=3", "x=null"],
        ["seed=3", "x=true"],
    ]
    assert suite_overrides({"a": {"planner": ["greedy"], "scene.num_objects": []}}) == []


def test_a_number_of_objects_may_be_one_number() -> None:
    assert compose("evaluate", EvaluateConfig, ["scene.num_objects=4"]).scene.num_objects == (4, 4)


# -------------------------------------------------- DVC
def test_the_stages_of_dvc_depend_on_files_that_exist() -> None:
    stages = yaml.safe_load((REPOSITORY / "dvc.yaml").read_text())["stages"]
    assert list(stages) == [pipeline for pipeline in SCHEMAS if pipeline not in NO_STAGE]
    for stage in stages.values():
        for path in stage.get("do", stage)["deps"]:
            pattern = re.sub(r"\$\{[\w.]+\}", "*", path)
            if not pattern.startswith("outputs/"):
                assert list(REPOSITORY.glob(pattern)), f"dvc.yaml depends on {path}, which is not there"


def test_only_evaluation_and_report_depend_on_the_planners() -> None:
    stages = yaml.safe_load((REPOSITORY / "dvc.yaml").read_text())["stages"]
    depending = [name for name, stage in stages.items() if "conf/planner" in stage.get("do", stage)["deps"]]
    assert depending == ["evaluate", "report"]
    assert Path("conf/planner/kinodynamic_rrt.yaml").as_posix() in stages["generate_demos"]["do"]["deps"]
