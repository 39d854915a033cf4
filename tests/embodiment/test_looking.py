"""Looks: frames at rest, views that have to agree, and what flickers."""

import numpy as np
import pytest

from tests.embodiment.planar_cell import PlanarCell, PlanarPerception, Seen, planar_task, pushing_task
from visualrhp.embodiment.looking import Looker, LookLimits, StepLatency
from visualrhp.embodiment.true_state import TruePerception
from visualrhp.embodiment.watchdog import WatchedCell
from visualrhp.errors import PerceptionError
from visualrhp.scene import Scene
from visualrhp.types import State


class Scripted(PlanarPerception):
    """Alters its views in turn: a function of the view, or an error."""

    def __init__(self, cell, *alterations):
        super().__init__(cell)
        self.alterations, self.num_looks = list(alterations), 0

    def perceive(self, frame, arm, gripper, closed):
        view = super().perceive(frame, arm, gripper, closed)
        alter = self.alterations[min(self.num_looks, len(self.alterations) - 1)] if self.alterations else None
        self.num_looks += 1
        if isinstance(alter, Exception):
            raise alter
        return view if alter is None else alter(view)


def without_last(view):
    scene, state = view.scene, view.state
    fewer = Scene(scene.target, scene.objects[:-1], scene.edges, scene.gripper)
    return Seen(fewer, State.create(state.gripper_pose, state.gripper_opening, False, state.object_poses[:-1]))


def moved(distance):
    def alter(view):
        poses = view.state.object_poses + (distance, 0.0, 0.0)
        return Seen(view.scene, State.create(view.state.gripper_pose, view.state.gripper_opening, False, poses))

    return alter


def unsettled(view):
    view = Seen(view.scene, view.state)
    object.__setattr__(view, "is_settled", False)
    return view


@pytest.fixture
def cell():
    return PlanarCell(planar_task(num_objects=3))


def look(cell, *alterations, expected=None, **limits):
    perception = Scripted(cell, *alterations)
    latency = StepLatency()
    looker = Looker(WatchedCell(cell, 0.085), perception, LookLimits(**limits))
    return looker.look(expected, False, latency), latency


def test_the_first_view_is_confirmed_by_a_second(cell):
    sight, latency = look(cell)
    assert sight.view.scene is cell.scene and latency.num_looks == 2
    assert np.array_equal(sight.view.state.object_poses, cell.state.object_poses)
    assert latency.perception_s > 0.0 and latency.rest_s > 0.2 and sight.time_s == cell.now()


def test_a_view_like_the_last_one_needs_one_look(cell):
    first, _ = look(cell)
    _, latency = look(cell, expected=first)
    assert latency.num_looks == 1
    _, latency = look(cell, moved(0.1), expected=first)
    assert latency.num_looks == 1, "an action moves objects by some centimetres"


def test_a_scene_that_is_another_is_looked_at_again(cell):
    first, _ = look(cell)
    sight, latency = look(cell, without_last, expected=first)
    assert (sight.view.state.num_objects, latency.num_looks) == (2, 2)
    sight, latency = look(cell, without_last, None, expected=first)
    assert (sight.view.state.num_objects, latency.num_looks) == (3, 3), "what is there for one look is not believed"
    sight, latency = look(cell, moved(0.4), None, expected=first)
    assert latency.num_looks == 3 and sight.view.scene is cell.scene


def test_a_view_that_is_not_settled_is_looked_at_again(cell):
    first, _ = look(cell)
    _, latency = look(cell, unsettled, unsettled, None, expected=first)
    assert latency.num_looks == 3


@pytest.mark.parametrize(
    ("alterations", "words"),
    [
        ((without_last, None) * 10, "changes from frame to frame"),
        ((PerceptionError("no orange"),), "no orange"),
        ((ValueError("zero-size array"),), "ValueError: zero-size array"),
        ((lambda view: Seen(view.scene, State(np.full(14, np.nan))),), "not finite"),
        ((lambda view: Seen(without_last(view).scene, view.state),), "another number of poses"),
    ],
)
def test_what_stays_unclear_is_an_error(cell, alterations, words):
    with pytest.raises(PerceptionError, match=f"8 looks in succession give no clear view: .*{words}"):
        look(cell, *alterations)


def test_a_single_failure_is_passed_over(cell):
    _, latency = look(cell, PerceptionError("no orange"), None)
    assert latency.num_looks == 3


class Rolling(PlanarCell):
    """The first object rolls for a while."""

    def wait(self, duration_s):
        super().wait(duration_s)
        if self.time < self.until:
            poses = self.state.object_poses + (0.3 * duration_s, 0.0, 0.0)
            self.state = State.create(self.state.gripper_pose, self.state.gripper_opening, False, poses)


@pytest.mark.parametrize("has_camera", [True, False])
def test_objects_come_to_rest_before_a_view_counts(has_camera):
    cell = Rolling(pushing_task())
    cell.until = cell.time + 0.55
    truth = TruePerception(lambda: (cell.scene, cell.state))
    looker = Looker(WatchedCell(cell, 0.085), PlanarPerception(cell) if has_camera else truth)
    sight = looker.look(None, False, StepLatency())
    assert sight.view.state.object_positions[0, 0] == pytest.approx(cell.state.object_positions[0, 0])
    assert cell.time > 1.55


def test_a_scene_that_never_rests_is_an_error():
    cell = Rolling(pushing_task())
    cell.until = 1e9
    looker = Looker(WatchedCell(cell, 0.085), PlanarPerception(cell), LookLimits(max_unrest_s=0.3))
    with pytest.raises(PerceptionError, match=r"still moves 0\.3 s"):
        looker.look(None, False, StepLatency())


def test_the_age_of_a_view_is_that_of_the_slower_clock(cell):
    host = [5.0]
    looker = Looker(WatchedCell(cell, 0.085), PlanarPerception(cell), host_clock=lambda: host[0])
    sight = looker.look(None, False, StepLatency())
    assert looker.age(sight) == 0.0
    cell.wait(0.3)
    assert looker.age(sight) == pytest.approx(0.3)
    host[0] += 2.0
    assert looker.age(sight) == pytest.approx(2.0)
