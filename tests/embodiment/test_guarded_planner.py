"""A planner that fails ends the episode with the robot at rest."""

import numpy as np
import pytest

from tests.embodiment.planar_cell import pushing_task
from visualrhp.embodiment.guarded_planner import GuardedPlanner
from visualrhp.errors import CellFault, PerceptionError
from visualrhp.planning.planner import Decision, Planner
from visualrhp.simulation import TransitionModel, make_action_space

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
