"""The real cell, against a controller, a gripper and a camera that speak the same protocols."""

import threading
import time

import numpy as np
import pytest

from tests.embodiment.fake_ur import FakeCapture, FakeController, FakeGripper
from tests.embodiment.planar_cell import PlanarKinematics, Seen, pushing_task
from visualrhp.embodiment.opencv_camera import OpenCvCamera, OpenCvParameters
from visualrhp.embodiment.robot_cell import JointTrajectory
from visualrhp.embodiment.robot_world import RobotWorld
from visualrhp.embodiment.robotiq_gripper import RobotiqParameters
from visualrhp.embodiment.ur_rtde_cell import UrRtdeCell, UrRtdeParameters
from visualrhp.errors import CellFault, ConfigError
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.types import State

CAMERA = OpenCvParameters(width=64, height=48, timeout_s=0.5)


class Lab:
    """A cell, and the devices behind it."""

    def __init__(self):
        self.controller, self.gripper, self.capture = FakeController(), FakeGripper(), FakeCapture()
        self.cells = []

    def open(self, **options):
        settings = UrRtdeParameters(
            host="127.0.0.1",
            frequency=100.0,
            gripper=RobotiqParameters(port=self.gripper.port, timeout_s=0.5),
            camera=CAMERA,
        )

        def open_camera(parameters, clock):
            return OpenCvCamera(parameters, clock, lambda device: self.capture)

        cell = UrRtdeCell(settings, import_module=self.controller.modules, open_camera=open_camera, **options)
        self.cells.append(cell)
        return cell


@pytest.fixture
def lab():
    lab = Lab()
    yield lab
    for cell in lab.cells:
        cell.close()
    lab.gripper.close()


def path(cell, duration=0.2, change=0.1):
    start = cell.arm().positions
    return JointTrajectory(np.array([0.0, duration]), np.stack([start, start + [change, 0, 0, 0, 0, 0]]))


def watch(cell, duration):
    """Ask for the state of the arm, as the loop does; return the last one."""
    end = time.monotonic() + duration
    state = cell.arm()
    while time.monotonic() < end:
        cell.wait(0.02)
        state = cell.arm()
    return state


def test_the_cell_reports_arm_gripper_and_camera_on_one_clock(lab):
    cell = lab.open()
    arm, gripper, frame = cell.arm(), cell.gripper(), cell.frame()
    np.testing.assert_array_equal(arm.positions, lab.controller.positions)
    assert arm.fault is None and gripper.fault is None
    for time_s in (arm.time_s, gripper.time_s, frame.time_s):
        assert -1e-3 <= cell.now() - time_s < 0.5
    assert frame.image.shape == (48, 64, 3)
    assert "SET ACT 1" in lab.gripper.requests, "the gripper is activated"


def test_the_arm_follows_and_stops_at_the_end(lab):
    cell = lab.open()
    trajectory = path(cell)
    cell.follow(trajectory)
    state = watch(cell, 0.5)
    np.testing.assert_allclose(state.positions, trajectory.positions[-1])
    targets = np.array(lab.controller.targets)
    assert (np.diff(targets[:, 0]) >= 0.0).all() and np.abs(np.diff(targets[:, 0])).max() < 0.05
    assert lab.controller.calls[-1] == "servoStop" and state.fault is None


def test_the_gripper_is_commanded(lab):
    cell = lab.open()
    cell.move_gripper(0.0)
    assert lab.gripper.requests[-1].startswith("SET POS 255")


def test_stopping_ends_a_motion_at_once(lab):
    cell = lab.open()
    cell.follow(path(cell, duration=5.0))
    watch(cell, 0.1)
    cell.stop()
    number = len(lab.controller.targets)
    assert 0 < number < 60
    time.sleep(0.1)
    assert len(lab.controller.targets) == number
    assert {"servoStop", "stopJ"} <= set(lab.controller.calls) and lab.gripper.variables["GTO"] == 0


def test_a_new_motion_replaces_one_in_progress(lab):
    cell = lab.open()
    cell.follow(path(cell, duration=5.0, change=3.0))
    watch(cell, 0.1)
    back = path(cell, change=-0.05)
    cell.follow(back)
    np.testing.assert_allclose(watch(cell, 0.5).positions, back.positions[-1])


def test_the_arm_stops_when_nobody_watches(lab):
    cell = lab.open()
    cell.follow(path(cell, duration=5.0))
    time.sleep(0.6)
    number = len(lab.controller.targets)
    assert number < 60 and lab.controller.calls[-1] == "servoStop"
    assert "nobody has watched" in cell.arm().fault


@pytest.mark.parametrize(("mode", "words"), [(3, "protective stop"), (7, "emergency stop"), (77, "safety mode 77")])
def test_stops_of_the_controller_are_faults(lab, mode, words):
    cell = lab.open()
    lab.controller.safety_mode = mode
    assert words in cell.arm().fault
    lab.controller.safety_mode = 1
    assert cell.arm().fault is None


