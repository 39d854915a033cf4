"""Kinematics of the arm against MuJoCo, finite differences and round trips; paths against the line they follow."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from visualrhp.embodiment.kinematics import STRAIGHT_ELBOW, ArmKinematics
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.reach import ReachMap, displacement_of
from visualrhp.embodiment.robot_cell import ArmLimits
from visualrhp.embodiment.robot_model import (
    FLANGE_ABOVE,
    FLANGE_BEHIND,
    GRIPPER_HEIGHT,
    HOME,
    Mounting,
    flange_to_gripper,
    robot_spec,
)
from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
from visualrhp.embodiment.simulated_cell.sampling import CellDistribution, sample_cell
from visualrhp.embodiment.trajectories import MotionParameters
from visualrhp.errors import UnreachableError
from visualrhp.simulation.action_spaces import MAX_ROTATION, MAX_TRANSLATION, ContinuousActionSpace, GripperMotion
from visualrhp.streams import Split
from visualrhp.types import wrap_angle

MOUNTINGS = (Mounting(), Mounting(-0.5, 0.1, 0.15, 0.3), Mounting(0.1, -0.6, -0.05, 2.0))
KINEMATICS = ArmKinematics()
REACH = ReachMap.load()

reals = st.floats(-1.0, 1.0)
poses = st.builds(lambda x, y, t: np.array([0.3 * x, 0.3 * y, math.pi * t]), reals, reals, reals)
motions = st.builds(
    lambda x, y, t: GripperMotion(MAX_TRANSLATION * x, MAX_TRANSLATION * y, MAX_ROTATION * t), reals, reals, reals
)


def random_joints(rng: np.random.Generator) -> Any:
    return rng.uniform(-np.pi, np.pi, 6)


def grid() -> Any:
    """[N, 3] poses over the table."""
    places, headings = np.linspace(-0.25, 0.25, 11), np.linspace(-np.pi, np.pi, 24, endpoint=False)
    return np.stack(np.meshgrid(places, places, headings), axis=-1).reshape(-1, 3)


def between_samples(trajectory: Any, count: int) -> Any:
    """[count, 6] positions at times that are no samples."""
    times = np.linspace(0.0, trajectory.duration, count)
    return np.stack([np.interp(times, trajectory.times, column) for column in trajectory.positions.T], axis=1)


# ------------------------------------------------------------------------------------------------------------- forward
def test_the_stretched_arm_by_hand() -> None:
    """All joints at 0: the arm points along -x of its base, by the lengths of Menagerie's model."""
    mounting = Mounting(0.0, 0.0, 0.0, 0.0)
    tool = ArmKinematics(mounting).tool_transform(np.zeros(6))
    flange = tool @ np.linalg.inv(flange_to_gripper())
    assert flange[:3, 3] == pytest.approx([-(0.425 + 0.392), -(0.134 + 0.1), 0.163 - 0.1], abs=1e-6)


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_forward_kinematics_are_those_of_mujoco(mounting: Mounting) -> None:
    mujoco = robot_package("mujoco")
    model = robot_spec(mounting).compile()
    data, kinematics = mujoco.MjData(model), ArmKinematics(mounting)
    for seed in range(20):
        joints = data.qpos[:6] = random_joints(np.random.default_rng(seed))
        mujoco.mj_kinematics(model, data)
        flange = np.eye(4)
        flange[:3, :3] = data.site("attachment_site").xmat.reshape(3, 3)
        flange[:3, 3] = data.site("attachment_site").xpos
        assert kinematics.tool_transform(joints) == pytest.approx(flange @ flange_to_gripper(), abs=1e-6)


