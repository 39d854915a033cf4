from dataclasses import replace

import numpy as np
import pytest

from tests.embodiment.simulated_cell.cells import APPLE, BOTTLE, BOX, CUP, EVERYTHING, LYING_BOTTLE, ORANGE, cell_of
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.robot_cell import JointTrajectory
from visualrhp.embodiment.simulated_cell.cell import TIME_STEP, SimulatedCell
from visualrhp.embodiment.simulated_cell.model import OBJECT_PREFIX, cell_model
from visualrhp.embodiment.simulated_cell.objects import CellObject
from visualrhp.embodiment.simulated_cell.solids import box, fruit
from visualrhp.embodiment.trajectories import MotionParameters
from visualrhp.errors import ConfigError, SimulationError, UnreachableError
from visualrhp.simulation import rules
from visualrhp.simulation.action_spaces import GripperMotion

PLACES = [(0.1, 0.1, 0.3), (0.1, -0.1, 0.0), (0.0, 0.18, 0.0), (0.0, -0.18, 0.0), (0.2, 0.0, 1.57), (-0.05, 0.1, 0.4)]


@pytest.fixture(scope="module")
def kinematics() -> ArmKinematics:
    return ArmKinematics()


def move(
    cell: SimulatedCell, kinematics: ArmKinematics, forward: float = 0.0, left: float = 0.0, rotation: float = 0.0
) -> JointTrajectory:
    """Execute a motion, and wait until everything is at rest."""
    trajectory = kinematics.path(cell.arm().positions, GripperMotion(forward, left, rotation))
    cell.follow(trajectory)
    cell.wait(trajectory.duration + 0.2)
    for _ in range(15):
        if cell.is_at_rest():
            break
        cell.wait(0.1)
    return trajectory


def test_equal_tasks_and_commands_give_equal_states_to_the_bit(kinematics) -> None:
    def run() -> np.ndarray:
        cell = cell_of(*zip(EVERYTHING, PLACES, strict=True))
        move(cell, kinematics, forward=0.1, rotation=0.3)
        cell.move_gripper(0.0)
        move(cell, kinematics, left=0.05)
        return cell.snapshot().physics

    assert run().tobytes() == run().tobytes()


def test_how_time_is_cut_into_pieces_does_not_matter(kinematics) -> None:
    trajectory = kinematics.path(cell_of((APPLE, (0.0, 0.0, 0.0))).arm().positions, GripperMotion(0.1, 0.0, 0.2))
    ends = []
    for pieces in (1, 7, 100):
        cell = cell_of((APPLE, (0.0, 0.0, 0.0)))
        cell.follow(trajectory)
        cell.move_gripper(0.03)
        for _ in range(pieces):
            cell.wait(1.4 / pieces)
        assert cell.now() == pytest.approx(1.4)
        ends.append(cell.snapshot().physics)
    assert np.array_equal(ends[0], ends[1])
    assert np.array_equal(ends[0], ends[2])


def test_a_snapshot_is_everything(kinematics) -> None:
    cell = cell_of((ORANGE, (-0.06, 0.0, 0.0)))
    trajectory = kinematics.path(cell.arm().positions, GripperMotion(0.1, 0.0, 0.0))
    cell.follow(trajectory)
    cell.wait(0.3)
    middle = cell.snapshot()
    cell.wait(1.5)
    end = cell.snapshot().physics
    cell.restore(middle)
    assert cell.now() == pytest.approx(0.3)
    cell.wait(1.5)
    assert np.array_equal(cell.snapshot().physics, end)


def test_objects_that_nothing_touches_stay_where_they_are() -> None:
    cell = cell_of(*zip(EVERYTHING, PLACES, strict=True))
    start = cell.truth().state
    assert cell.is_at_rest()
    cell.wait(5.0)
    assert cell.truth().state.vector == pytest.approx(start.vector, abs=5e-4)
    assert cell.truth().is_lying == tuple(thing.is_lying for thing in EVERYTHING)


def test_the_clock_counts_what_was_waited_and_nothing_else() -> None:
    cell = cell_of((APPLE, (0.0, 0.0, 0.0)))
    assert cell.now() == 0.0
    cell.move_gripper(0.0)
    assert cell.now() == cell.arm().time_s == cell.gripper().time_s == 0.0
    for _ in range(10):
        cell.wait(0.1 * TIME_STEP)
    assert cell.now() == pytest.approx(TIME_STEP)
    with pytest.raises(ConfigError, match="time does not go back"):
        cell.wait(-0.1)


