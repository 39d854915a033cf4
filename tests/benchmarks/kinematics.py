"""Paths of the arm in closed form against differential inverse kinematics; the reach against a simulated action."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tests.benchmarks.timing import Effort, compare, show_title, timed
from visualrhp.embodiment.kinematics import FLANGE, ArmKinematics
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.reach import ReachMap, displacement_of
from visualrhp.embodiment.robot_model import GRIPPER_HEIGHT, HOME
from visualrhp.embodiment.trajectories import MotionParameters, progress
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.simulation import ContinuousActionSpace, GripperMotion, TransitionModel
from visualrhp.streams import Split
from visualrhp.types import FloatArray, State

MOTIONS = {
    "10 cm forward": GripperMotion(forward=0.1),
    "5 cm to the left": GripperMotion(left=0.05),
    "50 degrees": GripperMotion(rotation=np.radians(50.0)),
}
START = (-0.05, 0.05, 0.5)


def _level(x: float, y: float, theta: float) -> FloatArray:
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]
    pose[:3, 3] = x, y, GRIPPER_HEIGHT
    return pose


def _with_pink(kinematics: ArmKinematics, joints: FloatArray, motion: GripperMotion) -> Callable[[], list[Any]]:
    """One step of Pink for every sample of the same trajectory."""
    pin, pink = robot_package("pinocchio"), robot_package("pink")
    times = kinematics.path(joints, motion).times
    parts = progress(times, float(times[-1]), MotionParameters().ramp_s, MotionParameters().brake_s)
    way = np.array(START) + parts[:, None] * displacement_of(START[2], motion)
    targets = [pin.SE3(kinematics.flange_target(_level(*pose))) for pose in way]
    model, data, period = kinematics.model, kinematics.model.createData(), float(times[1])
    flange = pink.tasks.FrameTask(FLANGE, position_cost=1.0, orientation_cost=1.0)

    def follow() -> list[Any]:
        configuration = pink.Configuration(model, data, joints)
        positions = []
        for target in targets:
            flange.set_target(target)
            velocity = pink.solve_ik(configuration, [flange], period, solver="daqp")
            configuration.integrate_inplace(velocity, period)
            positions.append(configuration.q.copy())
        return positions

    return follow


def run(effort: Effort) -> None:
    kinematics = ArmKinematics()
    joints = kinematics.inverse(*START, near=HOME)
    show_title("Path of the arm (level gripper)")
    for name, motion in MOTIONS.items():
        compare(
            f"path, {name}, {len(kinematics.path(joints, motion).times)} samples",
            timed(lambda motion=motion: kinematics.path(joints, motion), 5),
            timed(_with_pink(kinematics, joints, motion)),
            "Pink, a step a sample",
            effort.repetitions,
        )
    show_title("Reach (planner's model)")
    instance = sample_task_instance(SceneDistribution(num_objects=4), 0, Split.EVALUATION, 0)
    state = State.create(START, 0.085, False, instance.state.object_poses)
    model, reach, action = TransitionModel(instance.scene, ContinuousActionSpace()), ReachMap.load(), np.full(4, 0.9)
    motion = model.action_space.motion(action)
    compare(
        "allows, one motion",
        timed(lambda: reach.allows(state.gripper_pose, motion), 200),
        timed(lambda: model.simulate(state, action), 10),
        "a simulated action, 4 objects",
        effort.repetitions,
    )
    poses = np.random.default_rng(0).uniform(-0.3, 0.3, (10_000, 3))
    compare(
        "contains, 10,000 poses",
        timed(lambda: reach.contains(poses)),
        timed(lambda: model.simulate(state, action), 10),
        "a simulated action, 4 objects",
        effort.repetitions,
    )