def test_forward_names_what_the_transform_says() -> None:
    joints = random_joints(np.random.default_rng(0))
    transform, tool = KINEMATICS.tool_transform(joints), KINEMATICS.forward(joints)
    assert (tool.x, tool.y, tool.height) == pytest.approx(tuple(transform[:3, 3]))
    assert math.cos(tool.tilt) == pytest.approx(transform[2, 2])
    assert [math.cos(tool.theta), math.sin(tool.theta)] == pytest.approx(
        list(transform[:2, 0] / np.linalg.norm(transform[:2, 0]))
    )


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_the_jacobian_by_finite_differences(mounting: Mounting) -> None:
    kinematics, step = ArmKinematics(mounting), 1e-6
    for seed in range(10):
        joints = random_joints(np.random.default_rng(seed))
        jacobian = kinematics.jacobian(joints)
        for k, unit in enumerate(np.eye(6)):
            after, before = (kinematics.tool_transform(joints + sign * step * unit) for sign in (1, -1))
            velocity = (after - before)[:3] / (2.0 * step)
            spin = velocity[:, :3] @ kinematics.tool_transform(joints)[:3, :3].T
            assert jacobian[:3, k] == pytest.approx(velocity[:, 3], abs=1e-7)
            assert jacobian[3:, k] == pytest.approx([spin[2, 1], spin[0, 2], spin[1, 0]], abs=1e-7)


# ------------------------------------------------------------------------------------------------------------- inverse
def test_forward_of_inverse_over_the_whole_reach_of_the_table() -> None:
    """A grid of poses: what the map contains has a solution, level at its height, and home's posture."""
    inside = REACH.contains(grid())
    assert inside.mean() > 0.95
    for pose in grid()[inside][::7]:
        joints = KINEMATICS.inverse(*pose, near=HOME)
        tool = KINEMATICS.forward(joints)
        assert (tool.x, tool.y, tool.height) == pytest.approx((pose[0], pose[1], GRIPPER_HEIGHT), abs=1e-9)
        assert wrap_angle(tool.theta - pose[2]) == pytest.approx(0.0, abs=1e-9)
        assert tool.tilt < 1e-7
        assert joints[2] > STRAIGHT_ELBOW
        assert joints[4] == pytest.approx(HOME[4], abs=1e-4)


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("height", [0.02, 0.045, 0.2])
def test_inverse_for_other_mountings_and_heights(mounting: Mounting, height: float) -> None:
    kinematics = ArmKinematics(mounting)
    for theta in (-2.0, 0.0, 3.0):
        tool = kinematics.forward(kinematics.inverse(0.05, 0.02, theta, near=np.zeros(6), height=height))
        assert (tool.x, tool.y, tool.theta, tool.height) == pytest.approx((0.05, 0.02, theta, height), abs=1e-9)


def test_the_nearest_number_of_turns_is_taken() -> None:
    joints = KINEMATICS.inverse(0.0, 0.0, 0.3, near=HOME)
    assert abs(joints[5] - HOME[5]) <= np.pi
    for turns in (-1, 0, 1):
        near = joints + [0.0, 0.0, 0.0, 0.0, 0.0, 2.0 * np.pi * turns]
        again = KINEMATICS.inverse(0.0, 0.0, 0.3, near=near)
        assert again[5] == pytest.approx(near[5] if abs(near[5]) <= 2.0 * np.pi else joints[5])
        assert again[:5] == pytest.approx(joints[:5])


@pytest.mark.parametrize(("x", "y"), [(0.6, 0.0), (-0.5, 0.0), (0.4, 0.5)])
def test_what_is_too_far_or_too_near_is_a_named_error(x: float, y: float) -> None:
    with pytest.raises(UnreachableError, match="from the axis of joint 1, and it reaches"):
        KINEMATICS.inverse(x, y, 0.0, near=HOME)


def test_a_range_without_a_solution_is_a_named_error() -> None:
    limits = ArmLimits(lower=np.full(6, 0.5), upper=np.full(6, 0.6))
    with pytest.raises(UnreachableError, match=r"joint 1 would be at .* no number of turns brings into its range"):
        ArmKinematics(limits=limits).inverse(0.0, 0.0, 0.0, near=HOME)


