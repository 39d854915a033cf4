"""Motions: what is refused before it starts, and what stops one that is under way."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.embodiment.planar_cell import PlanarCell, PlanarKinematics, ToolPose, pushing_task
from visualrhp.embodiment.motion import MotionLimits, check_trajectory, execute
from visualrhp.embodiment.robot_cell import ArmLimits, ArmState, JointTrajectory
from visualrhp.embodiment.watchdog import WatchedCell
from visualrhp.errors import CellFault, UnreachableError
from visualrhp.simulation.action_spaces import MAX_ROTATION, GripperMotion

KINEMATICS = PlanarKinematics()
MOTION = GripperMotion(forward=0.1, left=-0.05, rotation=0.5)
START = KINEMATICS.joints((-0.1, 0.05, 0.3))
ARM = ArmState(START, np.zeros(6), 0.0)


def check(trajectory, motion=MOTION, kinematics=KINEMATICS, limits=None, arm_limits=None):
    check_trajectory(trajectory, ARM, motion, kinematics, limits or MotionLimits(), arm_limits or ArmLimits())


@given(forward=st.floats(-0.1, 0.1), left=st.floats(-0.1, 0.1), rotation=st.floats(-MAX_ROTATION, MAX_ROTATION))
@settings(max_examples=60, deadline=None)
def test_every_path_of_the_kinematics_passes(forward, left, rotation):
    motion = GripperMotion(forward, left, rotation)
    if motion != GripperMotion():
        check(KINEMATICS.path(START, motion), motion)


GOOD = KINEMATICS.path(START, MOTION)


def shifted(index, amount, where=slice(None)):
    positions = GOOD.positions.copy()
    positions[where, index] += amount
    return JointTrajectory(GOOD.times, positions)


WRONG = {
    "no path": (JointTrajectory(np.zeros(1), START[None]), "times"),
    "not finite": (shifted(1, math.nan, 3), "not finite"),
    "too long": (JointTrajectory(GOOD.times * 20.0, GOOD.positions), "at most 10 s"),
    "time goes back": (JointTrajectory(-GOOD.times, GOOD.positions), "increasing times"),
    "another start": (shifted(0, 0.01), "starts 0.0100 rad from where the arm is"),
    "too fast": (JointTrajectory(GOOD.times / 20.0, GOOD.positions), "as fast as a joint may move"),
    "a jerk": (shifted(0, 0.02, slice(20, 21)), "accelerates"),
    "another end": (shifted(0, 0.02 * np.linspace(0.0, 1.0, len(GOOD.times)) ** 2), "from the commanded"),
    "another heading": (shifted(5, 0.02 * np.linspace(0.0, 1.0, len(GOOD.times)) ** 2), "commanded heading"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_trajectory_that_is_not_the_commanded_one_is_refused(name):
    trajectory, words = WRONG[name]
    with pytest.raises(UnreachableError, match=f"refused before it started.*{words}"):
        check(trajectory)


def test_limits_of_joints_and_workspace_are_kept():
    limits = ArmLimits()
    with pytest.raises(UnreachableError, match="range of a joint"):
        check(GOOD, arm_limits=replace(limits, upper=np.minimum(limits.upper, 0.5)))
    with pytest.raises(UnreachableError, match="workspace"):
        check(GOOD, limits=MotionLimits(workspace=0.05))


@pytest.mark.parametrize(("change", "words"), [({"height": 0.05}, "height"), ({"tilt": 0.02}, "tilts")])
def test_the_gripper_stays_level_at_its_height(change, words):
    class Sagging(PlanarKinematics):
        def forward(self, positions) -> ToolPose:
            return replace(super().forward(positions), **change)

    with pytest.raises(UnreachableError, match=words):
        check(GOOD, kinematics=Sagging())


class Misbehaving(PlanarCell):
    """A cell that does something else than what it is commanded to."""

    def __init__(self, alter=None, grips=True):
        super().__init__(pushing_task())
        self.alter, self.grips = alter, grips

    def follow(self, trajectory):
        super().follow(self.alter(trajectory) if self.alter else trajectory)

    def move_gripper(self, opening):
        if self.grips:
            super().move_gripper(opening)


def run(cell, opening=None, motion=None):
    watched = WatchedCell(cell, 0.085)
    return execute(watched, KINEMATICS.path(cell.arm().positions, motion or GripperMotion(forward=0.08)), opening)


def test_a_motion_is_watched_until_rest():
    cell = Misbehaving()
    duration = run(cell, opening=0.0)
    assert not cell.is_moving and cell.state.gripper_closed
    assert cell.state.gripper_pose[0] == pytest.approx(-0.12)
    assert 0.8 <= duration <= 0.85
    assert execute(WatchedCell(cell, 0.085), None, 0.085) == pytest.approx(0.4, abs=0.03)
    assert cell.state.gripper_opening == pytest.approx(0.085, abs=1e-3)


def test_an_arm_that_stays_is_a_fault_within_a_few_millimetres():
    cell = Misbehaving(lambda path: JointTrajectory(path.times, np.repeat(path.positions[:1], len(path.times), axis=0)))
    with pytest.raises(CellFault, match="does not follow"):
        run(cell)
    assert cell.time < 1.7


def test_an_arm_that_ends_elsewhere_is_a_fault():
    def bend(path):
        positions = path.positions.copy()
        positions[:, 1] += 0.04 * path.times / path.duration  # within what is allowed in motion
        return JointTrajectory(path.times, positions)

    with pytest.raises(CellFault, match=r"came to rest 0\.040 rad from the end"):
        run(Misbehaving(bend))


def test_an_arm_that_is_a_little_late_is_waited_for():
    late = 0.1
    cell = Misbehaving(
        lambda path: JointTrajectory(
            np.concatenate([[0.0], path.times + late]), np.vstack([path.positions[:1], path.positions])
        )
    )
    assert run(cell) > 0.8


@pytest.mark.parametrize(("opening", "what"), [(0.0, "close"), (0.085, "open")])
def test_fingers_that_do_not_move_are_a_fault(opening, what):
    cell = Misbehaving(grips=False)
    if opening:
        cell.state = type(cell.state).create(cell.state.gripper_pose, 0.03, True, cell.state.object_poses)
    with pytest.raises(CellFault, match=f"does not {what}"):
        execute(WatchedCell(cell, 0.085), None, opening)


def test_fingers_that_hold_something_need_not_move():
    cell = Misbehaving(grips=False)
    cell.state = type(cell.state).create(cell.state.gripper_pose, 0.04, True, cell.state.object_poses)
    execute(WatchedCell(cell, 0.085), None, 0.0)
