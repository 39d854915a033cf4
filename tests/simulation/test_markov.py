"""The simulator is exactly Markov: 10,000 (scene, state, action) triples, simulated again in every other way."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from tests.simulation.soak import action_of, instance_of
from visualrhp.environments import ClutterManipulation
from visualrhp.heuristics.crafted import CraftedHeuristic
from visualrhp.planning import RecedingHorizon
from visualrhp.simulation import ContinuousActionSpace, TransitionModel
from visualrhp.types import State

Triple = tuple[State, np.ndarray, State]

NUM_WALKS, LENGTH = 125, 80


def walk(index: int) -> list[Triple]:
    """State, action, next state: of one scene, towards its objects, in the order in which they happened."""
    instance = instance_of("jam", index)
    model = TransitionModel(instance.scene, ContinuousActionSpace())
    rng = np.random.default_rng(index)
    triples, state = [], instance.state
    for number in range(LENGTH):
        action = action_of("jam", state, number, rng)
        transition = model.simulate(state, action)
        triples.append((state, action, transition.next_state))
        state = instance.state if transition.is_dropped else transition.next_state
    return triples


def again(index: int, triples: list[Triple], order: np.ndarray) -> list[bytes]:
    """The next states by one simulator that takes the triples in another order."""
    model = TransitionModel(instance_of("jam", index).scene, ContinuousActionSpace())
    results = {int(i): model.simulate(*triples[i][:2]).next_state.vector.tobytes() for i in order}
    return [results[i] for i in range(len(triples))]


def walk_again(index: int) -> list[bytes]:
    """For another process: it walks itself, and takes the triples backwards."""
    return again(index, walk(index), np.arange(LENGTH)[::-1])


@pytest.fixture(scope="module")
def walks() -> list[list[Triple]]:
    return [walk(index) for index in range(NUM_WALKS)]


def expected(triples: list[Triple]) -> list[bytes]:
    return [following.vector.tobytes() for *_, following in triples]


def test_the_walks_are_about_something(walks: list[list[Triple]]) -> None:
    """Objects are pushed in most of the transitions, and in many a closed gripper carries one."""
    triples = [triple for some in walks for triple in some]
    assert len(triples) == 10_000
    pushed = [not np.array_equal(before.object_poses, after.object_poses) for before, _, after in triples]
    gripped = [before.gripper_closed and before.gripper_opening > 1e-3 for before, *_ in triples]
    assert np.mean(pushed) > 0.5
    assert np.mean(gripped) > 0.05


def test_after_any_other_history(walks: list[list[Triple]]) -> None:
    for index, triples in enumerate(walks):
        assert again(index, triples, np.random.default_rng(index).permutation(LENGTH)) == expected(triples)


def test_in_a_fresh_simulator(walks: list[list[Triple]]) -> None:
    for index, triples in enumerate(walks):
        scene = instance_of("jam", index).scene
        for state, action, following in triples[::8]:
            assert TransitionModel(scene, ContinuousActionSpace()).simulate(state, action).next_state == following


def test_in_another_process(walks: list[list[Triple]]) -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        for triples, results in zip(walks, pool.map(walk_again, range(NUM_WALKS), chunksize=25), strict=True):
            assert results == expected(triples)


def test_in_the_environment(walks: list[list[Triple]]) -> None:
    env = ClutterManipulation("continuous", num_objects=(1, 7))
    for index, triples in enumerate(walks):
        scene = instance_of("jam", index).scene
        for state, action, following in triples[::4]:
            env.reset(seed=0, options={"scene": scene, "state": state})
            env.step(action)
            assert env.state == following


def test_in_the_planner(walks: list[list[Triple]]) -> None:
    """What a planner imagined, step by step, is what a model that never planned says."""
    planner = RecedingHorizon(CraftedHeuristic("continuous"), num_rollouts=3, horizon=3)
    for index, triples in enumerate(walks[::3]):
        scene = instance_of("jam", 3 * index).scene
        planning, fresh = (TransitionModel(scene, ContinuousActionSpace()) for _ in range(2))
        for state, *_ in triples[::20]:
            for rollout in planner.plan(planning, state, np.random.default_rng(index)).rollouts:
                for before, action, after in zip(rollout.states, rollout.actions, rollout.states[1:], strict=False):
                    assert fresh.simulate(before, action).next_state == after
