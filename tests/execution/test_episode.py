import math

import numpy as np
import pytest

from visualrhp.errors import ActionError, CellFault, PerceptionError, SimulationError, UnreachableError
from visualrhp.execution.episode import EpisodeListener, RunningEpisode, run_episode, run_task
from visualrhp.execution.world import SimulatedWorld
from visualrhp.planning.planner import Decision, Planner
from visualrhp.scene import ObjectShape, Scene, SceneDistribution, TargetRegion, TaskInstance, sample_task_instance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.simulation.rules import DISCOUNT, MAX_EPISODE_ACTIONS
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.streams import Split
from visualrhp.types import Outcome, State

CONTINUOUS = make_action_space("continuous")
SQUARE = ObjectShape(np.array([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]]))
FORWARD = np.array([0.5, 0.0, 0.0, -1.0])


class Scripted(Planner):
    """Answers with the same decision always."""

    def __init__(self, decision):
        self.decision = decision

    name = "Scripted"

    def start(self, model, rng):
        return lambda state: self.decision


class RandomPlanner(Planner):
    """Acts at random, so that its episodes show which generator it was given."""

    name = "Random"

    def start(self, model, rng):
        return lambda state: Decision(rng.uniform(-1.0, 1.0, 4))


def pushing_task(target_x):
    """One object ahead of the gripper, which pushes it along x."""
    scene = Scene(TargetRegion(np.array([target_x, 0.0]), 0.03), (SQUARE,))
    state = State.create([-0.2, 0.0, 0.0], 0.0, True, [[-0.1, 0.0, 0.0]])
    return TransitionModel(scene, CONTINUOUS), state


def run(planner, model, state, listener=None):
    world = SimulatedWorld(TaskInstance(model.scene, state), model)
    return run_episode(planner, world, model, np.random.default_rng(0), listener)


def test_success_ends_the_episode_and_is_measured():
    model, state = pushing_task(target_x=0.1)
    result = run(Scripted(Decision(np.array([0.5, 0.0, 0.0, 1.0]), num_invalid=2)), model, state)
    assert (result.outcome, result.success, result.dropped) == ("success", True, False)
    assert model.is_goal(result.episode.states[-1]) and not any(
        model.is_goal(state) for state in result.episode.states[:-1]
    )
    assert len(result.episode.states) == result.num_actions + 1 and result.episode.states[0] == state
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


def test_success_has_to_come_in_under_fifty_actions():
    model, state = pushing_task(target_x=0.1)
    result = run(Scripted(Decision(np.zeros(4))), model, state)
    assert (result.outcome, result.num_actions, len(result.episode.states)) == ("out of actions", 49, 50)


def test_a_planner_that_gives_up_has_not_completed_the_task():
    model, state = pushing_task(target_x=0.1)
    result = run(Scripted(Decision(None)), model, state)
    assert (result.outcome, result.num_actions, result.episode.states) == ("no plan", MAX_EPISODE_ACTIONS, (state,))
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
        def advance(self, state, action) -> State:
            raise SimulationError("a pose is not finite")

    world = SimulatedWorld(TaskInstance(model.scene, state), Diverging(model.scene, CONTINUOUS))
    result = run_episode(Scripted(Decision(FORWARD)), world, model, np.random.default_rng(0))
    assert (result.outcome, result.success, result.num_actions) == ("diverged", False, 0)


class Failing(SimulatedWorld):
    """Raises an error in the second call of a method."""

    def __init__(self, instance, model, method, error):
        super().__init__(instance, model)
        self.method, self.error, self.calls = method, error, 0

    def _call(self, method):
        self.calls += method == self.method
        if method == self.method and self.calls == 2:
            raise self.error

    def observe(self):
        self._call("observe")
        return super().observe()

    def act(self, action):
        self._call("act")
        super().act(action)


@pytest.mark.parametrize(
    ("method", "error", "outcome", "num_actions"),
    [
        ("act", UnreachableError("wrist 3 is at its limit"), "unreachable", 1),
        ("act", CellFault("the arm does not answer"), "stopped", 1),
        ("act", PerceptionError("the image is black"), "stopped", 1),
        ("observe", PerceptionError("the image is black"), "stopped", 0),
    ],
)
def test_a_robot_that_cannot_act_ends_the_episode(method, error, outcome, num_actions):
    model, state = pushing_task(target_x=0.2)
    world = Failing(TaskInstance(model.scene, state), model, method, error)
    listener = Listening()
    result = run_episode(Scripted(Decision(FORWARD)), world, model, np.random.default_rng(0), listener)
    assert (result.outcome, result.num_actions, result.fault) == (outcome, num_actions, str(error))
    assert not result.success and len(result.decisions) == num_actions + 1
    assert len(result.episode.states) == num_actions + 1 == listener.num_states


