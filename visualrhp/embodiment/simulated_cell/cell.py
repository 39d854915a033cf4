"""The robot cell in MuJoCo: a :class:`~visualrhp.embodiment.robot_cell.RobotCell` whose clock is simulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.robot_cell import (
    ArmState,
    CameraFrame,
    GripperState,
    JointTrajectory,
    RobotCell,
)
from visualrhp.embodiment.robot_model import HOME
from visualrhp.embodiment.segmentation.detection import Detection
from visualrhp.embodiment.simulated_cell.model import OBJECT_PREFIX, TIME_STEP, cell_model
from visualrhp.embodiment.simulated_cell.rendering import CellRenderer, Image, expose
from visualrhp.embodiment.simulated_cell.task import CellTask
from visualrhp.embodiment.simulated_cell.truth import GroundTruth, ground_truth
from visualrhp.errors import ConfigError, SimulationError
from visualrhp.types import FloatArray

FINGER_SPEED: Final = 0.1
"""Of each change of the opening [m/s]; the 2F-85 moves at 0.02 to 0.15 m/s (Robotiq's manual)."""

SETTLING_STEPS: Final = 150
"""Steps for which objects come to rest before the clock starts."""

BACKGROUND: Final = -1
"""In an instance mask: the table, the target and the floor."""

ROBOT: Final = -2
"""In an instance mask: the arm with the gripper."""

MIN_VISIBLE_PIXELS: Final = 30
"""An object of which fewer pixels are visible is not in the ground truth of a frame."""

_OPENING_OF_CONTROL: Final = ((0.0, 0.0852), (100.0, 0.0536), (200.0, 0.0177), (255.0, 0.0004))
_MOVING: Final = 0.005
"""Fingers that are faster are moving [m/s]. Pads that hold fruit at its edge creep at 2 to 3 mm/s, until it slips away;
the 2F-85, whose slowest commanded speed is 20 mm/s, reports an object and a stop."""


@dataclass(frozen=True)
class CellSnapshot:
    """A copy of everything that changes in a cell; see :meth:`SimulatedCell.snapshot`."""

    physics: FloatArray
    controls: tuple[Any, ...]


_FARTHEST: Final = 10.0
"""Distance from the table's centre [m] that no object reaches that was pushed over an edge."""


class SimulatedCell(RobotCell):
    """A cell in MuJoCo. Equal tasks and equal commands give equal states, to the bit.

    Args:
        task: what the cell contains.
        render: whether there is a camera; without one, :meth:`frame`, :meth:`instance_mask`, :meth:`detections` and
            :meth:`side_view` raise a ConfigError, and no OpenGL library is needed.

    Attributes:
        task: as given.

    Raises:
        ConfigError: the robot's packages are not installed, or there is no OpenGL library.
        UnreachableError: the arm cannot take the task's gripper pose.
    """

    def __init__(self, task: CellTask, *, render: bool = True) -> None:
        self.task = task
        self._mujoco = robot_package("mujoco")
        self._model = cell_model(task)
        self._data = self._mujoco.MjData(self._model)
        self._index()
        self._renderer = CellRenderer(self._model, task.camera) if render else None
        start = ArmKinematics(task.mounting).inverse(*task.gripper_pose, near=HOME)
        self._data.qpos[self._arm_qpos] = start
        self._feed = start[None]
        self._begun = self._steps = self._frames = 0
        self._clock = 0.0
        self._opening_target = self._opening_command = float(_OPENING_OF_CONTROL[0][1])
        self._advance(SETTLING_STEPS)
        self._data.qvel[:] = 0.0
        self._data.time = 0.0
        self._begun = self._steps = 0

    def _index(self) -> None:
        """Find joints, actuators and geoms by their names."""
        model = self._model
        names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
        joints = [model.joint(f"{name}_joint") for name in names]
        self._arm_qpos = np.array([int(joint.qposadr[0]) for joint in joints])
        self._arm_dof = np.array([int(joint.dofadr[0]) for joint in joints])
        actuators = [model.actuator(name).id for name in names]
        self._arm_actuators = np.array(actuators)
        self._lead = -model.actuator_biasprm[actuators, 2] / model.actuator_gainprm[actuators, 0]
        self._fingers = model.actuator("gripper/fingers_actuator").id
        self._pads = [model.geom(f"gripper/{side}_pad1").id for side in ("left", "right")]
        self._frame_site = model.site("gripper_frame").id
        self._bodies = [model.body(f"{OBJECT_PREFIX}{number}").id for number in range(len(self.task.objects))]
        owner = np.full(model.nbody, ROBOT)
        owner[0] = BACKGROUND
        owner[self._bodies] = np.arange(len(self._bodies))
        self._owner = np.append(owner[model.geom_bodyid], BACKGROUND)  # the last entry is that of no geom

    # RobotCell

    def now(self) -> float:
        return self._clock

    def wait(self, duration_s: float) -> None:
        """Simulate.

        Raises:
            SimulationError: the physics diverged.
        """
        if not duration_s >= 0.0:
            raise ConfigError(f"a cell cannot wait for {duration_s!r:.60} s; time does not go back")
        self._clock += duration_s
        self._advance(round(self._clock / TIME_STEP) - self._steps)
        if self._has_diverged():
            raise SimulationError(f"the physics of the cell diverged at {self._clock:.3f} s")

    def frame(self) -> CameraFrame:
        """The image that the camera takes now; its noise depends on the task and the number of the frame only."""
        rng = np.random.default_rng([self.task.seed, self._frames])
        self._frames += 1
        image = expose(self._rendering.image(self._data), self.task.look, rng)
        return CameraFrame(image, self._clock)

    def arm(self) -> ArmState:
        positions = self._data.qpos[self._arm_qpos].copy()
        return ArmState(positions, self._data.qvel[self._arm_dof].copy(), self._clock)

    def gripper(self) -> GripperState:
        is_moving = self._opening_command != self._opening_target or abs(self._finger_speed()) > _MOVING
        return GripperState(self.opening, is_moving, self._clock)

    def follow(self, trajectory: JointTrajectory) -> None:
        count = max(1, round(trajectory.duration / TIME_STEP))
        times = TIME_STEP * np.arange(count + 1)
        samples = [np.interp(times, trajectory.times, joint) for joint in np.transpose(trajectory.positions)]
        wanted = np.stack(samples, axis=1)
        # The actuator's damping acts on the velocity itself; leading by its share of the velocity cancels it.
        velocity = np.diff(wanted, axis=0) / TIME_STEP
        self._feed = np.concatenate([wanted[1:] + self._lead * velocity, wanted[-1:]])
        self._begun = self._steps

    def move_gripper(self, opening: float) -> None:
        self._opening_target = min(max(float(opening), 0.0), _OPENING_OF_CONTROL[0][1])

    def stop(self) -> None:
        self._feed = self._data.qpos[self._arm_qpos].copy()[None]
        self._begun = self._steps
        self._opening_target = self._opening_command = min(self.opening, self._opening_command)

    def close(self) -> None:
        self.stop()
        if self._renderer is not None:
            self._renderer.close()

    # Ground truth

    @property
    def camera(self) -> Camera:
        """The true camera."""
        return self.task.camera

    @property
    def opening(self) -> float:
        """Distance between the finger pads [m]."""
        left, right = self._data.geom_xpos[self._pads]
        half = float(self._model.geom_size[self._pads[0], 1])
        across = self._data.site_xmat[self._frame_site].reshape(3, 3)[:, 1]
        return max(0.0, abs(float((left - right) @ across)) - 2.0 * half)

    def truth(self) -> GroundTruth:
        """The true scene and state: outlines seen vertically from above, and poses."""
        rotations = self._data.xmat[self._bodies].reshape(-1, 3, 3)
        frame = self._data.site_xmat[self._frame_site].reshape(3, 3)
        x, y = self._data.site_xpos[self._frame_site, :2]
        pose = np.array([x, y, np.arctan2(frame[1, 0], frame[0, 0])])
        is_closed = self._opening_target < 0.5 * _OPENING_OF_CONTROL[0][1]
        return ground_truth(self.task, self._data.xpos[self._bodies], rotations, pose, self.opening, is_closed)

    def is_at_rest(self, speed: float = 0.01) -> bool:
        """Whether no object on the table is faster than ``speed`` [m/s], of any point within 5 cm of its centre."""
        for body in self._bodies:
            start = int(self._model.jnt_dofadr[self._model.body_jntadr[body]])
            linear, angular = np.split(self._data.qvel[start : start + 6], 2)
            if self._data.xpos[body, 2] > -0.02 and np.linalg.norm(linear) + 0.05 * np.linalg.norm(angular) > speed:
                return False
        return True

    def instance_mask(self) -> npt.NDArray[np.int16]:
        """[H, W] which object each pixel of the camera shows; :data:`BACKGROUND` or :data:`ROBOT` where none."""
        return self._owner[self._rendering.geoms(self._data)].astype(np.int16)

    def detections(self) -> list[Detection]:
        """What a perfect segmentation of the camera's image finds, the objects in their order.

        Objects of which fewer than :data:`MIN_VISIBLE_PIXELS` are visible are left out.
        """
        mask = self.instance_mask()
        found = []
        for number, (thing, body) in enumerate(zip(self.task.objects, self._bodies, strict=True)):
            visible = mask == number
            if np.count_nonzero(visible) >= MIN_VISIBLE_PIXELS:
                lies = thing.lies(self._data.xmat[body].reshape(3, 3))
                found.append(Detection(thing.kind, lies, visible))
        return found

    def picture(self) -> Image:
        """The image that the camera would take now, for people: without noise and without an effect on later frames."""
        return self._rendering.image(self._data)

    def side_view(self) -> Image:
        """[480, 640, 3] uint8, RGB: the cell from the side."""
        return self._rendering.side_view(self._data)

    def snapshot(self) -> CellSnapshot:
        """A copy of the physics, the commands and the clock, for :meth:`restore`."""
        kind = self._mujoco.mjtState.mjSTATE_INTEGRATION
        physics = np.empty(self._mujoco.mj_stateSize(self._model, kind))
        self._mujoco.mj_getState(self._model, self._data, physics, kind)
        controls = (self._feed, self._begun, self._steps, self._frames, self._clock)
        return CellSnapshot(physics, (*controls, self._opening_target, self._opening_command))

    def restore(self, snapshot: CellSnapshot) -> None:
        """Return to a snapshot of this cell."""
        kind = self._mujoco.mjtState.mjSTATE_INTEGRATION
        self._mujoco.mj_setState(self._model, self._data, snapshot.physics, kind)
        self._feed, self._begun, self._steps, self._frames, self._clock = snapshot.controls[:5]
        self._opening_target, self._opening_command = snapshot.controls[5:]
        for warning in self._bad_numbers():
            warning.number = 0
        self._mujoco.mj_forward(self._model, self._data)

    # Internal

    @property
    def _rendering(self) -> CellRenderer:
        if self._renderer is None:
            raise ConfigError("this cell was made without a camera: SimulatedCell(task, render=True) has one")
        return self._renderer

    def _finger_speed(self) -> float:
        """Of the driving joint, as a change of the opening [m/s]; 0.8 rad are the stroke."""
        dof = int(self._model.joint("gripper/right_driver_joint").dofadr[0])
        return float(self._data.qvel[dof]) * _OPENING_OF_CONTROL[0][1] / 0.8

    def _has_diverged(self) -> bool:
        """Whether an object was catapulted away, or MuJoCo has found numbers that are bad, and has reset its state."""
        distance = np.abs(self._data.xpos[self._bodies, :2]).max(initial=0.0)
        return any(warning.number for warning in self._bad_numbers()) or not distance < _FARTHEST

    def _bad_numbers(self) -> list[Any]:
        """MuJoCo's counters of them."""
        kinds = self._mujoco.mjtWarning
        return [self._data.warning[kind] for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)]

    def _advance(self, steps: int) -> None:
        """Simulate ``steps`` steps, with the commands in force."""
        data, change = self._data, FINGER_SPEED * TIME_STEP
        done = 0
        while done < steps:
            number = self._steps - self._begun
            is_idle = number >= len(self._feed) - 1 and self._opening_command == self._opening_target
            data.ctrl[self._arm_actuators] = self._feed[min(number, len(self._feed) - 1)]
            data.ctrl[self._fingers] = _control_of_opening(self._opening_command)
            count = steps - done if is_idle else 1
            self._mujoco.mj_step(self._model, data, count)
            gap = self._opening_target - self._opening_command
            self._opening_command += float(np.clip(gap, -change, change))
            if abs(gap) <= change:
                self._opening_command = self._opening_target
            self._steps += count
            done += count
        # Positions of bodies and geoms are those before the last step, until they are computed.
        self._mujoco.mj_kinematics(self._model, data)


def _control_of_opening(opening: float) -> float:
    """Command of the fingers' actuator with which nothing between them leaves them ``opening`` [m] apart."""
    controls, openings = np.transpose(_OPENING_OF_CONTROL)
    return float(np.interp(-opening, -openings, controls))
