"""The watchdog: what a cell reports is refused when it is impossible, and halting never fails."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.embodiment.planar_cell import PlanarCell, PlanarKinematics, pushing_task
from visualrhp.embodiment.robot_cell import ArmState, CameraFrame, GripperState
from visualrhp.embodiment.watchdog import WatchdogLimits, WatchedCell
from visualrhp.errors import CellFault, ConfigError, PerceptionError, SimulationError
from visualrhp.simulation.action_spaces import GripperMotion

STROKE = 0.085


class Altered(PlanarCell):
    """A cell some of whose answers are given by the test."""

    def __init__(self):
        super().__init__(pushing_task())
        self.answers = {}

    def _answer(self, name, true) -> Any:
        answer = self.answers.get(name)
        if isinstance(answer, Exception):
            raise answer
        return true if answer is None else answer(true) if callable(answer) else answer

    def now(self):
        return self._answer("now", super().now())

    def arm(self):
        return self._answer("arm", super().arm())

    def gripper(self):
        return self._answer("gripper", super().gripper())

    def frame(self):
        return self._answer("frame", super().frame())

    def wait(self, duration_s):
        if self._answer("wait", True) is True:
            super().wait(duration_s)


@pytest.fixture
def cell():
    return Altered()


@pytest.fixture
def watched(cell):
    return WatchedCell(cell, STROKE)


def joints(state: ArmState, index: int, value: float) -> ArmState:
    positions = state.positions.copy()
    positions[index] = value
    return replace(state, positions=positions)


def test_what_is_possible_passes(cell, watched):
    arm, gripper = watched.rest()
    np.testing.assert_array_equal(arm.positions, cell.arm().positions)
    assert gripper == GripperState(STROKE, False, cell.now())
    assert watched.wait(0.5) == pytest.approx(1.5)
    assert watched.is_still(arm)


ARM = {
    "is fault": (lambda state: replace(state, fault="protective stop"), "protective stop"),
    "is not finite": (lambda state: joints(state, 2, math.nan), "finite numbers"),
    "has too few joints": (lambda state: replace(state, positions=np.zeros(5)), "finite numbers"),
    "is no number": (lambda state: replace(state, positions=["a"] * 6), "no numbers"),
    "is out of range": (lambda state: joints(state, 2, 3.3), "joint 2 at 3.300 rad; its range is -3.142 to 3.142"),
    "is too fast": (lambda state: replace(state, velocities=np.full(6, 9.0)), "above their limit"),
    "is old": (lambda state: replace(state, time_s=state.time_s - 0.3), "0.300 s old; at most 0.2 s"),
    "is of the future": (lambda state: replace(state, time_s=state.time_s + 1.0), "in the future"),
    "has no time": (lambda state: replace(state, time_s=math.nan), "not finite"),
    "is nothing": (lambda state: 3, "does not answer"),
    "raises": (OSError("no route to host"), "OSError: no route to host"),
}


@pytest.mark.parametrize("name", ARM)
def test_an_arm_that_reports_something_impossible_is_a_fault(cell, watched, name):
    cell.answers["arm"], words = ARM[name]
    with pytest.raises(CellFault, match=words):
        watched.arm()


def test_joints_that_jump_are_a_fault(cell, watched):
    watched.arm()
    cell.answers["arm"] = lambda state: joints(state, 0, state.positions[0] + 0.3)
    with pytest.raises(CellFault, match=r"jumped by 0\.300 rad in 0\.000 s"):
        watched.arm()
    cell.wait(0.1)  # in 0.1 s, pi rad/s are 0.314 rad
    watched.arm()


GRIPPER = {
    "is fault": (lambda state: replace(state, fault="too hot"), "too hot"),
    "is not finite": (lambda state: replace(state, opening=math.inf), "not finite"),
    "is beyond its stroke": (lambda state: replace(state, opening=0.2), "from 0 to 0.085"),
    "is negative": (lambda state: replace(state, opening=-0.02), "from 0 to 0.085"),
    "is old": (lambda state: replace(state, time_s=state.time_s - 0.3), "old"),
    "raises": (TimeoutError("timed out"), "timed out"),
}


@pytest.mark.parametrize("name", GRIPPER)
def test_a_gripper_that_reports_something_impossible_is_a_fault(cell, watched, name):
    cell.answers["gripper"], words = GRIPPER[name]
    with pytest.raises(CellFault, match=words):
        watched.gripper()


def test_openings_are_within_the_stroke(cell, watched):
    cell.answers["gripper"] = lambda state: replace(state, opening=STROKE + 0.001)
    assert watched.gripper().opening == STROKE


def test_the_clock_has_to_run(cell, watched):
    watched.now()
    cell.answers["now"] = lambda true: true - 0.5
    with pytest.raises(CellFault, match="went back"):
        watched.now()
    cell.answers["now"] = math.nan
    with pytest.raises(CellFault, match="not finite"):
        watched.now()
    cell.answers.clear()
    cell.answers["wait"] = False
    with pytest.raises(CellFault, match="stands still"):
        watched.wait(0.02)
    cell.answers["wait"] = lambda true: setattr(cell, "time", cell.time + 3.0)
    with pytest.raises(CellFault, match=r"advanced by 3\.000 s"):
        watched.wait(0.02)


def test_a_simulation_that_diverges_is_no_fault_of_the_cell(cell, watched):
    cell.answers["arm"] = SimulationError("a pose is not finite")
    with pytest.raises(SimulationError):
        watched.arm()


def test_a_robot_that_does_not_come_to_rest_is_a_fault(cell, watched):
    cell.answers["arm"] = lambda state: replace(state, velocities=np.full(6, 0.1))
    with pytest.raises(CellFault, match="the arm is still moving 3 s"):
        watched.rest()
    cell.answers["arm"] = None
    cell.answers["gripper"] = lambda state: replace(state, is_moving=True)
    with pytest.raises(CellFault, match=r"the gripper is still moving 0\.5 s"):
        watched.rest(0.5)


FRAMES = {
    "is late": (lambda frame: replace(frame, time_s=0.5), "exposed 1.* s ago, before the robot came to rest"),
    "is of the future": (lambda frame: replace(frame, time_s=frame.time_s + 9.0), "in the future"),
    "has no time": (lambda frame: replace(frame, time_s=math.nan), "not finite"),
    "is black": (lambda frame: replace(frame, image=np.zeros_like(frame.image)), "black"),
    "is grey": (lambda frame: replace(frame, image=np.full_like(frame.image, 128)), "shows nothing"),
    "is torn": (lambda frame: replace(frame, image=np.vstack([frame.image[:40], 0 * frame.image[40:]])), "incomplete"),
    "is of floats": (lambda frame: replace(frame, image=frame.image / 255.0), "uint8"),
    "is grey only": (lambda frame: replace(frame, image=frame.image[..., 0]), r"\[H, W, 3\]"),
    "is no array": (lambda frame: replace(frame, image=None), "uint8"),
    "is nothing": (lambda frame: None, "does not answer"),
    "raises": (RuntimeError("no device"), "no device"),
}


@pytest.mark.parametrize("name", FRAMES)
def test_a_frame_that_cannot_be_used_is_waited_out_and_then_named(cell, watched, name):
    alter, words = FRAMES[name]
    cell.answers["frame"] = alter
    started = cell.now()
    with pytest.raises(PerceptionError, match=f"no usable image within 1 s: .*{words}"):
        watched.frame_after(started)
    assert 1.0 < cell.now() - started < 1.2
    cell.answers["frame"] = None
    assert watched.frame_after(cell.now()).time_s > started


def test_images_that_repeat_are_frozen_unless_the_camera_has_no_noise(cell):
    watched = WatchedCell(cell, STROKE)
    first = watched.frame_after(0.0)
    cell.answers["frame"] = lambda frame: CameraFrame(first.image, frame.time_s)
    with pytest.raises(PerceptionError, match="frozen"):
        watched.frame_after(cell.now())
    noiseless = WatchedCell(cell, STROKE, WatchdogLimits(sensor_noise=False))
    noiseless.frame_after(0.0)
    assert noiseless.frame_after(cell.now()).image is first.image


def test_an_image_of_another_size_is_refused(cell, watched):
    watched.frame_after(0.0)
    cell.answers["frame"] = lambda frame: replace(frame, image=frame.image[::2].copy())
    with pytest.raises(PerceptionError, match="shape"):
        watched.frame_after(cell.now())


def test_an_arm_at_rest_stays_where_it_is(cell, watched):
    """However slowly it moved meanwhile, or however seldom it was asked."""
    watched.rest()
    watched.wait(5.0)
    watched.rest()
    cell.follow(PlanarKinematics().path(cell.arm().positions, GripperMotion(left=0.0125)))
    watched.wait(5.0)
    with pytest.raises(CellFault, match=r"the arm moved by 0.050 rad without a command"):
        watched.rest()


def test_halting_stops_and_sees_that_the_arm_is_at_rest(cell, watched):
    cell.follow(PlanarKinematics().path(cell.arm().positions, GripperMotion(forward=0.1)))
    cell.wait(0.3)
    assert watched.halt() is None
    assert cell.num_stops == 1 and not cell.is_moving
    assert -0.2 < cell.state.gripper_pose[0] < -0.1


@pytest.mark.parametrize("broken", ["arm", "now"])
def test_halting_never_raises_and_says_what_is_not_known(cell, watched, broken):
    cell.answers[broken] = OSError("no route to host")
    assert "no route to host" in watched.halt()
    assert cell.num_stops == 1


def test_an_arm_that_goes_on_moving_is_not_at_rest(cell, watched):
    cell.answers["arm"] = lambda state: replace(state, velocities=np.full(6, 0.1))
    assert "still moves at 0.100 rad/s" in watched.halt()


def test_limits_are_positive():
    with pytest.raises(ConfigError, match="max_view_age_s"):
        WatchdogLimits(max_view_age_s=0.0)
