"""A robot cell without MuJoCo: our planar simulator behind the protocol, with a trivial arm and a camera that shows it.

Fast enough for thousands of episodes. An image shows the scene in noise, and carries the number of its exposure in its
first pixels, from which the perception here finds the state that was exposed: an old image gives an old state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from visualrhp.embodiment.robot_cell import ArmLimits, ArmState, CameraFrame, GripperState, JointTrajectory
from visualrhp.embodiment.robot_model import CELL_GRIPPER, GRIPPER_HEIGHT
from visualrhp.errors import PerceptionError, UnreachableError
from visualrhp.scene import ObjectShape, Scene, TargetRegion, TaskInstance
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.simulation.action_spaces import MAX_ROTATION, MAX_TRANSLATION, GripperMotion
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.simulator import Simulator
from visualrhp.streams import Split
from visualrhp.types import State

RADIANS_PER_METRE = 4.0
"""Joints 0 and 1 move the gripper in x and y, joint 5 turns it."""
REACH = 0.42
SPEED = 0.15
TURNING_SPEED = 1.0
ACCELERATION = 8.0
SIZE_PX = 96
FINGER_TIME_S = 0.4
MARK = 4
"""Pixels that carry the number of the exposure."""


@dataclass(frozen=True)
class ToolPose:
    x: float
    y: float
    theta: float
    height: float = GRIPPER_HEIGHT
    tilt: float = 0.0


class PlanarKinematics:
    """Three joints that are the pose of the gripper."""

    limits = ArmLimits()

    def forward(self, positions) -> ToolPose:
        x, y, *_, theta = np.asarray(positions, float)
        return ToolPose(x / RADIANS_PER_METRE, y / RADIANS_PER_METRE, float(theta))

    def joints(self, pose) -> np.ndarray:
        x, y, theta = pose
        return np.array([x * RADIANS_PER_METRE, y * RADIANS_PER_METRE, 0.0, 0.0, 0.0, theta])

    def path(self, positions, motion: GripperMotion) -> JointTrajectory:
        start = self.forward(positions)
        c, s = math.cos(start.theta), math.sin(start.theta)
        x = start.x + c * motion.forward - s * motion.left
        y = start.y + s * motion.forward + c * motion.left
        theta = start.theta + motion.rotation
        if max(abs(x), abs(y)) > REACH or abs(theta) > 2.0 * math.pi:
            raise UnreachableError(f"the arm does not reach ({x:.3f}, {y:.3f}) m, {theta:.2f} rad")
        distance = math.hypot(motion.forward, motion.left)
        strongest = 6.0 * max(RADIANS_PER_METRE * distance, abs(motion.rotation)) / ACCELERATION
        duration = max(1.5 * distance / SPEED, 1.5 * abs(motion.rotation) / TURNING_SPEED, math.sqrt(strongest), 0.2)
        times = np.linspace(0.0, duration, 2 + int(duration / 0.02))
        u = times / duration
        done = u * u * (3.0 - 2.0 * u)  # at rest at both ends
        first, last = np.asarray(positions, float), self.joints((x, y, theta))
        return JointTrajectory(times, first + done[:, None] * (last - first))


class PlanarCell:
    """The cell. Objects move when a motion of the gripper ends, or is stopped.

    Attributes:
        state: the true one, but for the gripper in motion.
        exposures: of every image: (time [s], true state).
        is_moving: whether arm or fingers move.
    """

    def __init__(self, instance: TaskInstance, seed: int = 0) -> None:
        self.scene, self.state = instance.scene, instance.state
        self.time = 1.0
        self.exposures: list[tuple[float, Scene, State]] = []
        self.num_stops = 0
        self.is_closed = False
        self._simulator = Simulator(self.scene, Physics())
        self._rng = np.random.default_rng(seed)
        self._kinematics = PlanarKinematics()
        self._joints = self._kinematics.joints(self.state.gripper_pose)
        self._trajectory: JointTrajectory | None = None
        self._started = 0.0
        self._fingers_until = -math.inf
        self._fingers: bool | None = None

    def now(self) -> float:
        return self.time

    def wait(self, duration_s: float) -> None:
        self.time += duration_s
        if self.is_moving and not self._is_arm_moving() and self.time >= self._fingers_until:
            self._finish()

    @property
    def is_moving(self) -> bool:
        return self._trajectory is not None or self._fingers is not None

    def _is_arm_moving(self) -> bool:
        return self._trajectory is not None and self.time < self._started + self._trajectory.duration

    def _commanded(self, time_s: float) -> np.ndarray:
        if self._trajectory is None:
            return self._joints
        since = time_s - self._started
        return np.array([np.interp(since, self._trajectory.times, q) for q in self._trajectory.positions.T])

    def _finish(self) -> None:
        """Do to the objects what the motion until now has done."""
        joints = self._commanded(self.time)
        before, after = self._kinematics.forward(self._joints), self._kinematics.forward(joints)
        c, s = math.cos(before.theta), math.sin(before.theta)
        dx, dy = after.x - before.x, after.y - before.y
        motion = GripperMotion(
            float(np.clip(c * dx + s * dy, -MAX_TRANSLATION, MAX_TRANSLATION)),
            float(np.clip(-s * dx + c * dy, -MAX_TRANSLATION, MAX_TRANSLATION)),
            float(np.clip(after.theta - before.theta, -MAX_ROTATION, MAX_ROTATION)),
            self._fingers,
        )
        state = self._simulator.advance(self.state, motion)
        self.is_closed = state.gripper_closed
        self.state = state
        self._joints, self._trajectory, self._fingers = joints, None, None

    def frame(self) -> CameraFrame:
        image = self._picture()
        number = len(self.exposures)
        image[0, :MARK, 0] = [number >> (8 * k) & 255 for k in range(MARK)]
        self.exposures.append((self.time, self.scene, self.state))
        return CameraFrame(image, self.time)

    def _picture(self) -> np.ndarray:
        image = self._rng.integers(90, 110, (SIZE_PX, SIZE_PX, 3), np.uint8)
        pose = self._kinematics.forward(self._commanded(self.time))
        scale, centre = SIZE_PX / 1.0, SIZE_PX / 2.0

        def fill(outline, colour):
            points = np.round(16.0 * (centre + scale * outline * (1.0, -1.0))).astype(np.int32)
            cv2.fillPoly(image, [points], colour, shift=4)

        for shape, (x, y, theta) in zip(self.scene.objects, self.state.object_poses, strict=True):
            c, s = math.cos(theta), math.sin(theta)
            fill(shape.outline @ np.array([[c, s], [-s, c]]) + (x, y), (200, 60, 50))
        for outline in self.scene.gripper.outlines((pose.x, pose.y, pose.theta), self.state.gripper_opening):
            fill(outline, (40, 40, 160))
        return image

    def change(self, scene: Scene, state: State, object_poses) -> None:
        """Change what lies on the table, as a hand would."""
        self.scene = scene
        self.state = State.create(state.gripper_pose, state.gripper_opening, state.gripper_closed, object_poses)
        self._simulator = Simulator(scene, Physics())

    def arm(self) -> ArmState:
        step = 1e-3
        velocities = (self._commanded(self.time) - self._commanded(self.time - step)) / step
        if not self._is_arm_moving():
            velocities = np.zeros(6)
        return ArmState(self._commanded(self.time), velocities, self.time)

    def gripper(self) -> GripperState:
        return GripperState(self.state.gripper_opening, self._fingers is not None, self.time)

    def follow(self, trajectory: JointTrajectory) -> None:
        if self.is_moving:
            self._finish()
        self._trajectory, self._started = trajectory, self.time
        self._fingers_until = -math.inf

    def move_gripper(self, opening: float) -> None:
        self._fingers, self._fingers_until = opening < 0.5 * CELL_GRIPPER.stroke, self.time + FINGER_TIME_S

    def stop(self) -> None:
        self.num_stops += 1
        if self.is_moving:
            self._finish()

    def close(self) -> None:
        self.stop()


class PlanarPerception:
    """Finds the state whose exposure an image carries."""

    def __init__(self, cell: PlanarCell) -> None:
        self.cell = cell

    def perceive(self, frame, arm, gripper, closed):
        number = number_of(frame.image)
        if number >= len(self.cell.exposures):
            raise PerceptionError("the image shows nothing that is known")
        _, scene, state = self.cell.exposures[number]
        pose = PlanarKinematics().forward(arm.positions)
        gripper_pose = (pose.x, pose.y, pose.theta)
        return Seen(scene, State.create(gripper_pose, gripper.opening, closed, state.object_poses))


@dataclass(frozen=True)
class Seen:
    scene: Scene
    state: State


def number_of(image) -> int:
    """The number of the exposure that an image carries."""
    return sum(int(byte) << (8 * k) for k, byte in enumerate(image[0, :MARK, 0]))


def planar_task(seed: int = 0, index: int = 0, num_objects: int = 3) -> TaskInstance:
    """A sampled task with the gripper of the cell; it starts with open fingers."""
    distribution = SceneDistribution(num_objects=(num_objects, num_objects))
    instance = sample_task_instance(distribution, seed, Split.EVALUATION, index)
    scene = Scene(instance.scene.target, instance.scene.objects, instance.scene.edges, CELL_GRIPPER)
    state = instance.state
    return TaskInstance(scene, State.create(state.gripper_pose, CELL_GRIPPER.stroke, False, state.object_poses))


def pushing_task(target_x: float = 0.12) -> TaskInstance:
    """A square ahead of the gripper, to be pushed along x."""
    square = ObjectShape(0.02 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]))
    scene = Scene(TargetRegion(np.array([target_x, 0.0]), 0.05), (square,), gripper=CELL_GRIPPER)
    return TaskInstance(scene, State.create([-0.2, 0.0, 0.0], CELL_GRIPPER.stroke, False, [[-0.06, 0.0, 0.0]]))
