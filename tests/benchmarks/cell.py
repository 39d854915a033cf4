"""The simulated robot cell: a step of its physics, an action, a frame, and what a new cell takes.

References: bare ``mj_step`` on the same model, and MuJoCo's renderer without the camera's lens and noise.
"""

from __future__ import annotations

import math
import time

import numpy as np

from tests.benchmarks.timing import Effort, Stopwatch, compare, numbered, show_time, show_title, side_by_side, timed
from visualrhp.embodiment.kinematics import ArmKinematics, ToolPose
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.reach import displacement_of
from visualrhp.embodiment.robot_cell import JointTrajectory
from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
from visualrhp.embodiment.simulated_cell.model import TIME_STEP, cell_model
from visualrhp.embodiment.simulated_cell.rendering import CellRenderer
from visualrhp.embodiment.simulated_cell.sampling import CellDistribution, sample_cell
from visualrhp.errors import UnreachableError
from visualrhp.simulation.action_spaces import GripperMotion
from visualrhp.streams import Split
from visualrhp.types import FloatArray, wrap_angle

_SETTLING = 1.5
_SAMPLED_S = 0.01
_MOTIONS_PER_CELL = 8


def _action(
    joints: FloatArray, kinematics: ArmKinematics, rng: np.random.Generator
) -> tuple[GripperMotion, JointTrajectory]:
    """A random motion towards the middle of the table, as long as one of the planner's."""
    while True:
        forward, left, turn = rng.uniform(0.0, 0.1), rng.uniform(-0.1, 0.1), rng.uniform(-0.87, 0.87)
        motion = GripperMotion(forward, left, turn)
        try:
            return motion, kinematics.path(joints, motion)
        except UnreachableError:
            continue


def _execution(cell: SimulatedCell, trajectories: list[JointTrajectory]) -> Stopwatch:
    """The mean time of the actions, from the same state, until everything is at rest [s]."""
    start = cell.snapshot()

    def stopwatch() -> float:
        total = 0.0
        for trajectory in trajectories:
            cell.restore(start)
            began = time.process_time()
            cell.follow(trajectory)
            cell.wait(trajectory.duration)
            for _ in range(round(_SETTLING / 0.1)):
                cell.wait(0.1)
                if cell.is_at_rest():
                    break
            total += time.process_time() - began
        return total / len(trajectories)

    return stopwatch


def _off_the_line(kinematics: ArmKinematics, joints: FloatArray, start: ToolPose, motion: GripperMotion) -> FloatArray:
    """[3] of a pose on the way of a motion: distance from the line [m], and from the height [m]; rotation [rad] from
    what belongs to its place on the line."""
    pose = kinematics.forward(joints)
    way = displacement_of(start.theta, motion)[:2]
    offset, turned = np.array([pose.x - start.x, pose.y - start.y]), wrap_angle(pose.theta - start.theta)
    done = float(np.clip(offset @ way / (way @ way), 0.0, 1.0))
    return np.abs([np.hypot(*(offset - done * way)), pose.height - start.height, turned - done * motion.rotation])


def _executed_paths(kinematics: ArmKinematics, num_cells: int) -> tuple[FloatArray, FloatArray]:
    """[K, 3] of :func:`_off_the_line` every 10 ms of random actions among seven objects; [M, 3] at their ends."""
    way, ends = [], []
    for index in range(num_cells):
        task = sample_cell(CellDistribution(num_objects=(7, 7)), 0, Split.TUNING, index)
        cell, rng = SimulatedCell(task, render=False), np.random.default_rng(index)
        for _ in range(_MOTIONS_PER_CELL):
            joints = cell.arm().positions
            start = kinematics.forward(joints)
            motion, trajectory = _action(joints, kinematics, rng)
            cell.follow(trajectory)
            for _ in range(math.ceil(trajectory.duration / _SAMPLED_S)):
                cell.wait(_SAMPLED_S)
                way.append(_off_the_line(kinematics, cell.arm().positions, start, motion))
            cell.wait(0.3)
            ends.append(_off_the_line(kinematics, cell.arm().positions, start, motion))
        cell.close()
    return np.array(way), np.array(ends)


def _show_executed_paths(kinematics: ArmKinematics, num_cells: int) -> None:
    print(f"\nExecuted paths: {num_cells * _MOTIONS_PER_CELL} random actions among 7 objects")
    for when, found in zip(("on the way", "at the end"), _executed_paths(kinematics, num_cells), strict=True):
        line, height, turn = found.max(axis=0)
        print(f"{when}: at most {1e3 * line:.3f} mm off the line, {1e3 * height:.3f} mm in height,", end=" ")
        print(f"{math.degrees(turn):.3f} degrees", flush=True)


def run(effort: Effort) -> None:
    show_title("The simulated robot cell (CPU time of all threads)")
    mujoco, kinematics = robot_package("mujoco"), ArmKinematics()
    for num_objects in (1, 4, 7):
        what = numbered(num_objects, "object")
        task = sample_cell(CellDistribution(num_objects=(num_objects, num_objects)), 0, Split.TUNING, 0)
        cell = SimulatedCell(task, render=False)
        model = cell_model(task)
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 200)
        steps = 200
        compare(
            f"step of {1e3 * TIME_STEP:g} ms, {what}",
            timed(lambda cell=cell: cell.wait(TIME_STEP), steps),
            timed(lambda model=model, data=data: mujoco.mj_step(model, data), steps),
            "mj_step",
            effort.repetitions,
        )
        rng = np.random.default_rng(num_objects)
        trajectories = [_action(cell.arm().positions, kinematics, rng)[1] for _ in range(effort.motions)]
        show_time(f"action, {what}", side_by_side([_execution(cell, trajectories)], effort.repetitions)[0])
        seen = SimulatedCell(task)
        plain = CellRenderer(model, task.camera)
        compare(
            f"frame, {what}",
            timed(seen.frame),
            timed(lambda plain=plain, data=data: plain.image(data)),
            "the renderer",
            effort.repetitions,
        )
        show_time(f"instance mask, {what}", side_by_side([timed(seen.instance_mask)], effort.repetitions)[0])
        show_time(f"true scene and state, {what}", side_by_side([timed(seen.truth)], effort.repetitions)[0])
        plain.close()
        seen.close()
        show_time(
            f"new cell, {what}",
            side_by_side([timed(lambda task=task: SimulatedCell(task).close())], min(3, effort.repetitions))[0],
        )
    _show_executed_paths(kinematics, effort.motions)
