"""A Chipmunk space that restarts exactly and fast.

Chipmunk keeps impulses of contacts and joints, shape numbers and a bounding-box tree from step to step, so a reused
space does not repeat its results (issues 181 and 258 of pymunk). :class:`ChipmunkWorld` allocates all bodies, shapes
and joints in one block of memory. For every motion, the block is restored to its content before the first step, the
poses are written by one call, and everything is added to a new, empty space, always in the same order. With pymunk's
objects, this would take longer than the motion; with its C interface, it takes a tenth of the time of the motion.

A body that is added ``asleep`` costs no time until something touches it: its joints are linked to it once, and enter
the space with it.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from pymunk._chipmunk_cffi import ffi, lib  # a private module of pymunk, so the version is pinned in the constraints

from visualrhp.types import FloatArray

_BYTES = {"cpBody": 320, "cpPolyShape": 640}
_JOINT_BYTES = 320
_GUARD_BYTES = 32  # after each structure; Chipmunk's largest ones have 280, 600 and 288 bytes
_GUARD = 0xA5
_ALIGNMENT = 64
_ALL_CATEGORIES = 0xFFFFFFFF
_NEVER = 1e300  # finite, since Chipmunk disables sleeping otherwise
_SET_BODY = ffi.cast("cpSpaceBodyIteratorFunc", ffi.addressof(lib, "pmSpaceBodySetIteratorFuncBatched"))
_GET_BODY = ffi.cast("cpSpaceBodyIteratorFunc", ffi.addressof(lib, "pmSpaceBodyGetIteratorFuncBatched"))

Body = Any
"""``cpBody *``"""
Joint = Any
"""``cpConstraint *``"""
Space = Any
"""``cpSpace *``"""


class ChipmunkWorld:
    """Bodies with their shapes, and joints, assembled once and simulated from any poses.

    Assemble the world (:meth:`add_body`, :meth:`add_joint`), :meth:`freeze` it, and call :meth:`begin` for every
    motion. SI units.

    Args:
        num_bodies: largest number of bodies.
        num_shapes: largest number of convex parts of bodies.
        num_joints: largest number of joints.

    Attributes:
        ground: the body of the surface, which never moves.
        bodies: in the order in which they were added.
    """

    def __init__(self, num_bodies: int, num_shapes: int, num_joints: int) -> None:
        size = (num_bodies + 1) * _BYTES["cpBody"] + num_shapes * _BYTES["cpPolyShape"] + num_joints * _JOINT_BYTES
        memory = ffi.new("char[]", size + _ALIGNMENT)
        self._base = memory + -int(ffi.cast("uintptr_t", memory)) % _ALIGNMENT
        self._memory = np.frombuffer(ffi.buffer(self._base, size), dtype=np.uint8)
        self._guards: list[slice] = []
        self._end = 0
        self.bodies: list[Body] = []
        self._sleepers: list[Body] = []
        self.shapes: list[Any] = []
        self.joints: list[Joint] = []
        self._dormant_joints: list[Joint] = []
        self.ground = self._body(0.0, 0.0, "STATIC")
        # A polygon with many vertices stores some of them on the heap.
        weakref.finalize(self, _destroy_shapes, self.shapes, memory)

    def __reduce__(self) -> str:
        """Refuse to be pickled or copied."""
        raise TypeError("a ChipmunkWorld is memory of this process: copy or pickle the Simulator, which assembles one")

    def _place(self, kind: str) -> Any:
        """Reserve memory for one of Chipmunk's structures."""
        start, end = self._end, self._end + _BYTES.get(kind, _JOINT_BYTES)
        if end > self._memory.size:
            raise ValueError("the world has no memory for more bodies, shapes or joints than were requested")
        self._end = end
        self._guards.append(slice(end - _GUARD_BYTES, end))
        self._memory[self._guards[-1]] = _GUARD
        return ffi.cast(f"{kind} *", self._base + start)

    def _body(self, mass: float, moment: float, kind: str = "DYNAMIC") -> Body:
        body = self._place("cpBody")
        lib.cpBodyInit(body, mass, moment)
        if kind != "DYNAMIC":
            lib.cpBodySetType(body, getattr(lib, f"CP_BODY_TYPE_{kind}"))
        return body

    def add_body(
        self,
        mass: float,
        moment: float,
        parts: Sequence[FloatArray] = (),
        *,
        friction: float = 0.0,
        group: int = 0,
        asleep: bool = False,
    ) -> Body:
        """Add a rigid body.

        Args:
            mass: [kg]; a body without mass moves with the velocity that is set, whatever it touches.
            moment: of inertia about the origin of its frame [kg m^2].
            parts: convex outlines [V, 2] in its frame [m], counter-clockwise.
            friction: Coulomb coefficient; the friction of a contact is the geometric mean of both bodies.
            group: bodies of the same non-zero group do not collide with each other.
            asleep: whether it sleeps until something touches it. Such a body can only have joints with the ground.
        """
        body = self._body(mass, moment, "DYNAMIC" if mass > 0.0 else "KINEMATIC")
        lib.cpBodySetUserData(body, ffi.cast("void *", len(self.bodies)))
        for outline in parts:
            polygon = self._place("cpPolyShape")
            vertices = ffi.new("cpVect[]", [tuple(vertex) for vertex in outline.tolist()])
            lib.cpPolyShapeInitRaw(polygon, body, len(outline), vertices, 0.0)
            shape = ffi.cast("cpShape *", polygon)
            lib.cpShapeSetFriction(shape, math.sqrt(friction))  # Chipmunk multiplies the two
            lib.cpShapeSetFilter(shape, (group, _ALL_CATEGORIES, _ALL_CATEGORIES))
            self.shapes.append(shape)
        self.bodies.append(body)
        if asleep:
            self._sleepers.append(body)
        return body

    def add_joint(
        self,
        kind: str,
        bodies: tuple[Body, Body],
        parameters: tuple,
        *,
        max_force: float = math.inf,
        error_bias: float = 0.0,
        max_bias: float = math.inf,
    ) -> Joint:
        """Add one of Chipmunk's joints (``PivotJoint``, ``GearJoint``, ``GrooveJoint``, ``SimpleMotor``).

        Args:
            kind: its name in Chipmunk, without the prefix.
            bodies: the two bodies that it connects; a body added asleep must be the second, with the ground as the
                first.
            parameters: the remaining arguments of its ``Init`` function.
            max_force: largest force [N], or torque [N m] for an angular joint.
            error_bias: share of its error that remains after a second.
            max_bias: largest speed with which it corrects an error [m/s], [rad/s].
        """
        place = self._place(f"cp{kind}")
        getattr(lib, f"cp{kind}Init")(place, *bodies, *parameters)
        joint = ffi.cast("cpConstraint *", place)
        lib.cpConstraintSetMaxForce(joint, max_force)
        lib.cpConstraintSetErrorBias(joint, error_bias)
        lib.cpConstraintSetMaxBias(joint, max_bias)
        (self._dormant_joints if bodies[1] in self._sleepers else self.joints).append(joint)
        return joint

    def freeze(self) -> None:
        """Save the current content of the memory, with which every space begins."""
        if not all((self._memory[guard] == _GUARD).all() for guard in self._guards):
            raise RuntimeError("the structures of this pymunk version are larger than those of the pinned version")
        # Chipmunk removes a body's joints from the space when it falls asleep and adds them when it wakes. With joints
        # linked to their bodies like this, it is not necessary to add and remove them first.
        space = lib.cpSpaceNew()
        for joint in self._dormant_joints:
            lib.cpSpaceAddConstraint(space, joint)
        lib.cpSpaceFree(space)
        self._used = self._memory[: self._end]
        self._template = self._used.copy()
        num_bodies = len(self.bodies)
        spare = 4  # pymunk's arrays are reallocated when they are nearly full, which must not happen here
        self._poses = np.zeros(3 * num_bodies)
        self._read = np.zeros(3 * num_bodies + spare)
        self._numbers = np.zeros(num_bodies + spare, dtype=np.uintp)
        self._poses_array = _float_array(self._poses)
        self._read_array = _float_array(self._read)
        self._numbers_array = ffi.new("pmIntArray *")
        self._numbers_array.arr = ffi.from_buffer("uintptr_t[]", self._numbers)
        self._numbers_array.max = self._numbers.size
        pose, velocity = lib.POSITION | lib.ANGLE, lib.VELOCITY | lib.ANGULAR_VELOCITY
        read = {"intArray": self._numbers_array, "floatArray": self._read_array}
        self._set_poses = ffi.new("pmBatchedData *", {"floatArray": self._poses_array, "fields": pose})
        self._get_poses = ffi.new("pmBatchedData *", {**read, "fields": lib.BODY_ID | pose})
        self._get_velocities = ffi.new("pmBatchedData *", {**read, "fields": velocity})

    def begin(self, poses: Sequence[float] | FloatArray) -> Space:
        """Make a new space with all bodies at rest; free it (``lib.cpSpaceFree``) before making the next one.

        Args:
            poses: [3 bodies] x [m], y [m], angle [rad] of every body.
        """
        self._used[...] = self._template
        self._poses[...] = poses
        self._poses_array.num = 0
        space = lib.cpSpaceNew()
        lib.cpSpaceSetSleepTimeThreshold(space, _NEVER)
        add_body, add_shape, add_joint, sleep = (
            lib.cpSpaceAddBody,
            lib.cpSpaceAddShape,
            lib.cpSpaceAddConstraint,
            lib.cpBodySleep,
        )
        for body in self.bodies:
            add_body(space, body)
        lib.cpSpaceEachBody(space, _SET_BODY, self._set_poses)
        for shape in self.shapes:
            add_shape(space, shape)
        for joint in self.joints:
            add_joint(space, joint)
        for body in self._sleepers:
            sleep(body)
        return space

    def poses(self, space: Space) -> FloatArray:
        """[bodies, 3] x [m], y [m] and unwrapped angle [rad] of every body."""
        self._read_array.num = self._numbers_array.num = 0
        lib.cpSpaceEachBody(space, _GET_BODY, self._get_poses)
        count = len(self.bodies)
        poses = np.empty((count, 3))
        poses[self._numbers[:count]] = self._read[: 3 * count].reshape(count, 3)  # sleeping bodies come last
        return poses

    def top_speed(self, space: Space) -> float:
        """The largest component of a body's velocity [m/s] and angular velocity [rad/s]."""
        self._read_array.num = 0
        lib.cpSpaceEachBody(space, _GET_BODY, self._get_velocities)
        velocities = self._read[: 3 * len(self.bodies)]
        return float(max(velocities.max(), -velocities.min()))


def _float_array(values: FloatArray) -> Any:
    """Wrap an array for pymunk; the array must outlive the result."""
    array = ffi.new("pmFloatArray *")
    array.arr = ffi.from_buffer("double[]", values)
    array.max = values.size
    return array


def _destroy_shapes(shapes: list[Any], memory: Any) -> None:
    for shape in shapes:
        lib.cpShapeDestroy(shape)
    del memory  # must not be released earlier
