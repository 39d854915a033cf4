"""Quasi-static planar physics: state and gripper motion to next state, on Chipmunk (pymunk).

The simulator is exactly Markov: the next state is a bit-exact function of (scene, state, motion), whatever was
simulated before, because every motion begins in a new space (:mod:`visualrhp.simulation.chipmunk`). A motion ends when
the world is at rest, so a state needs no velocities.

Gripper: no object on the table can stop the arm, so the *palm* moves exactly as commanded, and the *fingers* rotate
with it. They slide sideways on rails of the palm like racks on a pinion: a *pinion* that rotates on the palm has a pin
at each end, one in a slot of each finger, so that one motor of limited force opens and closes both symmetrically.

Surface friction: each object rests on five points. A joint without position correction holds each of them to the ground
with a fifth of the friction force mu m g. The distance of the points from the centre of mass is the mean distance of
the area, so sliding is resisted by mu m g, spinning by the friction moment of the area under uniform pressure, and a
combined motion by less of each, according to the limit surface of a pushed object.
"""

from __future__ import annotations

import math

import numpy as np

from visualrhp.errors import SceneError, SimulationError
from visualrhp.scene.scene import ObjectShape, Scene
from visualrhp.simulation.action_spaces import GripperMotion
from visualrhp.simulation.chipmunk import Body, ChipmunkWorld, Space, lib
from visualrhp.simulation.physics import Physics
from visualrhp.types import Column, State, wrap_angle

_GRIPPER_GROUP = 1
_ORIGIN = (0.0, 0.0)
_PINION_RADIUS = 0.06
"""Lever of the pins [m]; a little more than half the stroke, so that the pinion stays below 45 degrees."""
_HUGE = 1e30
"""A mass or moment of inertia that impulses cannot move; only a set velocity does."""
_NUM_SUPPORTS = 5  # odd: the friction of four depends on the direction of sliding
_STEPS_BETWEEN_LOOKS = 5
PATIENCE = 50
"""Settling steps after which the solver iterates more: bodies that still move are jammed in the gripper."""
MORE_ITERATIONS = 4
"""The solver then iterates this many times as often."""


def add_object(world: ChipmunkWorld, shape: ObjectShape, gravity: float) -> Body:
    """Add an object with Coulomb friction on the surface: a limited resistance without restoring force."""
    body = world.add_body(shape.mass, shape.moment_of_inertia, shape.convex_parts, friction=shape.friction, asleep=True)
    alignment = _alignment(shape)
    force = shape.friction * shape.mass * gravity / alignment / _NUM_SUPPORTS
    radius = shape.friction_lever * alignment
    for angle in 2.0 * math.pi * np.arange(_NUM_SUPPORTS) / _NUM_SUPPORTS:
        support = (radius * math.cos(angle), radius * math.sin(angle))
        world.add_joint("PivotJoint", (world.ground, body), (_ORIGIN, support), max_force=force, max_bias=0.0)
    return body


def _alignment(shape: ObjectShape) -> float:
    """The share of the supports' forces against the direction of sliding, averaged over the directions.

    The solver's impulse at a point of a body is opposite to the velocity times the effective mass, which is smaller
    across the lever to the centre of mass than along it: m / (1 + m r^2 / I) instead of m.
    """
    angles = np.arange(24) * np.pi / 24
    along, across = np.cos(angles), np.sin(angles)
    alignment = 1.0
    for _ in range(4):  # the radius of the supports depends on it
        lightness = 1.0 + shape.mass * (shape.friction_lever * alignment) ** 2 / shape.moment_of_inertia
        alignment = float(((along**2 + across**2 / lightness) / np.hypot(along, across / lightness)).mean())
    return alignment


