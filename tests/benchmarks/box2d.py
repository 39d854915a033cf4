"""Success of planners in the same world built in Box2D, which the model of the planner knows nothing about."""

from __future__ import annotations

import functools
import importlib.util
import itertools

import joblib
import numpy as np

from pipelines.config import EvaluateConfig
from pipelines.planners import build_planner, find_network
from pipelines.workflow.app import compose
from tests.benchmarks.timing import Effort
from visualrhp.evaluation.metrics import wilson_interval
from visualrhp.execution import EpisodeResult, run_episode
from visualrhp.planning import Planner
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import ActionSpaceName

SPACES: tuple[ActionSpaceName, ...] = ("continuous", "discrete")
LAWS = ("crude", "close")
NUM_OBJECTS = (1, 4, 7)
SEED = 7919
PLANNERS = {
    "VisualRHP 3x3 (Algorithm 1)": ("planner=visual_rhp",),
    "K.RRT closed loop": ("planner=closed_loop_krrt",),
    "VisualRHP+ without robust look-ahead": ("planner=visual_rhp_plus", "planner.num_perturbed_models=0"),
    "VisualRHP+": ("planner=visual_rhp_plus",),
    "with models perturbed by 5%": ("planner=visual_rhp_plus", "planner.perturbation=0.05"),
    "with turning perturbed by 50%": ("planner=visual_rhp_plus", "planner.turning_perturbation=0.5"),
    "with poses perturbed by 1 cm, 6 degrees": (
        "planner=visual_rhp_plus",
        "planner.position_perturbation=0.01",
        "planner.angle_perturbation=0.1",
    ),
}
"""And the overrides of their configuration."""


def run(effort: Effort, planners: dict[str, tuple[str, ...]] = PLANNERS) -> None:
    if importlib.util.find_spec("Box2D") is None:
        print('\nBox2D is not installed: this section is skipped. Install it with pip install -e ".[box2d]"')
        return
    print(f"\nThe same world in Box2D, {effort.instances} tasks with each of {NUM_OBJECTS} objects, released networks")
    tasks = list(itertools.product(NUM_OBJECTS, range(effort.instances)))
    with joblib.Parallel(n_jobs=-1) as parallel:
        for space, name in itertools.product(SPACES, planners):
            cells = []
            for law in LAWS:
                run_one = joblib.delayed(run_in_box2d)
                results = parallel(run_one(planners[name], space, law, *task) for task in tasks)
                done = [result.num_actions for result in results if result.success]
                rate = wilson_interval(len(done), len(results))
                actions = np.mean(done) if done else np.nan
                cells.append(f"{law} {rate.value:.1%} ({rate.low:.0%}-{rate.high:.0%}), {actions:.1f} actions")
            print(f"{space:<11}{name:<42}{'; '.join(cells)}", flush=True)


def run_in_box2d(
    overrides: tuple[str, ...], space: ActionSpaceName, law: str, num_objects: int, index: int
) -> EpisodeResult:
    """One episode; the planner's model is the project's simulator."""
    from tests.benchmarks.box2d_world import Box2DWorld

    planner = _planner(overrides, space, num_objects)
    instance = sample_task_instance(SceneDistribution(num_objects=num_objects), SEED, Split.EVALUATION, index)
    action_space = make_action_space(space)
    world = Box2DWorld(instance, action_space, law)  # pyright: ignore[reportArgumentType]
    rng = generator_for(SEED, Split.EVALUATION, index, Stream.PLANNER)
    return run_episode(planner, world, TransitionModel(instance.scene, action_space), rng)


@functools.cache
def _planner(overrides: tuple[str, ...], space: ActionSpaceName, num_objects: int) -> Planner:
    config = compose("evaluate", EvaluateConfig, [f"action_space={space}", *overrides])
    network = find_network(config.planner, space, "pretrained", num_objects)
    return build_planner(config.planner, space, num_objects, network)