@pytest.mark.parametrize("motion", [(0.1, 0.0, 0.0), (0.0, -0.1, 0.0), (0.05, 0.05, 0.87), (0.0, 0.0, -0.87)])
def test_the_arm_follows_the_trajectory(kinematics, motion) -> None:
    """Within 2 mm on the way, and 1 mm and 0.2 degrees at the end."""
    cell = cell_of((APPLE, (0.2, 0.2, 0.0)))
    trajectory = kinematics.path(cell.arm().positions, GripperMotion(*motion))
    cell.follow(trajectory)
    for time in np.arange(0.05, trajectory.duration, 0.05):
        cell.wait(0.05)
        wanted = [np.interp(time, trajectory.times, joint) for joint in trajectory.positions.T]
        seen, planned = kinematics.forward(cell.arm().positions), kinematics.forward(wanted)
        assert np.hypot(seen.x - planned.x, seen.y - planned.y) < 1e-3
        assert seen.height == pytest.approx(planned.height, abs=5e-4)
    cell.wait(0.3)
    seen, planned = kinematics.forward(cell.arm().positions), kinematics.forward(trajectory.positions[-1])
    assert (seen.x, seen.y) == pytest.approx((planned.x, planned.y), abs=2e-4)
    assert seen.theta == pytest.approx(planned.theta, abs=1e-3)
    assert np.abs(cell.arm().velocities).max() < 1e-2


def test_the_gripper_pose_is_that_of_the_kinematics(kinematics) -> None:
    cell = cell_of((APPLE, (0.1, 0.1, 0.0)), gripper=(-0.1, -0.2, 1.2))
    tool = kinematics.forward(cell.arm().positions)
    assert cell.truth().state.gripper_pose == pytest.approx([-0.1, -0.2, 1.2], abs=1e-5)
    assert (tool.x, tool.y, tool.theta) == pytest.approx((-0.1, -0.2, 1.2), abs=1e-5)


def test_fingers_open_and_close_as_commanded() -> None:
    cell = cell_of((APPLE, (0.2, 0.2, 0.0)))
    assert cell.gripper().opening == pytest.approx(0.085, abs=1e-3)
    assert not cell.gripper().is_moving
    for opening in (0.0, 0.02, 0.05, 0.085):
        cell.move_gripper(opening)
        cell.wait(0.1)
        assert cell.gripper().is_moving
        cell.wait(1.6)
        assert not cell.gripper().is_moving
        assert cell.gripper().opening == pytest.approx(opening, abs=1.5e-3)
        assert cell.truth().state.gripper_closed == (opening < 0.04)


@pytest.mark.parametrize("thing", EVERYTHING, ids=lambda thing: f"{thing.kind} {thing.is_lying}")
def test_a_push_moves_an_object_by_what_is_pushed(kinematics, thing) -> None:
    """Its rear is where the closed gripper ends; what is round rolls on."""
    cell = cell_of((thing, (0.0, 0.0, 0.0)))
    cell.move_gripper(0.0)
    cell.wait(1.2)
    move(cell, kinematics, forward=0.1)
    before = cell.truth().outlines[0][:, 0].min()
    move(cell, kinematics, forward=0.1)
    after, tip = cell.truth().outlines[0][:, 0].min(), cell.truth().state.gripper_pose[0] + 0.0285
    assert after - before > 0.03
    assert -0.012 < after - tip < (0.1 if thing.kind in (Kind.APPLE, Kind.ORANGE) else 0.01)


def test_fruit_rolls_on_after_a_fast_push_only_and_a_box_never_does(kinematics) -> None:
    fast = ArmKinematics(motion=MotionParameters(speed=0.15, ramp_s=0.25, brake_s=0.25))
    travelled = {}
    for arm in (fast, kinematics):
        for thing in (ORANGE, BOX):
            cell = cell_of((thing, (0.0, 0.0, 0.0)), gripper=(-0.12, 0.0, 0.0))
            cell.move_gripper(0.0)
            cell.wait(1.2)
            tip = move(cell, arm, forward=0.1) and cell.truth().state.gripper_pose[0] + 0.0285
            travelled[thing.kind, arm is fast] = cell.truth().outlines[0][:, 0].min() - tip
            assert cell.is_at_rest()
    assert 0.01 < travelled.pop((Kind.ORANGE, True)) < 0.15
    assert max(travelled.values()) < 0.005


@pytest.mark.parametrize("thing", EVERYTHING, ids=lambda thing: f"{thing.kind} {thing.is_lying}")
def test_a_grasp_holds(kinematics, thing) -> None:
    cell = cell_of((thing, (0.0, 0.0, 0.0)), gripper=(-0.1, 0.0, 0.0))
    move(cell, kinematics, forward=0.1 - 0.5 * max(0.0, np.ptp(cell.truth().outlines[0][:, 0]) - 0.09))
    cell.move_gripper(0.0)
    cell.wait(1.5)
    assert cell.opening > 0.035, "something is between the fingers"
    before = cell.truth()
    relative = before.state.object_positions[0] - before.state.gripper_position
    for motion in ({"forward": -0.1}, {"left": 0.1}):
        move(cell, kinematics, **motion)
        state = cell.truth().state
        assert state.object_positions[0] - state.gripper_position == pytest.approx(relative, abs=0.01)
    assert cell.opening > 0.035
    place = cell.truth().state.object_positions[0]
    cell.move_gripper(0.085)
    cell.wait(1.0)
    assert cell.opening > 0.08
    assert cell.truth().state.object_positions[0] == pytest.approx(place, abs=0.02), "released, it stays"