class Listening(EpisodeListener):
    """Counts the states."""

    num_states = 0

    def observed(self, state, outcome):
        self.num_states += 1


def test_a_planner_that_meets_a_fault_ends_the_episode():
    class Faulty(Scripted):
        def start(self, model, rng):
            def policy(state):
                raise CellFault("the planner failed")

            return policy

    model, state = pushing_task(target_x=0.2)
    result = run(Faulty(None), model, state)
    assert (result.outcome, result.fault, result.decisions) == ("stopped", "the planner failed", ())


def test_the_policy_starts_anew_when_the_number_of_objects_changes():
    model, state = pushing_task(target_x=0.2)
    found = State.create([-0.2, 0.0, 0.0], 0.0, True, [[-0.1, 0.0, 0.0], [0.1, 0.1, 0.0]])
    more = Scene(model.scene.target, (SQUARE, SQUARE))

    class Finding(SimulatedWorld):
        num_observed = 0

        def observe(self):
            self.num_observed += 1
            return super().observe() if self.num_observed < 3 else (more, found)

        def act(self, action):
            pass

    starts = []

    class Counting(Scripted):
        def start(self, model, rng):
            starts.append(rng.random())
            return super().start(model, rng)

    world = Finding(TaskInstance(model.scene, state), model)
    result = run_episode(Counting(Decision(FORWARD)), world, model, np.random.default_rng(0))
    assert len(starts) == 2 and result.num_objects == 2


def test_a_task_that_is_solved_from_the_start_needs_no_action():
    model, state = pushing_task(target_x=-0.1)
    result = run(Scripted(Decision(FORWARD)), model, state)
    assert (result.outcome, result.num_actions) == ("success", 0)
    assert math.isnan(result.action_efficiency)


def test_an_episode_depends_on_seed_and_index_alone():
    distribution = SceneDistribution(num_objects=(1, 3))

    def run_all(indices):
        tasks = {index: sample_task_instance(distribution, 5, Split.EVALUATION, index) for index in indices}
        return {
            index: run_task(RandomPlanner(), task, 5, Split.EVALUATION, index, action_space=CONTINUOUS)
            for index, task in tasks.items()
        }

    forward, backward = run_all(range(3)), run_all([2, 1, 0])
    assert all(forward[index].episode.states == backward[index].episode.states for index in range(3))
    assert len({result.episode.states[1] for result in forward.values()}) == 3


def test_a_listener_is_told_of_every_state_and_decision():
    model, state = pushing_task(target_x=0.1)
    told = []

    class Recorder(EpisodeListener):
        def observed(self, state, outcome):
            told.append((state, outcome))

        def decided(self, decision):
            told.append(decision)

    result = run(Scripted(Decision(np.array([0.5, 0.0, 0.0, 1.0]))), model, state, Recorder())
    assert [entry[0] for entry in told[::2]] == list(result.episode.states)
    assert [entry[1] for entry in told[::2]] == [None] * result.num_actions + [Outcome.SUCCESS]
    assert tuple(told[1::2]) == result.decisions


def test_a_running_episode_can_be_resumed():
    model, state = pushing_task(target_x=0.1)
    running = RunningEpisode(SimulatedWorld(TaskInstance(model.scene, state), model), num_actions=47)
    running.act(np.zeros(4))
    assert running.outcome is None
    running.act(np.zeros(4))
    assert running.outcome is Outcome.OUT_OF_ACTIONS
    assert (running.num_actions, len(running.episode)) == (49, 2)


def test_a_refused_action_changes_nothing():
    model, state = pushing_task(target_x=0.1)
    running = RunningEpisode(SimulatedWorld(TaskInstance(model.scene, state), model))
    with pytest.raises(ActionError):
        running.act(np.array([math.nan, 0.0, 0.0, 0.0]))
    assert (running.num_actions, running.state, running.outcome) == (0, state, None)
