"""Kinodynamic RRT: plans that hold in the simulator, within the budget, repeatable."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.planning.conftest import LEFT, RIGHT
from visualrhp.errors import ConfigError
from visualrhp.planning import KinodynamicRRT, shorten_plan
from visualrhp.scene import SceneDistribution, TaskInstance, sample_task_instance
from visualrhp.simulation import MAX_ACTIONS, TransitionModel, make_action_space
from visualrhp.streams import Split
from visualrhp.types import Action, ActionSpaceName, Episode, Outcome, State

ACTION_SPACES: tuple[ActionSpaceName, ...] = ("continuous", "discrete")


def task_and_model(action_space: ActionSpaceName, index: int) -> tuple[TaskInstance, TransitionModel]:
    task = sample_task_instance(SceneDistribution(), 7, Split.TUNING, index)
    return task, TransitionModel(task.scene, make_action_space(action_space))


@pytest.mark.parametrize("action_space", ACTION_SPACES)
@pytest.mark.parametrize("index", range(4))
def test_a_plan_replays_bit_exactly_and_ends_in_a_goal(action_space: ActionSpaceName, index: int) -> None:
    task, model = task_and_model(action_space, index)
    result = KinodynamicRRT().search(model, task.state, np.random.default_rng(index))
    assert result.episode is not None and result.episode.is_goal
    assert len(result.episode) < MAX_ACTIONS
    replayed = TransitionModel(task.scene, make_action_space(action_space))
    state = task.state
    for action, expected in zip(result.episode.actions, result.episode.states[1:], strict=True):
        state = replayed.simulate(state, action).next_state
        assert state == expected
    assert replayed.is_goal(state) and not replayed.is_dropped(state)
    assert result.episode.rewards == (-1.0,) * len(result.episode)


@pytest.mark.parametrize("action_space", ACTION_SPACES)
def test_the_same_generator_gives_the_same_plan(action_space: ActionSpaceName) -> None:
    task, model = task_and_model(action_space, 0)
    first, second = (KinodynamicRRT().search(model, task.state, np.random.default_rng(5)) for _ in range(2))
    assert first.episode is not None and second.episode is not None
    assert (first.num_simulated, first.num_nodes) == (second.num_simulated, second.num_nodes)
    assert first.episode.states == second.episode.states
    assert np.array(first.episode.actions).tobytes() == np.array(second.episode.actions).tobytes()


@pytest.mark.parametrize("action_space", ACTION_SPACES)
def test_the_budget_is_kept_up_to_one_expansion(action_space: ActionSpaceName) -> None:
    task, model = task_and_model(action_space, 1)
    result = KinodynamicRRT(max_simulations=10).search(model, task.state, np.random.default_rng(0))
    assert result.episode is None
    assert 10 <= result.num_simulated < 10 + 8


def test_the_time_limit_ends_the_search(line_world: Callable[..., Any]) -> None:
    world = line_world(goal=10**6)
    result = KinodynamicRRT(time_limit_s=1e-9).search(world, start(0), np.random.default_rng(0))
    assert result.episode is None and result.num_simulated == 0


def start(cell: int) -> State:
    return State.create([0.0, 0.0, 0.0], 0.085, False, [[float(cell), 0.0, 0.0]])


def test_the_discrete_search_simulates_no_action_twice_and_grows_from_valid_states_only(
    line_world: Callable[..., Any],
) -> None:
    world = line_world(goal=10**6, edge=-5)
    result = KinodynamicRRT().search(world, start(0), np.random.default_rng(0))
    assert result.episode is None  # all of the line within 48 actions was searched, without the goal
    assert len(set(world.simulated)) == len(world.simulated) == result.num_simulated
    assert {cell for cell, _ in world.simulated} == set(range(-5, 49))
    assert result.num_nodes == len(range(-5, 49))


@pytest.mark.parametrize(("goal", "is_solved"), [(49, True), (50, False)])
def test_a_plan_has_fewer_than_50_actions(line_world: Callable[..., Any], goal: int, is_solved: bool) -> None:
    result = KinodynamicRRT().search(line_world(goal=goal, edge=-5), start(0), np.random.default_rng(0))
    assert (result.episode is not None) == is_solved
    assert result.episode is None or len(result.episode) == 49


def test_a_start_in_the_goal_needs_no_action(line_world: Callable[..., Any]) -> None:
    result = KinodynamicRRT().search(line_world(goal=0), start(0), np.random.default_rng(0))
    assert result.episode is not None and len(result.episode) == 0


def test_the_policy_is_open_loop_and_gives_up_after_its_plan(line_world: Callable[..., Any]) -> None:
    world = line_world(goal=3)
    policy = KinodynamicRRT().start(world, np.random.default_rng(0))
    elsewhere = start(1)
    actions = [policy(start(0)).action, *(policy(elsewhere).action for _ in range(3))]
    assert actions == [0, 0, 0, None]
    gives_up = KinodynamicRRT().start(line_world(goal=10**6), np.random.default_rng(0))
    assert gives_up(start(0)).action is None


@pytest.mark.parametrize(("max_actions", "is_solved"), [(3, True), (2, False), (0, False)])
def test_a_search_keeps_to_the_actions_that_it_is_given(
    line_world: Callable[..., Any], max_actions: int, is_solved: bool
) -> None:
    result = KinodynamicRRT().search(line_world(goal=3), start(0), np.random.default_rng(0), max_actions)
    assert (result.episode is not None) == is_solved


# -------------------------------------------------- shortening
def episode_of(world: Any, state: State, actions: list[Action]) -> Episode:
    transitions = []
    for action in actions:
        transitions.append(world.simulate(state, action))
        state = transitions[-1].next_state
    return Episode.from_transitions(transitions)


STAY = 2


@pytest.mark.parametrize(
    ("actions", "shorter"),
    [
        ([RIGHT, RIGHT, RIGHT], [RIGHT, RIGHT, RIGHT]),
        ([STAY, RIGHT, STAY, STAY, RIGHT, RIGHT], [RIGHT, RIGHT, RIGHT]),
        # without the step to the left the goal comes earlier, and what followed it is no longer needed
        ([RIGHT, RIGHT, LEFT, RIGHT, RIGHT], [RIGHT, RIGHT, RIGHT]),
        ([RIGHT, LEFT, LEFT, RIGHT, RIGHT, RIGHT, RIGHT], [RIGHT, RIGHT, RIGHT]),
        ([], []),
    ],
)
def test_actions_that_a_plan_does_without_are_dropped(
    line_world: Callable[..., Any], actions: list[Action], shorter: list[Action]
) -> None:
    world = line_world(goal=3, edge=-5)
    plan = episode_of(world, start(0), actions) if actions else Episode((start(3),), (), (), Outcome.SUCCESS)
    world.simulated.clear()
    found, num_simulated = shorten_plan(world, plan)
    assert list(found.actions) == shorter and found.is_goal
    assert num_simulated == len(world.simulated)
    assert not shorter or episode_of(world, start(0), shorter) == found


def test_a_way_over_a_drop_is_no_shorter_plan(line_world: Callable[..., Any]) -> None:
    world = line_world(goal=3, edge=0)
    plan = episode_of(world, start(0), [RIGHT, LEFT, RIGHT, RIGHT, RIGHT])
    assert shorten_plan(world, plan)[0].actions == (RIGHT,) * 3
    assert (0, LEFT) in world.simulated  # tried without the first action, and refused: it drops the object


@pytest.mark.parametrize("action_space", ACTION_SPACES)
def test_the_search_shortens_its_plan_on_request(action_space: ActionSpaceName) -> None:
    num_shorter = 0
    for index in range(4):
        task, model = task_and_model(action_space, index)
        long = KinodynamicRRT().search(model, task.state, np.random.default_rng(index))
        short = KinodynamicRRT(shorten=True).search(model, task.state, np.random.default_rng(index))
        assert long.episode is not None and short.episode is not None
        expected, num_simulated = shorten_plan(model, long.episode)
        assert short.episode.states == expected.states
        assert short.num_simulated == long.num_simulated + num_simulated
        assert shorten_plan(model, expected)[0].states == expected.states  # nothing is left to be dropped
        state = task.state
        for action, next_state in zip(expected.actions, expected.states[1:], strict=True):
            assert not model.is_goal(state)
            state = model.simulate(state, action).next_state
            assert state == next_state
        assert model.is_goal(state)
        assert expected.rewards == (-1.0,) * len(expected)
        num_shorter += len(expected) < len(long.episode)
    assert num_shorter > 0


@pytest.mark.parametrize(
    "parameters",
    [
        {"num_children": 0},
        {"num_directed": 9},
        {"goal_bias": 0.8, "gripper_bias": 0.3},
        {"goal_bias": -0.1},
        {"gripper_persistence": 1.5},
        {"obstacle_weight": -1.0},
        {"standoff": float("nan")},
        {"max_simulations": 0},
        {"time_limit_s": 0.0},
    ],
)
def test_a_parameter_out_of_range_is_named(parameters: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(parameters))):
        KinodynamicRRT(**parameters)