def test_the_ring_is_where_solutions_end() -> None:
    nearest, farthest = KINEMATICS.ring()
    edge = KINEMATICS.mounting.x + FLANGE_BEHIND
    for radius, is_inside in ((nearest, 1), (farthest, -1)):
        KINEMATICS.inverse(edge + radius + 1e-6 * is_inside, 0.0, 0.0, near=HOME)
        with pytest.raises(UnreachableError):
            KINEMATICS.inverse(edge + radius - 1e-6 * is_inside, 0.0, 0.0, near=HOME)


def test_the_flange_is_above_the_gripper() -> None:
    flange = KINEMATICS.tool_transform(KINEMATICS.inverse(0.1, 0.0, 0.0, near=HOME)) @ np.linalg.inv(
        flange_to_gripper()
    )
    assert flange[:3, 3] == pytest.approx([0.1 - FLANGE_BEHIND, 0.0, GRIPPER_HEIGHT + FLANGE_ABOVE], abs=1e-9)


# --------------------------------------------------------------------------------------------------------------- paths
@settings(max_examples=60, deadline=None)
@given(poses, motions, st.lists(st.floats(-5e-4, 5e-4), min_size=6, max_size=6))
def test_paths_follow_the_line_within_the_limits(pose: Any, motion: GripperMotion, sag: Any) -> None:
    """2 mm and 0.5 degrees are asked for; the commanded joints are much closer, also between their samples."""
    assume(bool(REACH.contains(pose)) and REACH.allows(pose, motion))
    start = KINEMATICS.inverse(*pose, near=HOME) + sag
    first = KINEMATICS.forward(start)
    trajectory = KINEMATICS.path(start, motion)
    limits, steps = ArmLimits(), np.diff(trajectory.times)[:, None]
    velocities = np.diff(trajectory.positions, axis=0) / steps
    assert trajectory.positions[0] == pytest.approx(start)
    assert ((trajectory.positions >= limits.lower) & (trajectory.positions <= limits.upper)).all()
    assert (abs(velocities) <= limits.velocity * (1 + 1e-9)).all()
    assert (abs(np.diff(velocities, axis=0) / steps[1:]) <= limits.acceleration * (1 + 1e-9)).all()
    displacement = displacement_of(first.theta, motion)
    length = float(np.linalg.norm(displacement))
    parts = []
    for joints in between_samples(trajectory, 37):
        tool = KINEMATICS.forward(joints)
        moved = np.array([tool.x - first.x, tool.y - first.y, wrap_angle(tool.theta - first.theta)])
        part = float(moved @ displacement) / max(length, 1e-9) ** 2
        away = moved - part * displacement
        assert math.hypot(*away[:2]) < 5e-4
        assert abs(away[2]) < math.radians(0.1)
        assert abs(tool.height - GRIPPER_HEIGHT) <= abs(first.height - GRIPPER_HEIGHT) + 1e-4
        parts.append(part)
    if length > 0.01:
        assert (np.diff(parts) > -1e-4).all()
        mean_ramp = 0.5 * (MotionParameters().ramp_s + MotionParameters().brake_s)
        speed = np.linalg.norm(displacement[:2]) / (trajectory.duration - mean_ramp)
        assert speed <= MotionParameters().speed * (1 + 1e-9)
    end = KINEMATICS.forward(trajectory.positions[-1])
    assert (end.x, end.y, end.height) == pytest.approx(
        (first.x + displacement[0], first.y + displacement[1], GRIPPER_HEIGHT), abs=1e-9
    )
    assert end.tilt < 1e-7


