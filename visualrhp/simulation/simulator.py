"""Quasi-static planar physics: state and gripper motion to next state, on Chipmunk (pymunk).

The simulator is Markov to the bit: the next state is a function of (scene, state, motion) and of nothing simulated
before. Chipmunk keeps impulses of contacts and joints, shape numbers and a bounding-box tree from step to step, so each
motion is simulated in a new ``cpSpace`` whose bodies, shapes and joints are initialised again in the same order. Going
through pymunk's objects that costs more than the motion itself; its C interface makes it cheap.

Bodies: a kinematic *guide* moves exactly as commanded and drags the *palm* along through force-limited joints. The two
*fingers* slide sideways on the palm, rack-and-pinion fashion: an arm that turns on the palm carries a pin at each end,
one in a slot of each finger, so that one force-limited motor opens and closes both symmetrically. A *ground* body holds
the objects by force- and torque-limited joints without position correction, which is Coulomb friction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from pymunk._chipmunk_cffi import ffi, lib  # pinned in the constraints: a private name of pymunk's

from visualrhp.errors import SceneError, SimulationError
from visualrhp.scene import geometry
from visualrhp.scene.scene import Scene
from visualrhp.simulation.action_spaces import GripperMotion
from visualrhp.simulation.physics import Physics
from visualrhp.types import FloatArray, State, wrap_angle

_GRIPPER_GROUP = 1
_ALL_CATEGORIES = 0xFFFFFFFF
_INFINITY = math.inf
_ORIGIN = (0.0, 0.0)
_ARM_LENGTH = 0.06
"""From the arm's pivot to its pins [m]; a little more than half the stroke, so the arm stays below 45 degrees."""


class _Body:
    """A Chipmunk body with its convex shapes, initialised anew for every motion; without mass it is kinematic."""

    def __init__(
        self, mass: float, moment: float, outlines: Sequence[FloatArray] = (), friction: float = 0.0, group: int = 0
    ) -> None:
        self.pointer = ffi.gc(lib.cpBodyAlloc(), lib.cpBodyFree)
        self._mass = mass
        self._moment = moment
        # The product of two shapes' coefficients is their contact's: with square roots it is their geometric mean.
        self._friction = math.sqrt(friction)
        self._filter = (group, _ALL_CATEGORIES, _ALL_CATEGORIES)
        self._shapes = []
        for outline in outlines:
            shape = ffi.gc(lib.cpPolyShapeAlloc(), lambda pointer: lib.cpShapeFree(ffi.cast("cpShape *", pointer)))
            vertices = ffi.new("cpVect[]", [tuple(vertex) for vertex in outline.tolist()])
            self._shapes.append((shape, ffi.cast("cpShape *", shape), len(outline), vertices))
            lib.cpPolyShapeInitRaw(shape, self.pointer, len(outline), vertices, 0.0)

    def place(self, space: object, x: float, y: float, angle: float) -> None:
        """Add the body at rest to a new ``space``."""
        if self._mass == 0.0:  # Chipmunk does not initialise a kinematic body twice
            self.pointer = ffi.gc(lib.cpBodyNewKinematic(), lib.cpBodyFree)
        else:
            lib.cpBodyInit(self.pointer, self._mass, self._moment)
        body = self.pointer
        lib.cpBodySetPosition(body, (x, y))
        lib.cpBodySetAngle(body, angle)
        lib.cpSpaceAddBody(space, body)
        for shape, base, count, vertices in self._shapes:
            lib.cpShapeDestroy(base)
            lib.cpPolyShapeInitRaw(shape, body, count, vertices, 0.0)
            lib.cpShapeSetFriction(base, self._friction)
            lib.cpShapeSetFilter(base, self._filter)
            lib.cpSpaceAddShape(space, base)

    def pose(self) -> tuple[float, float, float]:
        """x, y [m] and unwrapped angle [rad]."""
        position = lib.cpBodyGetPosition(self.pointer)
        return position.x, position.y, lib.cpBodyGetAngle(self.pointer)


