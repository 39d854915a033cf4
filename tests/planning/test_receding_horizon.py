"""Algorithm 1 and Eq. 3 on a line of cells, with returns worked out by hand."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from visualrhp.errors import ConfigError
from visualrhp.heuristics.conversion import heuristic_of
from visualrhp.heuristics.heuristic import Guidance, Heuristic, SoftmaxGuidance
from visualrhp.heuristics.networks import ActorCritic
from visualrhp.observation import make_observation
from visualrhp.planning import Decision, Greedy, RecedingHorizon
from visualrhp.planning.planner import Timing
from visualrhp.scene import Scene, SceneDistribution, sample_task_instance
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.streams import Split
from visualrhp.types import Action, ActionSpaceName, State, Transition

RIGHT, LEFT, STAY, BREAK = 0, 1, 2, 7
GAMMA = 0.5


def start(cell: int) -> State:
    return State.create([0.0, 0.0, 0.0], 0.085, False, [[float(cell), 0.0, 0.0]])


def cells(states: Sequence[State]) -> list[int]:
    return [int(state.object_poses[0, 0]) for state in states]


class ScriptedGuidance(Guidance):
    """Draws actions from a script, or at random without one."""

    def __init__(self, script: list[Action] | None, values: np.ndarray) -> None:
        self._script = script
        self.values = values

    def sample(self, rngs: Sequence[np.random.Generator]) -> list[Action]:
        if self._script is None:
            return [int(rng.integers(3)) for rng in rngs]
        return [self._script.pop(0) for _ in rngs]

    def mode(self) -> list[Action]:
        return [STAY] * len(self.values)


class ScriptedHeuristic(Heuristic):
    """v(cell) from a table. ``script``: actions in the order of drawing: the first of all roll-outs first."""

    action_space: ActionSpaceName = "discrete"

    def __init__(self, values: dict[int, float], script: Sequence[Action] | None = None) -> None:
        self._values = values
        self._script = None if script is None else list(script)
        self.calls: list[list[int]] = []

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        assert len(scenes) == len(states)
        self.calls.append(cells(states))
        return ScriptedGuidance(self._script, np.array([self._values.get(cell, 0.0) for cell in cells(states)]))


def rhp(heuristic: Heuristic, n: int, h: int) -> RecedingHorizon:
    return RecedingHorizon(heuristic, num_rollouts=n, horizon=h, discount=GAMMA)


def test_returns_by_hand(line_world: Callable[..., Any]) -> None:
    """From cell 1, gamma 1/2, v(3) = -8, v(1) = -4: right, right -> -1 - 1/2 - 8/4 = -3.5; left, right -> -2.5."""
    heuristic = ScriptedHeuristic({3: -8.0, 1: -4.0}, script=[RIGHT, LEFT, RIGHT, RIGHT])
    decision = rhp(heuristic, n=2, h=2).plan(line_world(goal=9), start(1), np.random.default_rng(0))
    assert [rollout.total_return for rollout in decision.rollouts] == [-3.5, -2.5]
    assert [rollout.value_estimate for rollout in decision.rollouts] == [-8.0, -4.0]
    assert [cells(rollout.states) for rollout in decision.rollouts] == [[1, 2, 3], [1, 0, 1]]
    assert [rollout.actions for rollout in decision.rollouts] == [(RIGHT, RIGHT), (LEFT, RIGHT)]
    assert [rollout.rewards for rollout in decision.rollouts] == [(-1.0, -1.0), (-1.0, -1.0)]
    assert decision.action == LEFT
    assert decision.num_invalid == 0


def test_a_terminal_state_ends_the_rollout_and_is_not_bootstrapped(line_world: Callable[..., Any]) -> None:
    """Goal after one of three actions: -1. Drop after one: -50. Neither sees v, even where it promises wonders."""
    heuristic = ScriptedHeuristic({1: 1000.0, -1: 1000.0, 0: -20.0}, script=[STAY, LEFT, RIGHT, STAY, STAY])
    decision = rhp(heuristic, n=3, h=3).plan(line_world(goal=1), start(0), np.random.default_rng(0))
    waiting = -1.0 - 0.5 - 0.25 - 20.0 / 8.0
    assert [rollout.total_return for rollout in decision.rollouts] == [waiting, -50.0, -1.0]
    assert [len(rollout.actions) for rollout in decision.rollouts] == [3, 1, 1]
    assert [rollout.value_estimate for rollout in decision.rollouts] == [-20.0, 0.0, 0.0]
    assert decision.action == RIGHT


def test_a_goal_in_the_last_step_of_the_horizon_is_not_bootstrapped(line_world: Callable[..., Any]) -> None:
    heuristic = ScriptedHeuristic({2: -1000.0}, script=[RIGHT, RIGHT])
    decision = rhp(heuristic, n=1, h=2).plan(line_world(goal=2), start(0), np.random.default_rng(0))
    assert decision.rollouts[0].total_return == -1.5


def test_a_diverged_rollout_is_minus_infinity_and_counted(line_world: Callable[..., Any]) -> None:
    """One breaks the physics, one reaches a value that is not a number; the drop beats both."""
    heuristic = ScriptedHeuristic({1: math.nan}, script=[BREAK, RIGHT, LEFT])
    decision = rhp(heuristic, n=3, h=1).plan(line_world(goal=9), start(0), np.random.default_rng(0))
    assert [rollout.total_return for rollout in decision.rollouts] == [-math.inf, -math.inf, -50.0]
    assert decision.num_invalid == 2
    assert decision.action == LEFT


def test_if_all_rollouts_diverge_the_mode_of_the_heuristic_decides(line_world: Callable[..., Any]) -> None:
    heuristic = ScriptedHeuristic({}, script=[BREAK, RIGHT, BREAK])
    decision = rhp(heuristic, n=2, h=2).plan(line_world(goal=9), start(0), np.random.default_rng(0))
    assert decision.num_invalid == 2
    assert decision.action == STAY
    assert [rollout.actions for rollout in decision.rollouts] == [(BREAK,), (RIGHT, BREAK)]
    assert all(len(rollout.states) == len(rollout.rewards) + 1 for rollout in decision.rollouts)


def test_a_network_whose_values_are_no_numbers_decides_nothing(line_world: Callable[..., Any]) -> None:
    class Broken(Heuristic):
        action_space = "discrete"

        def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
            return SoftmaxGuidance(np.full((len(states), 8), np.nan), 1.0)

    world = line_world(goal=9)
    decision = rhp(Broken(), n=3, h=2).plan(world, start(4), np.random.default_rng(0))
    assert decision.num_invalid == 3 and decision.action == 0  # the first of equals
    assert all(rollout.is_diverged for rollout in decision.rollouts)


def test_the_first_of_equal_returns_wins(line_world: Callable[..., Any]) -> None:
    heuristic = ScriptedHeuristic({}, script=[LEFT, RIGHT, STAY])
    decision = rhp(heuristic, n=3, h=1).plan(line_world(goal=9), start(4), np.random.default_rng(0))
    assert decision.action == LEFT


def test_one_call_of_the_heuristic_per_depth_over_all_rollouts_and_tasks(line_world: Callable[..., Any]) -> None:
    heuristic = ScriptedHeuristic({})
    worlds = [line_world(goal=90, edge=-90) for _ in range(2)]
    rngs = [np.random.default_rng(seed) for seed in range(2)]
    rhp(heuristic, n=3, h=4).plan_batch(worlds, [start(10), start(20)], rngs)
    assert [len(call) for call in heuristic.calls] == [2, 6, 6, 6, 6]


def test_a_task_is_planned_alike_alone_and_among_others(line_world: Callable[..., Any]) -> None:
    values = {cell: -float(cell % 5) for cell in range(-20, 60)}
    planner = rhp(ScriptedHeuristic(values), n=4, h=3)
    seeds_and_cells = [(0, 10), (1, 20), (2, 30)]
    together = planner.plan_batch(
        [line_world(goal=90) for _ in seeds_and_cells],
        [start(cell) for _, cell in seeds_and_cells],
        [np.random.default_rng(seed) for seed, _ in seeds_and_cells],
    )
    for decision, (seed, cell) in zip(together, seeds_and_cells, strict=True):
        alone = planner.plan(line_world(goal=90), start(cell), np.random.default_rng(seed))
        assert alone == decision


def test_what_was_simulated_in_a_decision_is_not_simulated_again(line_world: Callable[..., Any]) -> None:
    world = line_world(goal=90)
    heuristic = ScriptedHeuristic({}, script=[RIGHT, RIGHT, LEFT, RIGHT, STAY, RIGHT])
    rhp(heuristic, n=3, h=2).plan(world, start(5), np.random.default_rng(0))
    assert world.simulated == [(5, RIGHT), (5, LEFT), (6, RIGHT), (6, STAY), (4, RIGHT)]


def test_a_policy_draws_from_its_generator_alone(line_world: Callable[..., Any]) -> None:
    planner = rhp(ScriptedHeuristic({}), n=3, h=3)
    decisions = []
    for _ in range(2):
        policy = planner.start(line_world(goal=90), np.random.default_rng(3))
        decisions.append([policy(start(10)) for _ in range(4)])
    assert decisions[0] == decisions[1]


def test_greedy_takes_the_mode_and_simulates_nothing(line_world: Callable[..., Any]) -> None:
    world = line_world()
    decision = Greedy(ScriptedHeuristic({})).start(world, np.random.default_rng(0))(start(0))
    assert decision.action == STAY and decision.rollouts == ()
    assert world.simulated == []


@pytest.mark.parametrize(
    "parameters",
    [
        {"num_rollouts": 0},
        {"horizon": 0},
        {"discount": 0.0},
        {"discount": 1.1},
        {"discount": math.nan},
        {"deadline_s": 0.0},
        {"deadline_s": -1.0},
        {"deadline_s": math.nan},
        {"deadline_s": math.inf},
    ],
)
def test_a_parameter_out_of_range_is_named(parameters: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(parameters))):
        RecedingHorizon(ScriptedHeuristic({}), **parameters)


# ------------------------------------------------------------------------------------------------------------ deadlines
class Clock:
    """Stands still but for :meth:`spend`."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def spend(self, seconds: float, function: Callable[..., Any]) -> Callable[..., Any]:
        """``function``, which from now on takes that long."""

        def slow(*arguments: Any) -> Any:
            self.now += seconds
            return function(*arguments)

        return slow