def test_executed_paths_follow_the_line() -> None:
    """In the simulated cell, whose arm is a mechanism with motors: 2 mm and 0.5 degrees, height within 2 mm."""
    rng, num_motions, moved = np.random.default_rng(0), 0, np.zeros(3)
    for index in range(2):
        cell = SimulatedCell(sample_cell(CellDistribution(num_objects=1), 0, Split.EVALUATION, index), render=False)
        for _ in range(5):
            joints = cell.arm().positions
            first, motion = KINEMATICS.forward(joints), ContinuousActionSpace().motion(rng.uniform(-1.0, 1.0, 4))
            if not REACH.allows((first.x, first.y, first.theta), motion):
                continue
            displacement, trajectory = displacement_of(first.theta, motion), KINEMATICS.path(joints, motion)
            cell.follow(trajectory)
            for _ in range(math.ceil(trajectory.duration / 0.05) + 4):
                cell.wait(0.05)
                tool = KINEMATICS.forward(cell.arm().positions)
                moved = np.array([tool.x - first.x, tool.y - first.y, wrap_angle(tool.theta - first.theta)])
                away = moved - (moved @ displacement) / (displacement @ displacement) * displacement
                assert math.hypot(*away[:2]) < 2e-3
                assert abs(away[2]) < math.radians(0.5)
                assert abs(tool.height - GRIPPER_HEIGHT) < 2e-3
            assert moved == pytest.approx(displacement, abs=1e-3)
            num_motions += 1
        cell.close()
    assert num_motions >= 7


def test_errors_of_the_height_do_not_add_up() -> None:
    """The arm comes to rest 1 mm too low after every motion."""
    joints = KINEMATICS.inverse(0.0, 0.0, 0.0, near=HOME)
    for k in range(10):
        x = KINEMATICS.forward(joints).x
        joints = KINEMATICS.path(joints, GripperMotion(forward=0.02 * (-1) ** k)).positions[-1]
        tool = KINEMATICS.forward(joints)
        joints = KINEMATICS.inverse(tool.x, tool.y, tool.theta, near=joints, height=tool.height - 1e-3)
        assert KINEMATICS.forward(joints).height == pytest.approx(GRIPPER_HEIGHT - 1e-3, abs=1e-9)
        assert tool.x == pytest.approx(x + 0.02 * (-1) ** k, abs=1e-9)


def test_closing_the_fingers_does_not_move_the_arm() -> None:
    start = KINEMATICS.inverse(0.0, 0.0, 0.0, near=HOME)
    trajectory = KINEMATICS.path(start, GripperMotion(closed=True))
    assert trajectory.positions == pytest.approx(np.broadcast_to(start, trajectory.positions.shape), abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 0.5, -2.0, math.pi])
def test_the_yaw_of_the_base_only_turns_joint_1(yaw: float) -> None:
    """At yaw 0 joint 1 points backwards, where the angle of the flange jumps by a turn."""
    other = ArmKinematics(Mounting(yaw=yaw), reach=REACH)
    pose, motion = (-0.15, -0.03, math.pi / 2), GripperMotion(forward=0.1)
    paths = [k.path(k.inverse(*pose, near=HOME), motion) for k in (KINEMATICS, other)]
    turned = paths[1].positions - paths[0].positions
    turned[:, 0] = wrap_angle(turned[:, 0] + yaw - math.pi + 1.0) - 1.0
    turned[:, 5] = wrap_angle(turned[:, 5] + 1.0) - 1.0
    assert turned == pytest.approx(np.zeros_like(turned), abs=1e-9)


@pytest.mark.parametrize(
    ("pose", "motion", "message"),
    [
        ((0.28, 0.0, 0.0), GripperMotion(forward=0.1), "outside the workspace"),
        ((-0.15, 0.0, 0.0), GripperMotion(forward=-0.1), "cannot be taken by the arm"),
        ((0.2, 0.2, -2.3), GripperMotion(forward=-0.1), "cannot be taken by the arm"),
    ],
)
def test_unreachable_motions_are_named_errors(pose: Any, motion: GripperMotion, message: str) -> None:
    start = KINEMATICS.inverse(*pose, near=HOME)
    with pytest.raises(UnreachableError, match=message):
        KINEMATICS.path(start, motion)


