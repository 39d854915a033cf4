"""Everything in ``conf/`` composes, fits its schema, and agrees with the library."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import MISSING, asdict, fields, is_dataclass
from typing import Any

import pytest
import yaml

from pipelines.config import (
    C3POLearnerConfig,
    CalibrateCameraConfig,
    DQNLearnerConfig,
    EvaluateConfig,
    EvaluateExecutionConfig,
    EvaluateSegmenterConfig,
    ExecuteConfig,
    ExpertIterationConfig,
    ExportDemosConfig,
    GenerateDemosConfig,
    GenerateFramesConfig,
    KinodynamicRRTConfig,
    PipelineConfig,
    PlayConfig,
    RecedingHorizonConfig,
    ReportAblationConfig,
    ReportConfig,
    ReportExecutionConfig,
    TrainILConfig,
    TrainRLConfig,
    TrainSegmenterConfig,
    TuneCraftedConfig,
    VerifyDemosConfig,
    suite_overrides,
)
from pipelines.planners import parameters_of
from pipelines.workflow.app import CONFIG_FOLDER, compose
from visualrhp.heuristics.crafted import CostToGo, CraftedHeuristic
from visualrhp.planning import RecedingHorizon
from visualrhp.planning.decision_task import RecedingHorizonParameters
from visualrhp.planning.receding_horizon import PLUS_OPTIONS

SCHEMAS: dict[str, type[PipelineConfig]] = {
    "generate_demos": GenerateDemosConfig,
    "train_il": TrainILConfig,
    "train_rl": TrainRLConfig,
    "expert_iteration": ExpertIterationConfig,
    "evaluate": EvaluateConfig,
    "report": ReportConfig,
    "play": PlayConfig,
    "tune_crafted": TuneCraftedConfig,
    "verify_demos": VerifyDemosConfig,
    "export_demos": ExportDemosConfig,
    "generate_frames": GenerateFramesConfig,
    "train_segmenter": TrainSegmenterConfig,
    "evaluate_segmenter": EvaluateSegmenterConfig,
    "calibrate_camera": CalibrateCameraConfig,
    "execute": ExecuteConfig,
    "evaluate_execution": EvaluateExecutionConfig,
    "report_execution": ReportExecutionConfig,
    "report_ablation": ReportAblationConfig,
}
NO_STAGE = {
    "calibrate_camera",
    "play",
    "tune_crafted",
    "verify_demos",
    "export_demos",
    "execute",
    "evaluate_execution",
    "report_execution",
    "report_ablation",
}  # nothing depends on what they make
SCALES = ("smoke", "quick", "paper")
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
    for cell in options("cell"):
        overrides = [f"cell={cell}", "segmenter=released", "desired=orange"]
        assert compose("execute", ExecuteConfig, overrides).cell.name == cell
    for segmenter in options("segmenter"):
        overrides = [f"segmenter={segmenter}", "segmenter.file=network.onnx"]
        assert compose("evaluate_execution", EvaluateExecutionConfig, overrides).segmenter.file
    for learner in options("learner"):
        pipeline = "train_il" if learner.startswith("imitation") else "train_rl"
        pipeline = "expert_iteration" if learner == "expert_iteration" else pipeline
        space = "discrete" if learner in ("imitation_discrete", "reinforcement_discrete", "dqn") else "continuous"
        compose(pipeline, SCHEMAS[pipeline], [f"learner={learner}", f"action_space={space}"])


@pytest.mark.parametrize("experiment", options("experiment"))
@pytest.mark.parametrize("scale", SCALES)
def test_every_experiment_composes_and_says_how_to_run_it(experiment: str, scale: str) -> None:
    package, command = (CONFIG_FOLDER / "experiment" / f"{experiment}.yaml").read_text().splitlines()[:2]
    assert package == "# @package _global_"
    run = re.search(rf"python -m pipelines\.(\w+) experiment={experiment}\b", command)
    assert run is not None
    pipeline = run[1]
    config = compose(pipeline, SCHEMAS[pipeline], [f"experiment={experiment}", f"scale={scale}"])
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
    assert (dqn.buffer_size, dqn.frames_per_batch, dqn.epochs) == (500_000, 2000, 3)
    assert dqn.target_update_interval is None
    c3po = compose("train_rl", TrainRLConfig, ["scale=paper"]).learner
    assert isinstance(c3po, C3POLearnerConfig)
    assert (c3po.batch_size, c3po.lr, c3po.discount, c3po.num_envs) == (2000, 1e-5, 0.995, 10)
    assert (c3po.clip_epsilon, c3po.frames_per_batch) == (0.075, 10_000)
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
        assert not any((planner.warm_start, planner.follow_mode, planner.max_resamplings, planner.avoid_visited))
        assert planner.num_perturbed_models == 0
    planner = compose("evaluate", EvaluateConfig, ["planner=kinodynamic_rrt"]).planner
    assert isinstance(planner, KinodynamicRRTConfig)
    assert (planner.num_children, planner.time_limit_s) == (8, 180.0)


# -------------------------------------------------- agreement with the library
OTHER_THAN_THE_DEFAULT = {
    ("ActorCriticImitationLearnerConfig", "return_unit"): "a departure of the ledger",
    ("QImitationLearnerConfig", "l2_regularization"): "the paper does not state its value (Eq. 3)",
    ("CraftedHeuristicRHP", "num_rollouts"): "8x4 (Sec. 7.5)",
    ("CraftedHeuristicRHP", "horizon"): "8x4 (Sec. 7.5)",
    **{("VisualRHP+", name): "VisualRHP+ has the options" for name in PLUS_OPTIONS},
    ("K.RRT closed loop", "max_simulations"): "a budget for every action, not for a plan",
    ("dhRRT", "max_simulations"): "a budget for every action, not for a plan",
}
"""Values of ``conf/`` that differ from the library's default, by the class or the planner, and why."""