def decide_in_time(
    world: Any, deadline_s: float | None, script: Sequence[Action] | None = None, n: int = 2, h: int = 2
) -> tuple[Decision, float]:
    """A decision from cell 5 where v(cell) = -cell, an action takes 1 s and a call 1 s; and how long it took."""
    clock = Clock()
    heuristic = ScriptedHeuristic({cell: -float(cell) for cell in range(99)}, script)
    heuristic.guide = clock.spend(1.0, heuristic.guide)
    world.simulate = clock.spend(1.0, world.simulate)
    planner = RecedingHorizon(heuristic, num_rollouts=n, horizon=h, discount=GAMMA, deadline_s=deadline_s, clock=clock)
    decision = planner.plan(world, start(5), np.random.default_rng(0))
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
    decisions = planner.plan_batch(worlds, [start(9)] * 3, [np.random.default_rng(i) for i in range(3)])
    assert clock.now == 102.0
    assert [len(decision.rollouts) for decision in decisions] == [0, 0, 0]
    assert [decision.action for decision in decisions] == [STAY, STAY, STAY]


def test_without_a_deadline_no_time_counts(line_world: Callable[..., Any]) -> None:
    quick = rhp(ScriptedHeuristic({cell: -float(cell) for cell in range(99)}), n=4, h=3)
    slow, _ = decide_in_time(line_world(goal=90), None, n=4, h=3)
    assert slow == quick.plan(line_world(goal=90), start(5), np.random.default_rng(0))


def test_a_decision_says_what_took_how_long(line_world: Callable[..., Any]) -> None:
    decision, duration = decide_in_time(line_world(goal=90), None, [RIGHT, LEFT, LEFT, LEFT])
    assert duration == 7.0
    assert decision.timing == Timing(total_s=7.0, simulation_s=4.0, observation_s=0.0, heuristic_s=3.0)


def test_names_say_the_deadline() -> None:
    assert RecedingHorizon(ScriptedHeuristic({})).name == "RHP 3x3"
    assert RecedingHorizon(ScriptedHeuristic({}), deadline_s=0.05).name == "RHP 3x3 in 50 ms"
    assert RecedingHorizon(ScriptedHeuristic({}), name="mine", deadline_s=0.05).name == "mine"


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