def test_a_wound_up_wrist_is_a_named_error() -> None:
    joints, turn = KINEMATICS.inverse(0.0, 0.0, 0.0, near=HOME), GripperMotion(rotation=MAX_ROTATION)
    while abs(joints[5]) <= 2.0 * np.pi - MAX_ROTATION or joints[5] > 0.0:
        joints = KINEMATICS.path(joints, turn).positions[-1]
    with pytest.raises(UnreachableError, match="joint 6 would be at"):
        KINEMATICS.path(joints, turn)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_turning_range_ends_before_the_wrist_is_wound_up(direction: float) -> None:
    """Turning as far as it allows, in place or on the way, is possible for the arm."""
    joints = KINEMATICS.inverse(0.05, 0.0, 0.0, near=HOME)
    motion = GripperMotion(forward=0.02, rotation=0.6 * direction)
    turned = 0.0
    while KINEMATICS.turning_range(joints).allows(pose_at(joints), motion):
        joints = KINEMATICS.path(joints, motion).positions[-1]
        turned += motion.rotation
    assert abs(turned) > 1.0
    assert 2.0 * np.pi - abs(joints[5]) < 0.6 + 0.2  # it is nearly wound up
    back = GripperMotion(rotation=-motion.rotation)
    assert KINEMATICS.turning_range(joints).allows(pose_at(joints), back)


def pose_at(joints: np.ndarray) -> np.ndarray:
    tool = KINEMATICS.forward(joints)
    return np.array([tool.x, tool.y, tool.theta])


def test_the_turning_range_knows_how_far_wrist_3_turns() -> None:
    """At the limits of the range after one and after two motions, against the joints of their paths."""
    rng, num_motions = np.random.default_rng(0), 0
    while num_motions < 60:
        try:
            x, y, theta, *steps = (rng.uniform(-1.0, 1.0, 9) * (0.2, 0.2, np.pi, *([0.1, 0.1, 0.8] * 2))).tolist()
            joints = KINEMATICS.inverse(x, y, theta, near=HOME)
            poses, ways = [pose_at(joints)], [joints]
            motions = [GripperMotion(forward, left, turn) for forward, left, turn in (steps[:3], steps[3:])]
            for motion in motions:
                ways.append(KINEMATICS.path(ways[-1], motion).positions[-1])
                poses.append(pose_at(ways[-1]))
        except UnreachableError:
            continue
        for number, motion in enumerate(motions):
            wrist = ways[number + 1][5] - joints[5]
            least, most = min(wrist, ways[number][5] - joints[5]), max(wrist, ways[number][5] - joints[5])
            present = KINEMATICS.turning_range(joints)
            for forwards, backwards, is_allowed in (
                (most + 1e-3, 1e-3 - least, True),
                (wrist - 1e-3, 10.0, wrist < most),
                (10.0, -1e-3 - wrist, wrist > least),
            ):
                changed = replace(present, forwards=forwards, backwards=backwards)
                assert changed.allows(poses[number], motion) == is_allowed
            num_motions += 1


@pytest.mark.parametrize("joint", range(6))
def test_a_start_in_another_posture_is_a_named_error(joint: int) -> None:
    start = KINEMATICS.inverse(0.0, 0.0, 1.0, near=HOME) + 0.3 * np.eye(6)[joint]
    if joint in (0, 5):  # these turn the level gripper
        assert KINEMATICS.path(start, GripperMotion(forward=0.02)).positions[0] == pytest.approx(start)
    else:
        with pytest.raises(UnreachableError, match="approach it first"):
            KINEMATICS.path(start, GripperMotion(forward=0.02))


@pytest.mark.parametrize("joints", [[np.nan] * 6, [0.0] * 5])
def test_impossible_joints_are_a_named_error(joints: Any) -> None:
    with pytest.raises(UnreachableError, match="there are six, all finite"):
        KINEMATICS.path(joints, GripperMotion(forward=0.02))
