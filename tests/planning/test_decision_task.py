"""The choice among the roll-outs of a task, with all options, on the line of cells and in the simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.special import log_softmax

from tests.planning.conftest import LEFT, RIGHT, LineWorld, at
from tests.planning.scripted import STAY, ScriptedHeuristic, cells
from visualrhp.heuristics.crafted import CostToGo, CraftedHeuristic
from visualrhp.heuristics.heuristic import Guidance, SoftmaxGuidance
from visualrhp.planning import RecedingHorizon
from visualrhp.planning.decision_task import DecisionTask
from visualrhp.planning.episode_memory import EpisodeMemory
from visualrhp.planning.planner import Rollout, Timing
from visualrhp.planning.receding_horizon import PLUS_OPTIONS
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.streams import Split
from visualrhp.types import Action, ActionSpaceName, State, Transition

GAMMA = 0.5
ALL = {name: value for name, value in PLUS_OPTIONS.items() if "perturb" not in name}
ROBUST = ALL | {"num_perturbed_models": 2}


def planner(heuristic: ScriptedHeuristic, n: int = 1, h: int = 2, **options: Any) -> RecedingHorizon:
    return RecedingHorizon(heuristic, num_rollouts=n, horizon=h, discount=GAMMA, **options)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_the_mode_competes(line_world: Callable[..., Any]) -> None:
    """The mode stays; its value is the best."""
    heuristic = ScriptedHeuristic({1: -1.0}, script=[RIGHT, RIGHT, STAY])
    decision = planner(heuristic, follow_mode=True).plan(line_world(goal=9), at(1), rng())
    assert [rollout.origin for rollout in decision.rollouts] == ["policy", "mode"]
    assert decision.rollouts[1].actions == (STAY, STAY)
    assert decision.action == (RIGHT if decision.chosen == 0 else STAY)


def test_the_rest_of_the_chosen_rollout_competes_again(line_world: Callable[..., Any]) -> None:
    """First right, right to the promising cell 3; then the samples go left, and the rest and the mode after it win."""
    values = {3: 100.0, 2: 0.0, 1: -10.0, 0: -10.0}
    heuristic = ScriptedHeuristic(values, script=[RIGHT, RIGHT, LEFT, LEFT, LEFT])
    policy = planner(heuristic, warm_start=True).start(line_world(goal=9), rng())
    first, second = policy(at(1)), policy(at(2))
    assert [rollout.origin for rollout in first.rollouts] == ["policy"]
    assert [rollout.origin for rollout in second.rollouts] == ["policy", "warm start"]
    assert second.rollouts[1].actions == (RIGHT, STAY) and cells(second.rollouts[1].states) == [2, 3, 3]
    assert (second.chosen, second.action) == (1, RIGHT)


def test_without_a_memory_every_decision_is_the_first(line_world: Callable[..., Any]) -> None:
    chosen = planner(ScriptedHeuristic({}), n=2, **ALL)
    assert chosen.plan(line_world(goal=90), at(9), rng()) == chosen.plan(line_world(goal=90), at(9), rng())


def test_more_are_drawn_only_while_the_best_drops(line_world: Callable[..., Any]) -> None:
    """In cell 0, going left drops. The first two rounds of the policy do; the third is uniform."""
    heuristic = ScriptedHeuristic({}, script=[LEFT, LEFT, LEFT, LEFT] + [STAY] * 20)
    decision = planner(heuristic, n=2, h=1, max_resamplings=4).plan(line_world(goal=9), at(0), rng())
    origins = [rollout.origin for rollout in decision.rollouts]
    assert origins[:4] == ["policy", "policy", "resampling", "resampling"] and len(origins) % 2 == 0
    assert all(rollout.actions == (LEFT,) for rollout in decision.rollouts[:4])
    assert decision.action != LEFT
    last_round = decision.rollouts[-2:]
    assert any(rollout.actions != (LEFT,) for rollout in last_round)
    assert all(rollout.actions == (LEFT,) for rollout in decision.rollouts[:-2])


def test_resampling_is_bounded(line_world: Callable[..., Any]) -> None:
    class Doomed(LineWorld):
        """Every action drops the object."""

        def is_dropped(self, state: Any) -> bool:
            return True

    decision = planner(ScriptedHeuristic({}), n=3, h=2, max_resamplings=4).plan(Doomed(), at(5), rng())
    assert len(decision.rollouts) == 5 * 3
    once = planner(ScriptedHeuristic({}), n=3, h=2).plan(Doomed(), at(5), rng())
    assert len(once.rollouts) == 3


def test_states_of_the_episode_are_avoided(line_world: Callable[..., Any]) -> None:
    """Staying is best by its value, but would repeat the state; right is new; left was visited, and drops are worse."""
    heuristic = ScriptedHeuristic({5: 100.0, 4: 50.0, 6: -30.0}, script=[STAY, LEFT, RIGHT])
    memory = EpisodeMemory()
    memory.enter(at(4))
    avoiding = planner(heuristic, n=3, h=1, avoid_visited=True)
    decision = avoiding.plan(line_world(goal=90), at(5), rng(), memory)
    assert decision.action == RIGHT and decision.chosen == 2
    heuristic = ScriptedHeuristic({0: -30.0}, script=[LEFT, STAY])
    decision = planner(heuristic, n=2, h=1, avoid_visited=True).plan(line_world(goal=90), at(0), rng())
    assert decision.action == STAY, "a visited state is better than a drop"


class TableHeuristic(ScriptedHeuristic):
    """Its policy is Eq. 2 of the same q-values in every cell, its values are those of the table."""

    def __init__(self, values: dict[int, float], q_values: Sequence[float]) -> None:
        super().__init__(values)
        self.q_values = np.array([q_values])

    def guide(self, scenes: Sequence[Any], states: Sequence[Any]) -> Guidance:
        values = super().guide(scenes, states).values
        return TableGuidance(self.q_values.repeat(len(states), axis=0), 1.0, table=values)


@dataclass(frozen=True)
class TableGuidance(SoftmaxGuidance):
    table: Any = None

    @property
    def values(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.table

    def take(self, rows: Sequence[int]) -> SoftmaxGuidance:
        return replace(self, q_values=self.q_values[list(rows)], table=self.table[list(rows)])


PEAKED = [-100.0] * 8
PEAKED[STAY] = 0.0


def test_distinct_actions_begin_the_rollouts_of_a_peaked_policy(line_world: Callable[..., Any]) -> None:
    heuristic = TableHeuristic({}, PEAKED)
    peaked = planner(heuristic, n=3, h=1).plan(line_world(goal=90), at(5), rng())
    assert [rollout.actions for rollout in peaked.rollouts] == [(STAY,)] * 3
    distinct = planner(heuristic, n=3, h=1, distinct_actions=True).plan(line_world(goal=90), at(5), rng())
    assert distinct.rollouts[0].actions == (STAY,) and len({r.actions for r in distinct.rollouts}) == 3


def test_distinct_resampling_covers_the_actions(line_world: Callable[..., Any]) -> None:
    """Only one of eight actions does not drop the object: three rounds of three find it, whatever the policy."""

    class Narrow(LineWorld):
        def simulate(self, state: State, action: Action) -> Transition:
            transition = super().simulate(state, STAY)
            return replace(transition, action=action, is_dropped=action != 5, reward=-1.0 if action == 5 else -50.0)

    options = {"max_resamplings": 2, "distinct_actions": True}
    for seed in range(20):
        decision = planner(TableHeuristic({}, PEAKED), n=3, h=1, **options).plan(
            Narrow(goal=90), at(5), np.random.default_rng(seed)
        )
        assert decision.action == 5 and len({rollout.actions for rollout in decision.rollouts}) <= 8


def test_the_prior_outweighs_a_slightly_higher_return(line_world: Callable[..., Any]) -> None:
    """Right is better by 1 (1/2 after the discount), and less probable by a factor of e^2."""
    q_values = [-2.0, -100.0, 0.0, *[-100.0] * 5]
    heuristic = TableHeuristic({6: 1.0}, q_values)

    def decide(**options: Any) -> Any:
        chosen = planner(heuristic, n=2, h=1, distinct_actions=True, **options)
        return chosen.plan(line_world(goal=90), at(5), rng())

    assert decide().action == RIGHT
    assert decide(prior_weight=0.2).action == RIGHT, "2 x 0.2 < 1/2"
    decision = decide(prior_weight=0.3)
    assert decision.action == STAY, "2 x 0.3 > 1/2"
    right = next(rollout for rollout in decision.rollouts if rollout.actions == (RIGHT,))
    assert right.prior == pytest.approx(0.3 * log_softmax(q_values)[RIGHT]) and right.total_return == -0.5
    assert right.compared == right.total_return + right.prior


def test_rollouts_end_when_another_one_has_reached_the_goal(line_world: Callable[..., Any]) -> None:
    """The first reaches cell 6 after one action; the others would go on, to a state whose value is overrated."""
    script = [RIGHT, STAY, LEFT] + [STAY] * 10
    world = line_world(goal=6)
    decision = planner(ScriptedHeuristic({5: 99.0}, script), n=3, h=4, stop_at_goal=True).plan(world, at(5), rng())
    assert (decision.action, decision.chosen, len(decision.rollouts)) == (RIGHT, 0, 1)
    assert len(world.simulated) == 3
    script = [STAY, STAY, LEFT, RIGHT, STAY, STAY]
    world = line_world(goal=6)
    decision = planner(ScriptedHeuristic({}, script), n=3, h=4, stop_at_goal=True).plan(world, at(5), rng())
    assert decision.rollouts[0].actions == (STAY, RIGHT) and len(decision.rollouts) == 1


@dataclass
class WideEdge(LineWorld):
    """Its perturbed models drop the object in cells below ``edge + 3``, and their random numbers are counted."""

    def perturbed(self, relative_std: float, turning_std: float, rng: np.random.Generator) -> WideEdge:
        rng.random()
        return WideEdge(self.goal, self.edge + 3)


def test_robust_look_ahead_compares_returns_in_all_models() -> None:
    """From cell 4: left is best in the nominal model (v = 50), but drops in the perturbed one after two actions."""
    values = {2: 50.0, 6: -2.0, 3: 0.0, 5: 0.0}
    script = [LEFT, RIGHT, LEFT, RIGHT]

    def decide(**options: Any) -> Any:
        chosen = planner(ScriptedHeuristic(values, script), n=2, h=2, **options)
        return chosen.plan(WideEdge(goal=90), at(4), rng())

    nominal = decide()
    assert nominal.action == LEFT and all(rollout.robust_return is None for rollout in nominal.rollouts)
    for judgement, expected in (("mean", (-1.5 + 12.5 - 26.0) / 2), ("worst", -26.0)):
        robust = decide(num_perturbed_models=1, judgement=judgement)
        assert robust.action == RIGHT and robust.chosen == 1
        left, right = robust.rollouts
        assert left.total_return == -1.5 + 12.5
        assert left.robust_return == expected
        assert right.robust_return == right.total_return == -1.5 - 0.5


def test_only_rollouts_that_could_be_the_best_are_judged() -> None:
    """Left, right, stay: left is best, and bad in the perturbed model; right is next, and judged; stay is not."""
    heuristic = ScriptedHeuristic({3: 50.0, 5: 40.0, 4: 0.0}, script=[LEFT, RIGHT, STAY])
    world = WideEdge(goal=90)
    world.edge = 1
    memory = EpisodeMemory()
    chosen = planner(heuristic, n=3, h=1, num_perturbed_models=1)
    decision = chosen.plan(world, at(4), rng(), memory)
    left, right, stay = decision.rollouts
    assert decision.chosen == 1 and left.robust_return is not None and right.robust_return == right.total_return
    assert stay.robust_return is None and stay.total_return < right.compared
    (model,) = memory.perturbed_models
    assert isinstance(model, WideEdge) and model.simulated == [(4, LEFT), (4, RIGHT)]


def test_resampling_goes_on_while_the_best_rollout_drops_in_a_perturbed_model() -> None:
    heuristic = ScriptedHeuristic({3: 50.0}, script=[LEFT, LEFT, RIGHT])
    world = WideEdge(goal=90)
    world.edge = 1
    decision = planner(heuristic, n=1, h=1, num_perturbed_models=1, max_resamplings=4).plan(world, at(4), rng())
    assert [rollout.actions for rollout in decision.rollouts[:2]] == [(LEFT,), (LEFT,)]
    assert decision.action != LEFT and decision.rollouts[-1].robust_return is not None
    options = {"num_perturbed_models": 1, "max_resamplings": 4, "tolerated_drops": 1}
    heuristic = ScriptedHeuristic({3: 50.0}, script=[LEFT])
    tolerant = planner(heuristic, n=1, h=1, **options).plan(world, at(4), rng())
    assert [rollout.actions for rollout in tolerant.rollouts] == [(LEFT,)]


def test_perturbed_states_are_those_of_all_rollouts_of_a_decision() -> None:
    """Common random numbers: every roll-out is judged from the same states, which are other ones in every decision."""
    task = sample_task_instance(SceneDistribution(num_objects=(3, 3)), 0, Split.TUNING, 1)
    model = TransitionModel(task.scene, make_action_space("continuous"))
    chosen = RecedingHorizon(
        CraftedHeuristic("continuous", CostToGo()),
        num_perturbed_models=2,
        position_perturbation=0.01,
        angle_perturbation=0.1,
    )
    root = chosen.heuristic.guide([task.scene], [task.state])
    memory, generator = EpisodeMemory(), rng()
    first = DecisionTask(model, task.state, generator, memory, root, chosen)
    second = DecisionTask(model, task.state, generator, memory, root, chosen)
    assert len({*first.perturbed_states, *second.perturbed_states, task.state}) == 5
    for each in (first, second):
        for candidate in each.first_candidates():
            candidate.simulate()
            candidate.value(0.0)
        each.close_round()
        while replays := each.replays_of_best():
            assert [replay.state for replay in replays] == each.perturbed_states
            for replay in replays:
                replay.simulate()
                replay.value(0.0)
            each.judge(replays)


def test_a_value_that_is_not_finite_in_a_perturbed_model_is_bad() -> None:
    """Left has the best return, but its state in the perturbed model has no value."""

    class Undefined(WideEdge):
        def perturbed(self, relative_std: float, turning_std: float, rng: np.random.Generator) -> Any:
            return Shifted(self.goal, self.edge)

    class Shifted(LineWorld):
        def simulate(self, state: State, action: Action) -> Transition:
            transition = super().simulate(state, action)
            return replace(transition, next_state=at(99)) if action == LEFT else transition

    heuristic = ScriptedHeuristic({3: 50.0, 99: np.nan}, script=[LEFT, RIGHT])
    decision = planner(heuristic, n=2, h=1, num_perturbed_models=1, avoid_visited=True).plan(
        Undefined(goal=90), at(4), rng()
    )
    assert decision.action == RIGHT


def test_a_masked_action_has_no_prior_to_win_with(line_world: Callable[..., Any]) -> None:
    q_values = [-1.0, -2.0, 0.0, -np.inf, *[-3.0] * 4]
    heuristic = TableHeuristic({}, q_values)
    decision = planner(heuristic, n=8, h=1, distinct_actions=True, prior_weight=0.3).plan(
        line_world(goal=90), at(5), rng()
    )
    assert decision.action == STAY
    assert min(rollout.prior for rollout in decision.rollouts) == -np.inf


def test_with_a_deadline_judged_rollouts_are_preferred() -> None:
    """Left would be chosen before it is judged; there was time to judge right alone."""
    chosen = planner(ScriptedHeuristic({}), n=2, h=1, num_perturbed_models=1)
    task = DecisionTask(
        WideEdge(goal=90), at(4), rng(), EpisodeMemory(), chosen.heuristic.guide([None], [at(4)]), chosen
    )  # pyright: ignore[reportArgumentType]
    left = Rollout.of([LEFT], [at(4), at(3)], [-1.0], 50.0)
    right = Rollout.of([RIGHT], [at(4), at(5)], [-1.0], 5.0)
    task.rollouts = [(left, False), (replace(right, robust_return=4.0), False)]
    assert task.best() == 0
    assert task.decide(Timing(0.0, 0.0, 0.0, 0.0)).action == RIGHT


def test_perturbed_models_are_drawn_once_per_episode() -> None:
    chosen = planner(ScriptedHeuristic({}), n=2, h=2, num_perturbed_models=2)
    memory = EpisodeMemory()
    world, generator = WideEdge(goal=90), rng()
    chosen.plan(world, at(9), generator, memory)
    models = list(memory.perturbed_models)
    chosen.plan(world, at(9), generator, memory)
    assert len(models) == 2 and [id(model) for model in memory.perturbed_models] == [id(model) for model in models]


def test_tasks_of_a_batch_do_not_depend_on_each_other(line_world: Callable[..., Any]) -> None:
    """One needs resampling, the other does not; both decide twice."""
    values = {cell: -float(cell % 5) for cell in range(-20, 60)}
    chosen = planner(ScriptedHeuristic(values), n=2, h=2, **ALL)
    starts = [(0, 0), (1, 20), (2, 1)]

    def decide(tasks: list[tuple[int, int]]) -> list[list[Any]]:
        rngs = [np.random.default_rng(seed) for seed, _ in tasks]
        memories = [EpisodeMemory() for _ in tasks]
        worlds = [line_world(goal=90) for _ in tasks]
        return [chosen.plan_batch(worlds, [at(cell) for _, cell in tasks], rngs, memories) for _ in range(2)]

    together = decide(starts)
    for number, start in enumerate(starts):
        alone = decide([start])
        assert [decisions[number] for decisions in together] == [decisions[0] for decisions in alone]


@pytest.mark.parametrize("options", [ALL, ROBUST], ids=["plus", "robust"])
@pytest.mark.parametrize("space", ["continuous", "discrete"])
def test_with_all_options_in_the_simulator(space: ActionSpaceName, options: dict[str, Any]) -> None:
    """Reproducible; the chosen roll-out is one of the decision's, and its predicted state is the next one."""
    task = sample_task_instance(SceneDistribution(num_objects=(3, 3)), 0, Split.TUNING, 1)
    model = TransitionModel(task.scene, make_action_space(space))
    chosen = RecedingHorizon(CraftedHeuristic(space, CostToGo()), num_rollouts=4, horizon=3, **options)
    runs = []
    for _ in range(2):
        policy, state, decisions = chosen.start(model, np.random.default_rng(5)), task.state, []
        for _ in range(4):
            decision = policy(state)
            decisions.append(decision)
            assert decision.chosen is not None and decision.action is not None
            state = model.simulate(state, decision.action).next_state
            assert state == decision.rollouts[decision.chosen].states[1]
        runs.append([cells_of(decision) for decision in decisions])
    assert runs[0] == runs[1]
    assert {origin for decision in runs[0] for origin, *_ in decision} >= {"policy", "mode", "warm start"}


def cells_of(decision: Any) -> list[tuple[Any, ...]]:
    return [(rollout.origin, rollout.total_return, rollout.states) for rollout in decision.rollouts]
