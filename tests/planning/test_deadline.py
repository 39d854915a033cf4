"""Decisions with a deadline on a line of cells, where actions and calls take a second each."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from tests.planning.conftest import BREAK, LEFT, RIGHT, at
from tests.planning.scripted import STAY, Clock, ScriptedHeuristic, cells
from visualrhp.heuristics.conversion import heuristic_of
from visualrhp.heuristics.networks import ActorCritic
from visualrhp.observation import make_observation
from visualrhp.planning import Decision, RecedingHorizon
from visualrhp.planning.deadline import DecisionClock
from visualrhp.planning.planner import Timing
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.streams import Split
from visualrhp.types import Action, State, Transition

GAMMA = 0.5


class SlowRollout:
    """An action that takes time."""

    def __init__(self, clock: Clock, duration: float) -> None:
        self._clock, self._duration = clock, duration
        self.num_simulated = 0

    def simulate(self) -> None:
        self._clock.now += self._duration
        self.num_simulated += 1


def guide(decision: DecisionClock, clock: Clock, duration: float, observation_s: float = 0.0) -> None:
    """Call a heuristic that takes ``duration`` [s], of which ``observation_s`` for the observations."""
    heuristic = ScriptedHeuristic({})
    guidance = heuristic.guide([], [])
    guidance.observation_s = observation_s
    heuristic.guide = clock.spend(duration, lambda *_: guidance)
    assert decision.guide(heuristic, [], []) is guidance


def test_the_parts_of_a_decision_add_up() -> None:
    clock = Clock()
    decision = DecisionClock(clock, None)
    guide(decision, clock, 3.0, observation_s=0.5)
    assert decision.simulate([SlowRollout(clock, 2.0), SlowRollout(clock, 4.0)])
    guide(decision, clock, 1.0, observation_s=0.25)
    clock.now += 8.0  # neither simulation nor heuristic
    assert decision.timing() == Timing(total_s=18.0, simulation_s=6.0, observation_s=0.75, heuristic_s=3.25)


def test_no_action_begins_after_the_deadline_and_a_late_one_is_measured() -> None:
    clock = Clock()
    decision = DecisionClock(clock, 5.0)
    rollouts = [SlowRollout(clock, 3.0) for _ in range(4)]
    assert not decision.simulate(rollouts)
    assert [rollout.num_simulated for rollout in rollouts] == [1, 1, 0, 0]
    assert decision.timing() == Timing(total_s=6.0, simulation_s=6.0, observation_s=0.0, heuristic_s=0.0)
    on_time = [SlowRollout(clock, 3.0) for _ in range(2)]
    assert DecisionClock(clock, 5.0).simulate(on_time)  # the last may be late


@pytest.mark.parametrize(("elapsed", "is_too_late"), [(0.0, False), (7.0, False), (7.5, True), (10.0, True)])
def test_the_longest_call_so_far_has_to_fit(elapsed: float, is_too_late: bool) -> None:
    """A deadline after 14 s, a call of 3 s and one of 1 s: another may begin until 11 s have passed."""
    clock = Clock()
    decision = DecisionClock(clock, 14.0)
    guide(decision, clock, 3.0)
    guide(decision, clock, 1.0)
    clock.now += elapsed
    assert decision.is_too_late_to_guide() is is_too_late


def test_the_deadline_itself_is_too_late_without_any_call() -> None:
    clock = Clock()
    decision = DecisionClock(clock, 2.0)
    assert not decision.is_too_late_to_guide()
    clock.now += 2.0
    assert decision.is_too_late_to_guide()


# ------------------------------------------------------------------------------------------- receding horizon planning
def decide_in_time(
    world: Any, deadline_s: float | None, script: Sequence[Action] | None = None, n: int = 2, h: int = 2
) -> tuple[Decision, float]:
    """A decision from cell 5 where v(cell) = -cell, an action takes 1 s and a call 1 s; and how long it took."""
    clock = Clock()
    heuristic = ScriptedHeuristic({cell: -float(cell) for cell in range(99)}, script)
    heuristic.guide = clock.spend(1.0, heuristic.guide)
    world.simulate = clock.spend(1.0, world.simulate)
    planner = RecedingHorizon(heuristic, num_rollouts=n, horizon=h, discount=GAMMA, deadline_s=deadline_s, clock=clock)
    decision = planner.plan(world, at(5), np.random.default_rng(0))
    return decision, clock.now - 100.0


@pytest.mark.parametrize(
    ("deadline_s", "lengths", "ends_at"),
    [
        (0.5, [], 1.0),  # the first call is always made
        (3.9, [], 1.0 + 2.0),  # two actions, and no time to value where they lead
        (4.0, [1, 1], 1.0 + 2.0 + 1.0),
        (5.5, [1, 1], 4.0 + 2.0),  # the last action is late by half of it; it is not valued
        (6.9, [1, 1], 4.0 + 2.0),
        (7.0, [2, 2], 7.0),
        (8.5, [2, 2], 7.0 + 2.0),
        (10.5, [2, 2, 1, 1], 10.0 + 1.0),
        (13.0, [2, 2, 2, 2], 13.0),
    ],
)
def test_as_many_rollouts_as_there_is_time_for(
    line_world: Callable[..., Any], deadline_s: float, lengths: list[int], ends_at: float
) -> None:
    script = [RIGHT, LEFT, LEFT, LEFT, 2, 3, 4, 5, 6, 6]  # no action is taken in a cell twice: all are simulated
    decision, duration = decide_in_time(line_world(goal=90, edge=-90), deadline_s, script)
    assert [len(rollout.actions) for rollout in decision.rollouts] == lengths
    assert all(len(rollout.states) == len(rollout.rewards) + 1 for rollout in decision.rollouts)
    assert duration == ends_at


def test_a_rollout_that_the_deadline_stops_is_one_of_a_shorter_horizon(line_world: Callable[..., Any]) -> None:
    """From 5 with v(6) = -6 and v(4) = -4, gamma 1/2: right -> -1 - 6/2 = -4; left -> -1 - 4/2 = -3."""
    decision, _ = decide_in_time(line_world(goal=90), 5.5, [RIGHT, LEFT, RIGHT, RIGHT])
    assert [rollout.total_return for rollout in decision.rollouts] == [-4.0, -3.0]
    assert [rollout.value_estimate for rollout in decision.rollouts] == [-6.0, -4.0]
    assert [cells(rollout.states) for rollout in decision.rollouts] == [[5, 6], [5, 4]]
    assert decision.action == LEFT


def test_what_ended_before_the_deadline_needs_no_value(line_world: Callable[..., Any]) -> None:
    decision, _ = decide_in_time(line_world(goal=6), 3.0, [LEFT, RIGHT])
    assert [rollout.total_return for rollout in decision.rollouts] == [-1.0]
    assert decision.action == RIGHT
    broken, _ = decide_in_time(line_world(goal=6), 3.0, [LEFT, BREAK])
    assert (broken.num_invalid, broken.action) == (1, STAY)


@pytest.mark.parametrize("deadline_s", np.arange(1.0, 40.0, 0.7).tolist())
@pytest.mark.parametrize(("n", "h"), [(1, 1), (3, 3), (2, 6)])
def test_no_decision_is_late_by_more_than_an_action(
    line_world: Callable[..., Any], deadline_s: float, n: int, h: int
) -> None:
    decision, duration = decide_in_time(line_world(goal=90, edge=-90), deadline_s, n=n, h=h)
    assert duration <= deadline_s + 1.0
    assert decision.action is not None
    if decision.rollouts:
        returns = [rollout.total_return for rollout in decision.rollouts]
        assert decision.action == decision.rollouts[int(np.argmax(returns))].actions[0]


def test_several_tasks_share_a_deadline(line_world: Callable[..., Any]) -> None:
    clock = Clock()
    heuristic = ScriptedHeuristic({})
    worlds = [line_world(goal=90) for _ in range(3)]
    for world in worlds:
        world.simulate = clock.spend(1.0, world.simulate)
    planner = RecedingHorizon(heuristic, num_rollouts=1, horizon=1, deadline_s=2.0, clock=clock)
    decisions = planner.plan_batch(worlds, [at(9)] * 3, [np.random.default_rng(i) for i in range(3)])
    assert clock.now == 102.0
    assert [len(decision.rollouts) for decision in decisions] == [0, 0, 0]
    assert [decision.action for decision in decisions] == [STAY, STAY, STAY]


def test_without_a_deadline_no_time_counts(line_world: Callable[..., Any]) -> None:
    heuristic = ScriptedHeuristic({cell: -float(cell) for cell in range(99)})
    quick = RecedingHorizon(heuristic, num_rollouts=4, horizon=3, discount=GAMMA)
    slow, _ = decide_in_time(line_world(goal=90), None, n=4, h=3)
    assert slow == quick.plan(line_world(goal=90), at(5), np.random.default_rng(0))


def test_a_decision_reports_the_time_of_its_parts(line_world: Callable[..., Any]) -> None:
    decision, duration = decide_in_time(line_world(goal=90), None, [RIGHT, LEFT, LEFT, LEFT])
    assert duration == 7.0
    assert decision.timing == Timing(total_s=7.0, simulation_s=4.0, observation_s=0.0, heuristic_s=3.0)


def test_a_deadline_is_kept_with_a_real_clock_world_and_network() -> None:
    """By the processor's clock, which other work on the machine leaves alone."""
    task = sample_task_instance(SceneDistribution(num_objects=(4, 4)), 0, Split.TUNING, 0)
    model = TransitionModel(task.scene, make_action_space("continuous"))
    durations: list[float] = []

    class Timed:
        scene, action_space, is_goal = model.scene, model.action_space, model.is_goal

        def simulate(self, state: State, action: Action) -> Transition:
            began = time.process_time()
            transition = model.simulate(state, action)
            durations.append(time.process_time() - began)
            return transition

    heuristic = heuristic_of(ActorCritic(make_observation("image")))
    planner = RecedingHorizon(heuristic, deadline_s=0.02, clock=time.process_time)
    planner.plan(model, task.state, np.random.default_rng(0))  # what is done once, is done
    late, counts = [], []
    for seed in range(12):
        durations.clear()
        decision = planner.plan(Timed(), task.state, np.random.default_rng(seed))
        assert decision.timing is not None
        assert decision.timing.simulation_s > 0.0 and decision.timing.heuristic_s > 0.0
        assert decision.timing.observation_s > 0.0
        late.append(decision.timing.total_s - 0.02 - max(durations))
        counts.append(len(decision.rollouts))
    assert np.median(late) <= 0.0
    assert np.median(counts) >= 3
