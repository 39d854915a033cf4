"""The simulated robot cell: a step of its physics, an action, a frame, and what a new cell takes.

References: bare ``mj_step`` on the same model, and MuJoCo's renderer without the camera's lens and noise.
"""

from __future__ import annotations

import time

import numpy as np

from tests.benchmarks.timing import Effort, Stopwatch, compare, numbered, show_time, show_title, side_by_side, timed
from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.robot_cell import JointTrajectory
from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
from visualrhp.embodiment.simulated_cell.model import TIME_STEP, cell_model
from visualrhp.embodiment.simulated_cell.rendering import CellRenderer
from visualrhp.embodiment.simulated_cell.sampling import CellDistribution, sample_cell
from visualrhp.errors import UnreachableError
from visualrhp.simulation.action_spaces import GripperMotion
from visualrhp.streams import Split

_SETTLING = 1.5


def _action(cell: SimulatedCell, kinematics: ArmKinematics, rng: np.random.Generator) -> JointTrajectory:
    """A random motion towards the middle of the table, as long as one of the planner's."""
    while True:
        forward, left, turn = rng.uniform(0.0, 0.1), rng.uniform(-0.1, 0.1), rng.uniform(-0.87, 0.87)
        try:
            return kinematics.path(cell.arm().positions, GripperMotion(forward, left, turn))
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
        trajectories = [_action(cell, kinematics, rng) for _ in range(effort.motions)]
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