class Simulator:
    """Simulates gripper motions in one scene.

    Do not share a simulator between threads. A copied or unpickled one repeats its results to the bit.

    Attributes:
        scene: the scene.
        physics: the parameters.
        world: bodies and joints, assembled.
        motor: opens and closes the fingers.
        closing_rate: of the motor [rad/s].
    """

    def __init__(self, scene: Scene, physics: Physics) -> None:
        """Assemble the world.

        Raises:
            ConfigError: a part of the scene's gripper is too thin for the time steps.
        """
        physics.check_gripper(scene.gripper)
        self.scene = scene
        self.physics = physics
        self._half_stroke = scene.gripper.stroke / 2.0
        self.closing_rate = math.asin(self._half_stroke / _PINION_RADIUS) / (
            0.8 * physics.motion_steps * physics.time_step
        )
        # Chipmunk expects the share of an error that remains after a second.
        self._overlap_bias = (1.0 - physics.overlap_correction) ** (1.0 / physics.time_step)
        self._joint_bias = (1.0 - physics.joint_correction) ** (1.0 / physics.time_step)
        self.world = ChipmunkWorld(
            num_bodies=4 + scene.num_objects,
            num_shapes=3 + sum(len(shape.convex_parts) for shape in scene.objects),
            num_joints=5 + _NUM_SUPPORTS * scene.num_objects,
        )
        self._add_gripper()
        for shape in scene.objects:
            add_object(self.world, shape, physics.gravity)
        self.world.freeze()

    def __reduce__(self) -> tuple[type[Simulator], tuple[Scene, Physics]]:
        """A pickled or deep-copied simulator is assembled anew: every motion begins from the same memory."""
        return type(self), (self.scene, self.physics)

    def _add_gripper(self) -> None:
        physics, gripper, world, half = self.physics, self.scene.gripper, self.world, self._half_stroke
        solid = {"friction": physics.gripper_friction, "group": _GRIPPER_GROUP}
        mass = physics.gripper_density * gripper.finger_length * gripper.finger_thickness
        self._palm = world.add_body(0.0, 0.0, [gripper.palm], **solid)
        self._fingers = [world.add_body(mass, _HUGE, [gripper.finger(side)], **solid) for side in (1, -1)]
        self._pinion = world.add_body(_HUGE, mass * _PINION_RADIUS**2)
        bias = {"error_bias": self._joint_bias}
        for finger, side in zip(self._fingers, (1.0, -1.0), strict=True):
            rail = sorted(((0.0, 0.0), (0.0, side * half)))
            slot = sorted(((0.0, 0.0), (side * 2.0 * _PINION_RADIUS, 0.0)))
            world.add_joint("GrooveJoint", (self._palm, finger), (*rail, _ORIGIN), **bias)
            pin = (side * _PINION_RADIUS, 0.0)
            world.add_joint("GrooveJoint", (finger, self._pinion), (*slot, pin), **bias)
        torque = 2.0 * physics.squeezing_force * _PINION_RADIUS
        self.motor = world.add_joint("SimpleMotor", (self._palm, self._pinion), (0.0,), max_force=torque, **bias)

    def advance(self, state: State, motion: GripperMotion) -> State:
        """Return the state in which the world comes to rest after ``motion``, starting from ``state``.

        Raises:
            SceneError: the numbers of objects in the state and the scene differ.
            SimulationError: a pose of the result is not finite.
        """
        if state.num_objects != self.scene.num_objects:
            raise SceneError(f"the state has {state.num_objects} objects and the scene {self.scene.num_objects}")
        closed = state.gripper_closed if motion.closed is None else motion.closed
        space = self.begin(state, closed)
        try:
            self.move(space, state, motion)
            self._settle(space)
            return self.read(space, closed)
        finally:
            lib.cpSpaceFree(space)

    def begin(self, state: State, closed: bool) -> Space:
        """Make a new space in ``state``, with the motor set to open or close the fingers."""
        x, y, theta, opening, _, *object_poses = state.vector.tolist()
        half = 0.5 * opening
        left, up = -math.sin(theta) * half, math.cos(theta) * half
        fingers = (x + left, y + up, theta, x - left, y - up, theta)
        pinion = theta + math.asin(half / _PINION_RADIUS)
        space = self.world.begin([x, y, theta, *fingers, x, y, pinion, *object_poses])
        lib.cpSpaceSetCollisionSlop(space, self.physics.contact_slop)
        lib.cpSpaceSetCollisionBias(space, self._overlap_bias)
        # A positive rate of Chipmunk's motor rotates the second body clockwise relative to the first.
        lib.cpSimpleMotorSetRate(self.motor, self.closing_rate if closed else -self.closing_rate)
        return space

    def move(self, space: Space, state: State, motion: GripperMotion) -> None:
        """Execute ``motion`` from ``state`` with a constant velocity."""
        physics = self.physics
        duration = physics.motion_steps * physics.time_step
        theta = float(state.vector[Column.GRIPPER_THETA])
        c, s = math.cos(theta), math.sin(theta)
        velocity = (
            (c * motion.forward - s * motion.left) / duration,
            (s * motion.forward + c * motion.left) / duration,
        )
        self._drive(velocity, motion.rotation / duration)
        grip_steps = physics.grip_steps if state.gripper_closed else 0
        lib.cpSpaceSetIterations(space, physics.grip_iterations)
        self.step(space, grip_steps)
        lib.cpSpaceSetIterations(space, physics.iterations)
        self.step(space, physics.motion_steps - grip_steps)
        self._drive(_ORIGIN, 0.0)

    def _drive(self, velocity: tuple[float, float], angular_velocity: float) -> None:
        """Move the palm at ``velocity`` [m/s] and rotate it [rad/s]; the fingers follow on their rails."""
        lib.cpBodySetVelocity(self._palm, velocity)
        lib.cpBodySetVelocity(self._pinion, velocity)
        lib.cpBodySetAngularVelocity(self._palm, angular_velocity)
        for finger in self._fingers:
            lib.cpBodySetAngularVelocity(finger, angular_velocity)

    def _settle(self, space: Space) -> None:
        physics = self.physics
        for steps in range(0, physics.settle_steps, _STEPS_BETWEEN_LOOKS):
            if steps == PATIENCE:
                lib.cpSpaceSetIterations(space, MORE_ITERATIONS * physics.iterations)
            self.step(space, _STEPS_BETWEEN_LOOKS)
            if self.world.top_speed(space) < physics.rest_speed:
                break

    def step(self, space: Space, steps: int) -> None:
        """Integrate ``steps`` time steps."""
        step, time_step = lib.cpSpaceStep, self.physics.time_step
        for _ in range(steps):
            step(space, time_step)

    def read(self, space: Space, closed: bool) -> State:
        """Read the current state; errors as :meth:`advance`."""
        palm, left, right, _, *object_poses = self.world.poses(space).tolist()
        x, y, theta = palm
        opening = math.cos(theta) * (left[1] - right[1]) - math.sin(theta) * (left[0] - right[0])
        opening = min(max(opening, 0.0), 2.0 * self._half_stroke)
        vector = [x, y, _wrapped(theta), opening, float(closed)]
        for x, y, theta in object_poses:
            vector += x, y, _wrapped(theta)
        if not math.isfinite(sum(vector)):
            raise SimulationError(f"the simulation diverged; the state vector became {vector}")
        return State(np.array(vector))


def _wrapped(angle: float) -> float:
    """The angle in [-pi, pi), unchanged if it is in the range; NaN if it is not finite."""
    return angle if -math.pi <= angle < math.pi else wrap_angle(angle)
