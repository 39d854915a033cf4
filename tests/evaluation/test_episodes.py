import math
from dataclasses import replace

import numpy as np
import pytest

from visualrhp.errors import SimulationError
from visualrhp.evaluation.episodes import evaluate_policy, perturbed_scene, run_episode, run_task
from visualrhp.planning.planner import Decision, Planner
from visualrhp.scene import ObjectShape, Scene, SceneDistribution, Split, TargetRegion, sample_task_instance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.simulation.task import DISCOUNT, MAX_EPISODE_ACTIONS
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import State, Transition

CONTINUOUS = make_action_space("continuous")
SQUARE = ObjectShape(np.array([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]]))
FORWARD = np.array([0.5, 0.0, 0.0, -1.0])


class Scripted(Planner):
    """Answers with the same decision always."""

    def __init__(self, decision):
        self.decision = decision

    @property
    def name(self):
        return "Scripted"

    def start(self, model, rng):
        return lambda state: self.decision


class RandomPlanner(Planner):
    """Acts at random, so that its episodes show which generator it was given."""

    @property
    def name(self):
        return "Random"

    def start(self, model, rng):
        return lambda state: Decision(rng.uniform(-1.0, 1.0, 4))


def pushing_task(target_x):
    """One object ahead of the gripper, which pushes it along x."""
    scene = Scene(TargetRegion(np.array([target_x, 0.0]), 0.03), (SQUARE,))
    state = State.create([-0.2, 0.0, 0.0], 0.0, True, [[-0.1, 0.0, 0.0]])
    return TransitionModel(scene, CONTINUOUS), state


def run(planner, model, state, **options):
    return run_episode(planner, model, model, state, np.random.default_rng(0), **options)


def test_success_ends_the_episode_and_is_measured():
    model, state = pushing_task(target_x=0.1)
    result = run(Scripted(Decision(np.array([0.5, 0.0, 0.0, 1.0]), num_invalid=2)), model, state, keep_states=True)
    assert (result.outcome, result.success, result.dropped) == ("success", True, False)
    assert model.is_goal(result.states[-1]) and not any(model.is_goal(state) for state in result.states[:-1])
    assert len(result.states) == result.num_actions + 1 and result.states[0] == state
    assert result.action_efficiency == 1 / result.num_actions
    assert result.num_invalid_rollouts == 2 * result.num_actions
    assert result.discounted_return == pytest.approx(-sum(DISCOUNT**k for k in range(result.num_actions)))
    assert result.decision_time_s > 0.0 and result.simulation_time_s > 0.0
    assert result.execution_time_s == result.decision_time_s + result.simulation_time_s


def test_a_drop_ends_the_episode_with_its_penalty():
    model, state = pushing_task(target_x=-0.2)
    result = run(Scripted(Decision(np.array([1.0, 0.0, 0.0, 1.0]))), model, state)
    assert (result.outcome, result.success, result.dropped) == ("dropped", False, True)
    before = sum(DISCOUNT**k for k in range(result.num_actions - 1))
    assert result.discounted_return == pytest.approx(-before - 50.0 * DISCOUNT ** (result.num_actions - 1))
    assert math.isnan(result.action_efficiency)
    assert result.states == ()


def test_success_has_to_come_in_under_fifty_actions():
    model, state = pushing_task(target_x=0.1)
    result = run(Scripted(Decision(np.zeros(4))), model, state, keep_states=True)
    assert (result.outcome, result.num_actions, len(result.states)) == ("out of actions", 49, 50)


def test_a_planner_that_gives_up_has_not_completed_the_task():
    model, state = pushing_task(target_x=0.1)
    result = run(Scripted(Decision(None)), model, state, keep_states=True)
    assert (result.outcome, result.num_actions, result.states) == ("no plan", MAX_EPISODE_ACTIONS, (state,))
    assert not result.success


def test_a_plan_that_ends_early_has_failed():
    model, state = pushing_task(target_x=0.1)

    class OneAction(Scripted):
        def start(self, model, rng):
            plan = iter([self.decision])
            return lambda state: next(plan, Decision(None))

    result = run(OneAction(Decision(np.zeros(4))), model, state)
    assert (result.outcome, result.num_actions, result.success) == ("plan failed", 1, False)


def test_a_world_that_diverges_ends_the_episode():
    model, state = pushing_task(target_x=0.1)

    class Diverging(TransitionModel):
        def simulate(self, state, action) -> Transition:
            raise SimulationError("a pose is not finite")

    world = Diverging(model.scene, CONTINUOUS)
    result = run_episode(Scripted(Decision(FORWARD)), world, model, state, np.random.default_rng(0))
    assert (result.outcome, result.success, result.num_actions) == ("diverged", False, 0)


def test_a_task_that_is_solved_from_the_start_needs_no_action():
    model, state = pushing_task(target_x=-0.1)
    result = run(Scripted(Decision(FORWARD)), model, state)
    assert (result.outcome, result.num_actions) == ("success", 0)
    assert math.isnan(result.action_efficiency)


def untimed(result):
    return replace(result, decision_time_s=0.0, simulation_time_s=0.0)


def test_an_outcome_depends_on_seed_and_index_alone():
    distribution = SceneDistribution(num_objects=(1, 3))
    task = {"seed": 5, "split": Split.EVALUATION, "action_space": CONTINUOUS}

    def run_all(indices):
        return {
            index: run_task(RandomPlanner(), distribution, index=index, keep_states=True, **task) for index in indices
        }

    forward, backward = run_all(range(3)), run_all([2, 1, 0])
    assert all(untimed(forward[index]) == untimed(backward[index]) for index in range(3))
    assert len({result.states[1] for result in forward.values()}) == 3
    in_one_go = evaluate_policy(RandomPlanner(), distribution, indices=range(3), **task)
    assert [untimed(result) for result in in_one_go] == [
        replace(untimed(forward[index]), states=()) for index in range(3)
    ]


def test_noise_changes_the_world_and_not_the_model():
    distribution = SceneDistribution(num_objects=(3, 3))
    seen = []

    class Watching(Scripted):
        def start(self, model, rng):
            seen.append(model.scene)
            return super().start(model, rng)

    def run_at(noise):
        return run_task(
            Watching(Decision(FORWARD)),
            distribution,
            7,
            Split.EVALUATION,
            0,
            action_space=CONTINUOUS,
            noise=noise,
            keep_states=True,
        )

    quiet, noisy, again = run_at(0.0), run_at(0.05), run_at(0.05)
    nominal = sample_task_instance(distribution, 7, Split.EVALUATION, 0)
    assert all(scene == nominal.scene for scene in seen)
    assert noisy.states == again.states
    assert quiet.states[0] == noisy.states[0] == nominal.state
    world = perturbed_scene(nominal.scene, 0.05, 7, Split.EVALUATION, 0)
    assert world != nominal.scene
    assert world != perturbed_scene(nominal.scene, 0.05, 7, Split.EVALUATION, 1)


def test_levels_of_noise_scale_the_same_draws():
    scene = sample_task_instance(SceneDistribution(num_objects=(1, 1)), 0, Split.EVALUATION, 0).scene
    low = perturbed_scene(scene, 0.01, 0, Split.EVALUATION, 0).objects[0]
    high = perturbed_scene(scene, 0.05, 0, Split.EVALUATION, 0).objects[0]
    assert high.friction / scene.objects[0].friction - 1.0 == pytest.approx(
        5.0 * (low.friction / scene.objects[0].friction - 1.0)
    )
