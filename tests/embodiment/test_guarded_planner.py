"""A planner that fails ends the episode with the robot at rest."""

import numpy as np
import pytest

from tests.embodiment.planar_cell import pushing_task
from visualrhp.embodiment.guarded_planner import GuardedPlanner
from visualrhp.embodiment.planned_model import ReachableModel
from visualrhp.embodiment.reach import ReachMap
from visualrhp.errors import CellFault, PerceptionError
from visualrhp.planning.planner import Decision, Planner
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.types import State

TASK = pushing_task()
MODEL = TransitionModel(TASK.scene, make_action_space("continuous"))


class Made(Planner):
    """Decides by a function."""

    name = "Made"

    def __init__(self, policy, start=None):
        self.policy, self.fails = policy, start

    def start(self, model, rng):
        if self.fails:
            raise self.fails
        return self.policy


def decide(planner, reasons=None):
    reasons = [] if reasons is None else reasons
    guarded = GuardedPlanner(planner, reasons.append)
    assert guarded.name == "Made"
    return guarded.start(MODEL, np.random.default_rng(0))(TASK.state), reasons


@pytest.mark.parametrize("decision", [Decision(np.zeros(4)), Decision(None)])
def test_decisions_pass(decision):
    assert decide(Made(lambda state: decision)) == (decision, [])


def failing(state):
    raise ZeroDivisionError("float division by zero")


@pytest.mark.parametrize(
    ("planner", "words"),
    [
        (Made(failing), "ZeroDivisionError: float division by zero"),
        (Made(None, MemoryError("no memory")), "MemoryError"),
        (Made(lambda state: Decision(np.full(4, np.nan))), "ActionError: a continuous action"),
        (Made(lambda state: Decision(3)), "ActionError"),
        (Made(lambda state: None), "AttributeError"),
    ],
)
def test_whatever_fails_is_a_fault_and_stops_the_robot(planner, words):
    reasons = []
    with pytest.raises(CellFault, match=f"the planner failed: {words}") as raised:
        decide(planner, reasons)
    assert reasons == [str(raised.value)]


def test_faults_of_the_cell_pass():
    def faulty(state):
        raise PerceptionError("the image is black")

    with pytest.raises(PerceptionError, match="black"):
        GuardedPlanner(Made(faulty), lambda reason: None).start(MODEL, np.random.default_rng(0))(TASK.state)


@pytest.mark.parametrize("name", ["continuous", "discrete"])
def test_a_motion_that_the_arm_cannot_make_is_replaced_by_a_similar_one(name):
    space = make_action_space(name)
    model = ReachableModel(TASK.scene, space, ReachMap.load())
    backward = np.array([-1.0, 0.0, 0.0, -1.0]) if name == "continuous" else 1
    near_the_base = State.create([-0.19, 0.0, 0.0], 0.085, False, TASK.state.object_poses)
    assert model.motion_fault(near_the_base, backward) is not None

    def instead(state):
        planner = GuardedPlanner(Made(lambda state: Decision(backward)), lambda reason: None)
        return planner.start(model, np.random.default_rng(0))(state).action

    assert model.motion_fault(near_the_base, instead(near_the_base)) is None
    in_the_middle = State.create([0.0, 0.1, 0.0], 0.085, False, TASK.state.object_poses)
    assert np.array_equal(instead(in_the_middle), backward), "what the arm can do is done"