def values(config: Any) -> Iterator[Any]:
    """All dataclasses within ``config``."""
    if is_dataclass(config):
        yield config
        for field in fields(config):
            yield from values(getattr(config, field.name))


@pytest.mark.parametrize(
    ("pipeline", "overrides"),
    [
        ("generate_demos", []),
        ("evaluate", ["planner=crafted_heuristic_rhp"]),
        ("evaluate", ["planner=visual_rhp"]),
        ("evaluate", ["planner=visual_rhp_plus"]),
        ("evaluate", ["planner=closed_loop_krrt"]),
        ("evaluate", ["planner=dhrrt"]),
        ("train_il", ["action_space=discrete"]),
        ("train_il", []),
        ("train_rl", ["action_space=discrete"]),
        ("train_rl", []),
        ("tune_crafted", []),
    ],
)
def test_conf_has_the_defaults_of_the_library_at_the_scale_of_the_paper(pipeline: str, overrides: list[str]) -> None:
    config = compose(pipeline, SCHEMAS[pipeline], ["scale=paper", *overrides])
    planner = getattr(getattr(config, "planner", None), "name", "")
    compared = 0
    for value in values(config):
        for field in fields(value):
            expected = {(type(value).__name__, field.name), (planner, field.name)} & OTHER_THAN_THE_DEFAULT.keys()
            if field.default is not MISSING and field.name != "name":
                assert (getattr(value, field.name) != field.default) == bool(expected), f"{value}.{field.name}"
                compared += 1
    assert compared > 20


def test_visual_rhp_plus_is_the_planner_of_the_library() -> None:
    config = compose("evaluate", EvaluateConfig, ["planner=visual_rhp_plus"]).planner
    assert isinstance(config, RecedingHorizonConfig)
    ours = RecedingHorizon.plus(CraftedHeuristic("continuous", CostToGo()))
    assert parameters_of(config, RecedingHorizonParameters) == parameters_of(ours, RecedingHorizonParameters)


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


def test_every_key_of_the_pipelines_is_read_by_some_code() -> None:
    """The library's own keys are arguments of its classes, which type checkers and linters know to be read."""
    import pipelines.config as module

    paths = [path for path in (REPOSITORY / "pipelines").rglob("*.py") if path.parent.name != "config"]
    code = "\n".join(path.read_text() for path in paths)
    for name, schema in vars(module).items():
        if not (isinstance(schema, type) and is_dataclass(schema)):
            continue
        of_the_library = {
            field.name for base in schema.__mro__ if base.__module__.startswith("visualrhp.") for field in entries(base)
        }
        for field in entries(schema):
            read = field.name in of_the_library or re.search(rf"\b{field.name}\b", code)
            assert read, f"{name}.{field.name} is not read"


def entries(schema: type) -> tuple[Any, ...]:
    return fields(schema) if is_dataclass(schema) else ()


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