def test_an_arm_that_is_switched_off_is_a_fault(lab):
    cell = lab.open()
    lab.controller.robot_mode = 3
    assert "not running" in cell.arm().fault


def test_a_motion_that_the_controller_refuses_is_a_fault(lab):
    cell = lab.open()
    lab.controller.refuses = True
    cell.follow(path(cell))
    assert "refuses" in watch(cell, 0.1).fault


def test_an_error_of_the_connection_in_motion_is_a_fault(lab):
    cell = lab.open()
    lab.controller.breaks = RuntimeError("RTDE control script is not running")
    cell.follow(path(cell))
    assert "script is not running" in watch(cell, 0.1).fault
    cell.stop()
    cell.close()


def test_a_lost_connection_is_a_fault(lab):
    cell = lab.open()
    lab.controller.is_connected = False
    with pytest.raises(CellFault, match="lost"):
        cell.arm()


def test_reports_that_stand_still_grow_old(lab):
    cell = lab.open()
    cell.arm()
    lab.controller.is_frozen = True
    first = cell.arm().time_s
    time.sleep(0.3)
    assert cell.arm().time_s == pytest.approx(first) and cell.now() - cell.arm().time_s > 0.25


def test_a_dry_run_reads_and_never_commands(lab):
    cell = lab.open(read_only=True)
    assert cell.arm().fault is None and cell.gripper().opening > 0.08
    assert lab.controller.frequencies == [100.0], "the control interface is not opened"
    for command in (lambda: cell.follow(path(cell)), lambda: cell.move_gripper(0.0)):
        with pytest.raises(CellFault, match="dry run"):
            command()
    cell.stop()
    cell.close()
    assert not any(request.startswith("SET") for request in lab.gripper.requests)
    assert lab.controller.calls == ["receive.disconnect"]


def test_closing_stops_and_releases_everything_once(lab):
    cell = lab.open()
    cell.close()
    cell.close()
    calls = lab.controller.calls
    assert calls.count("receive.disconnect") == calls.count("control.disconnect") == 1 and lab.capture.is_released


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"cannot_connect": True}, CellFault, "cannot be reached .*Connection refused"),
        ({"robot_mode": 3}, CellFault, "not running .robot mode 3"),
        ({"safety_mode": 3}, CellFault, "protective stop"),
    ],
)
def test_a_robot_that_is_not_ready_is_named(lab, change, error, words):
    vars(lab.controller).update(change)
    with pytest.raises(error, match=words):
        lab.open()


def test_a_missing_package_is_named(lab):
    def missing(name):
        raise ImportError(name)

    lab.controller.modules = missing
    with pytest.raises(ConfigError, match="pip install ur_rtde"):
        lab.open()


def test_the_host_is_needed():
    with pytest.raises(ConfigError, match="host is empty"):
        UrRtdeParameters(host=" ")


# ------------------------------------------------------------------------------------------------ the loop on this cell
class Staring:
    """Sees a scene in which nothing moves."""

    task = pushing_task()

    def perceive(self, frame, arm, gripper, closed):
        pose = PlanarKinematics().forward(arm.positions)
        state = self.task.state
        seen = State.create((pose.x, pose.y, pose.theta), gripper.opening, closed, state.object_poses)
        return Seen(self.task.scene, seen)


@pytest.fixture
def world(lab):
    lab.capture = FakeCapture(is_still=True)
    lab.controller.positions = PlanarKinematics().joints((-0.2, 0.0, 0.0)).tolist()
    cell = lab.open()
    return RobotWorld(cell, Staring(), PlanarKinematics(), make_action_space("continuous"), host_clock=time.monotonic)


def test_the_loop_moves_a_real_cell(lab, world):
    world.observe()
    world.act(np.array([0.3, 0.1, 0.0, 1.0]))
    _, state = world.observe()
    # On a busy machine the stream of positions is a few cycles late when the arm is slow enough to count as at rest.
    np.testing.assert_allclose(state.gripper_pose, [-0.17, 0.01, 0.0], atol=5e-4)
    assert state.gripper_closed and lab.gripper.variables["POS"] == 255
    assert 0.0 < world.latencies[0].view_age_s < 0.6 and world.fault is None


def test_a_protective_stop_in_motion_stops_the_loop(lab, world):
    world.observe()
    timer = threading.Timer(0.2, lambda: setattr(lab.controller, "safety_mode", 3))
    timer.start()
    with pytest.raises(CellFault, match="protective stop"):
        world.act(np.array([0.8, 0.0, 0.0, -1.0]))
    timer.join()
    number = len(lab.controller.targets)
    time.sleep(0.1)
    assert len(lab.controller.targets) == number and "stopJ" in lab.controller.calls
    with pytest.raises(CellFault, match="stopped before"):
        world.observe()