def test_tall_and_rough_objects_tip_over(kinematics) -> None:
    """A push 45 mm above the table tips over a bottle with a friction above its radius over that height."""
    rough = CellObject(Kind.BOX, box(0.05, 0.016, 0.09), friction=1.0, mass=0.2)
    cell = cell_of((rough, (-0.03, 0.0, 0.5 * np.pi)))
    cell.move_gripper(0.0)
    cell.wait(1.2)
    move(cell, kinematics, forward=0.1)
    outline = cell.truth().outlines[0]
    assert np.ptp(outline[:, 0]) > 0.07, "it shows its side"
    smooth = CellObject(Kind.BOX, box(0.05, 0.016, 0.09), friction=0.2, mass=0.2)
    cell = cell_of((smooth, (-0.03, 0.0, 0.5 * np.pi)))
    cell.move_gripper(0.0)
    cell.wait(1.2)
    move(cell, kinematics, forward=0.1)
    assert np.ptp(cell.truth().outlines[0][:, 0]) < 0.05, "a smooth one slides"


@pytest.mark.parametrize(
    "thing", [APPLE, CUP, BOTTLE, LYING_BOTTLE, BOX], ids=lambda thing: f"{thing.kind} {thing.is_lying}"
)
def test_what_is_pushed_over_the_edge_falls(kinematics, thing) -> None:
    cell = cell_of((thing, (-0.1, 0.2, 0.0)), gripper=(-0.1, 0.07, 0.5 * np.pi))
    cell.move_gripper(0.0)
    cell.wait(1.2)
    for _ in range(2):
        move(cell, kinematics, forward=0.09)
    cell.wait(1.0)
    truth = cell.truth()
    assert truth.is_fallen == (True,)
    assert rules.is_dropped(truth.scene, truth.state)


def test_stop_brings_the_arm_to_rest_where_it_is(kinematics) -> None:
    cell = cell_of((APPLE, (0.2, 0.2, 0.0)))
    trajectory = kinematics.path(cell.arm().positions, GripperMotion(0.1, 0.0, 0.0))
    cell.follow(trajectory)
    cell.move_gripper(0.0)
    cell.wait(0.4)
    stopped = kinematics.forward(cell.arm().positions)
    cell.stop()
    opening = cell.opening
    cell.wait(0.5)
    rest = kinematics.forward(cell.arm().positions)
    assert np.abs(cell.arm().velocities).max() < 1e-3
    assert np.hypot(rest.x - stopped.x, rest.y - stopped.y) < 0.01
    assert cell.opening == pytest.approx(opening, abs=0.02)
    cell.wait(1.0)
    assert kinematics.forward(cell.arm().positions).x == pytest.approx(rest.x, abs=1e-5)


def test_a_new_motion_replaces_the_one_in_progress(kinematics) -> None:
    cell = cell_of((APPLE, (0.2, 0.2, 0.0)))
    cell.follow(kinematics.path(cell.arm().positions, GripperMotion(0.1, 0.0, 0.0)))
    cell.wait(0.3)
    cell.stop()
    cell.wait(0.3)
    trajectory = kinematics.path(cell.arm().positions, GripperMotion(0.0, 0.05, 0.0))
    cell.follow(trajectory)
    cell.wait(trajectory.duration + 0.3)
    assert cell.arm().positions == pytest.approx(trajectory.positions[-1], abs=1e-4)


def test_without_a_camera_there_are_no_images() -> None:
    cell = cell_of((APPLE, (0.0, 0.0, 0.0)))
    for look in (cell.frame, cell.picture, cell.instance_mask, cell.detections, cell.side_view):
        with pytest.raises(ConfigError, match="without a camera"):
            look()
    cell.close()
    cell.close()


def test_a_start_that_the_arm_cannot_reach_is_refused() -> None:
    with pytest.raises(UnreachableError):
        cell_of((CellObject(Kind.APPLE, fruit(0.03)), (0.0, 0.0, 0.0)), gripper=(0.9, 0.0, 0.0))


@pytest.mark.parametrize("speed", [30.0, 1e12, np.nan], ids=["catapulted", "huge", "not a number"])
def test_physics_that_diverges_is_an_error_until_a_sound_state_is_restored(speed: float) -> None:
    cell = cell_of((BOX, (0.1, 0.1, 0.0)))
    sound = cell.snapshot()
    model = cell_model(cell.task)
    physics = sound.physics.copy()  # time, positions, velocities
    physics[1 + model.nq + int(model.body(f"{OBJECT_PREFIX}0").dofadr[0])] = speed
    cell.restore(replace(sound, physics=physics))
    with pytest.raises(SimulationError, match=r"the physics of the cell diverged at 1\.000 s"):
        cell.wait(1.0)
    cell.restore(sound)
    cell.wait(1.0)
    assert not cell.truth().is_fallen[0]