class _Joint:
    """A Chipmunk joint, initialised anew for every motion so that it carries no impulse over."""

    def __init__(
        self,
        kind: str,
        bodies: tuple[_Body, _Body],
        parameters: tuple,
        max_force: float,
        error_bias: float,
        max_bias: float = _INFINITY,
    ) -> None:
        self._initialise = getattr(lib, f"cp{kind}Init")
        self._joint = getattr(lib, f"cp{kind}Alloc")()
        self.pointer = ffi.gc(ffi.cast("cpConstraint *", self._joint), lib.cpConstraintFree)
        self._bodies = bodies
        self._parameters = parameters
        self._max_force = max_force
        self._error_bias = error_bias
        self._max_bias = max_bias

    def attach(self, space: object) -> None:
        self._initialise(self._joint, self._bodies[0].pointer, self._bodies[1].pointer, *self._parameters)
        lib.cpConstraintSetMaxForce(self.pointer, self._max_force)
        lib.cpConstraintSetErrorBias(self.pointer, self._error_bias)
        lib.cpConstraintSetMaxBias(self.pointer, self._max_bias)
        lib.cpSpaceAddConstraint(space, self.pointer)


class Simulator:
    """Simulates gripper motions in one scene.

    Not to be shared between threads; to send one to another process, send the scene.
    """

    def __init__(self, scene: Scene, physics: Physics) -> None:
        self.scene = scene
        self.physics = physics
        gripper, density = scene.gripper, physics.gripper_density
        self._guide = _Body(0.0, 0.0)
        self._ground = _Body(0.0, 0.0)
        self._palm = self._gripper_body(gripper.palm, physics.hand_inertia)
        self._left = self._gripper_body(gripper.finger(1), physics.finger_inertia)
        self._right = self._gripper_body(gripper.finger(-1), physics.finger_inertia)
        arm_mass = density * gripper.finger_length * gripper.finger_thickness
        self._arm = _Body(arm_mass, arm_mass * _ARM_LENGTH**2)
        self._objects = [
            _Body(shape.mass, shape.moment_of_inertia, [shape.outline], shape.friction) for shape in scene.objects
        ]
        self._half_stroke = gripper.stroke / 2.0
        self._closing_rate = math.asin(self._half_stroke / _ARM_LENGTH) / (
            0.8 * physics.motion_steps * physics.time_step
        )
        # Chipmunk counts the share of an error that is left after a second.
        self._collision_bias = (1.0 - physics.overlap_correction) ** (1.0 / physics.time_step)
        self._joint_bias = (1.0 - physics.joint_correction) ** (1.0 / physics.time_step)
        self._joints = [*self._gripper_joints(), *self._surface_joints()]

    def _gripper_body(self, outline: FloatArray, drive_inertia: float) -> _Body:
        """Palm or finger, its mass taken about the origin of the frame in which it is driven."""
        density = self.physics.gripper_density
        return _Body(
            density * geometry.signed_area(outline),
            density * geometry.second_moment_of_area(outline) + drive_inertia,
            [outline],
            self.physics.gripper_friction,
            _GRIPPER_GROUP,
        )

    def _surface_joints(self) -> list[_Joint]:
        """Coulomb friction of the objects on the surface: it resists velocity up to a limit and restores nothing."""
        joints = []
        for body, shape in zip(self._objects, self.scene.objects, strict=True):
            force = shape.friction * shape.mass * self.physics.gravity
            bodies = (self._ground, body)
            joints += [
                _Joint("PivotJoint", bodies, (_ORIGIN, _ORIGIN), force, self._joint_bias, max_bias=0.0),
                _Joint("GearJoint", bodies, (0.0, 1.0), force * shape.friction_lever, self._joint_bias, max_bias=0.0),
            ]
        return joints

    def _gripper_joints(self) -> list[_Joint]:
        physics, half, bias = self.physics, self._half_stroke, self._joint_bias
        drive, pivot = (self._guide, self._palm), (self._palm, self._arm)
        joints = [
            _Joint("PivotJoint", drive, (_ORIGIN, _ORIGIN), physics.hand_force, bias),
            _Joint("GearJoint", drive, (0.0, 1.0), physics.hand_torque, bias),
            _Joint("PivotJoint", pivot, (_ORIGIN, _ORIGIN), _INFINITY, bias),
        ]
        for finger, side in ((self._left, 1.0), (self._right, -1.0)):
            rail = sorted(((0.0, 0.0), (0.0, side * half)))
            slot = sorted(((0.0, 0.0), (side * 2.0 * _ARM_LENGTH, 0.0)))
            pin = (side * _ARM_LENGTH, 0.0)
            joints += [
                _Joint("GrooveJoint", (self._palm, finger), (*rail, _ORIGIN), _INFINITY, bias),
                _Joint("GearJoint", (self._palm, finger), (0.0, 1.0), _INFINITY, bias),
                _Joint("GrooveJoint", (finger, self._arm), (*slot, pin), _INFINITY, bias),
            ]
        torque = 2.0 * physics.squeezing_force * _ARM_LENGTH
        self._motor = _Joint("SimpleMotor", pivot, (0.0,), torque, bias)
        return [*joints, self._motor]

    def advance(self, state: State, motion: GripperMotion) -> State:
        """The state in which the world comes to rest after ``motion``, started from ``state``.

        Raises:
            SceneError: the state has another number of objects than the scene.
            SimulationError: a pose of the result is not finite.
        """
        if state.num_objects != self.scene.num_objects:
            raise SceneError(f"the state has {state.num_objects} objects and the scene {self.scene.num_objects}")
        closed = state.gripper_closed if motion.closed is None else motion.closed
        space = lib.cpSpaceNew()
        try:
            self._set_up(space, state, closed)
            self._run(space, state, motion)
            return self._read(closed)
        finally:
            lib.cpSpaceFree(space)

    def _set_up(self, space: object, state: State, closed: bool) -> None:
        physics = self.physics
        lib.cpSpaceSetIterations(space, physics.iterations)
        lib.cpSpaceSetCollisionSlop(space, physics.contact_slop)
        lib.cpSpaceSetCollisionBias(space, self._collision_bias)
        x, y, theta, opening, _, *object_poses = state.vector.tolist()
        half = 0.5 * opening
        lateral = (-math.sin(theta) * half, math.cos(theta) * half)
        self._ground.place(space, 0.0, 0.0, 0.0)
        self._guide.place(space, x, y, theta)
        self._palm.place(space, x, y, theta)
        self._left.place(space, x + lateral[0], y + lateral[1], theta)
        self._right.place(space, x - lateral[0], y - lateral[1], theta)
        self._arm.place(space, x, y, theta + math.asin(half / _ARM_LENGTH))
        for number, body in enumerate(self._objects):
            body.place(space, *object_poses[3 * number : 3 * number + 3])
        for joint in self._joints:
            joint.attach(space)
        # A positive rate of Chipmunk's motor turns the second body clockwise relative to the first.
        lib.cpSimpleMotorSetRate(self._motor.pointer, self._closing_rate if closed else -self._closing_rate)

    def _run(self, space: object, state: State, motion: GripperMotion) -> None:
        physics = self.physics
        step, time_step = lib.cpSpaceStep, physics.time_step
        duration = physics.motion_steps * time_step
        theta = float(state.vector[2])
        c, s = math.cos(theta), math.sin(theta)
        velocity = (
            (c * motion.forward - s * motion.left) / duration,
            (s * motion.forward + c * motion.left) / duration,
        )
        guide = self._guide.pointer
        lib.cpBodySetVelocity(guide, velocity)
        lib.cpBodySetAngularVelocity(guide, motion.rotation / duration)
        for _ in range(physics.motion_steps):
            step(space, time_step)
        lib.cpBodySetVelocity(guide, (0.0, 0.0))
        lib.cpBodySetAngularVelocity(guide, 0.0)
        for _ in range(physics.settle_steps):
            step(space, time_step)

    def _read(self, closed: bool) -> State:
        palm = self._palm.pose()
        left, right = self._left.pose(), self._right.pose()
        c, s = math.cos(palm[2]), math.sin(palm[2])
        opening = c * (left[1] - right[1]) - s * (left[0] - right[0])
        vector = np.array(
            [
                *palm,
                min(max(opening, 0.0), 2.0 * self._half_stroke),
                closed,
                *(v for o in self._objects for v in o.pose()),
            ]
        )
        if not np.isfinite(vector).all():
            raise SimulationError(f"the simulation diverged; the state vector became {vector.tolist()}")
        vector[2] = wrap_angle(vector[2])
        vector[7::3] = wrap_angle(vector[7::3])
        return State(vector)
