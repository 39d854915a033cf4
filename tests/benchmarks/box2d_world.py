"""The same world in Box2D, which shares no code with the simulator: where a model is wrong as a real table would be.

Geometry, masses, contact friction, the limited squeezing force and the motion of the palm are those of
:mod:`visualrhp.simulation`. How the surface resists an object is one of two laws:

- ``crude``: one friction joint, whose limits of force and torque do not depend on each other;
- ``close``: several friction joints without torque, spread over the object: a limit surface, as in the simulator.

Box2D works best with bodies of about a metre, so lengths and forces are scaled by :data:`SCALE`, but not masses.
"""

from __future__ import annotations

import math
from typing import Literal

import Box2D
import numpy as np

from visualrhp.errors import SimulationError
from visualrhp.execution.world import World
from visualrhp.scene import Scene, TaskInstance
from visualrhp.simulation import ActionSpace, Physics
from visualrhp.types import Action, Column, FloatArray, State, wrap_angle

SCALE = 20.0
MAX_VERTICES = 8
"""Of a polygon, in Box2D."""
SUPPORTS = 7
"""Friction joints of the close law, on a ring."""
FINGER_MASS = 1.0
"""[kg]; heavy, so that pushing objects with a finger does not bend its rail."""

SurfaceLaw = Literal["crude", "close"]


class Box2DWorld(World):
    """A task instance in Box2D.

    Args:
        instance: the scene, and the initial state.
        action_space: of :meth:`act`.
        law: how the surface resists sliding and turning.
        physics: parameters that both engines share.
    """

    def __init__(
        self, instance: TaskInstance, action_space: ActionSpace, law: SurfaceLaw, physics: Physics | None = None
    ) -> None:
        self._scene = instance.scene
        self._action_space = action_space
        self._physics = physics or Physics()
        self._closed = instance.state.gripper_closed
        self._world = Box2D.b2World(gravity=(0.0, 0.0), doSleep=False)
        self._ground = self._world.CreateStaticBody()
        poses = instance.state.object_poses
        self._objects = [self._add_object(index, pose, law) for index, pose in enumerate(poses)]
        self._add_gripper(instance.state)

    def _add_body(
        self, dynamic: bool, pose: FloatArray, outlines: list[FloatArray], friction: float, group: int
    ) -> Box2D.b2Body:
        create = self._world.CreateDynamicBody if dynamic else self._world.CreateKinematicBody
        body = create(position=(SCALE * pose[0], SCALE * pose[1]), angle=float(pose[2]))
        for outline in outlines:
            for polygon in _pieces(outline):
                # Box2D takes the geometric mean of the frictions of two shapes, Chipmunk their product.
                fixture = Box2D.b2FixtureDef(
                    shape=Box2D.b2PolygonShape(vertices=[tuple(v) for v in (SCALE * polygon).tolist()]),
                    density=1.0,
                    friction=friction**2,
                    groupIndex=group,
                )
                body.CreateFixture(fixture)
        return body

    def _add_object(self, index: int, pose: FloatArray, law: SurfaceLaw) -> Box2D.b2Body:
        shape = self._scene.objects[index]
        body = self._add_body(True, pose, list(shape.convex_parts), shape.friction, 0)
        inertia = SCALE**2 * shape.moment_of_inertia
        body.massData = Box2D.b2MassData(mass=shape.mass, center=(0.0, 0.0), I=inertia)
        force = SCALE * shape.friction * shape.mass * self._physics.gravity
        lever = SCALE * shape.friction_lever
        if law == "crude":
            self._resist(body, (0.0, 0.0), force, force * lever)
        else:
            for angle in 2.0 * math.pi * np.arange(SUPPORTS) / SUPPORTS:
                self._resist(body, (lever * math.cos(angle), lever * math.sin(angle)), force / SUPPORTS, 0.0)
        return body

    def _resist(self, body: Box2D.b2Body, anchor: tuple[float, float], force: float, torque: float) -> None:
        self._world.CreateFrictionJoint(
            bodyA=self._ground,
            bodyB=body,
            localAnchorA=body.GetWorldPoint(anchor),
            localAnchorB=anchor,
            maxForce=force,
            maxTorque=torque,
        )

    def _add_gripper(self, state: State) -> None:
        gripper, physics = self._scene.gripper, self._physics
        pose = state.vector[Column.GRIPPER_POSE]
        half = gripper.stroke / 2.0
        side = np.array([-math.sin(pose[2]), math.cos(pose[2]), 0.0]) * state.vector[Column.OPENING] / 2.0
        self._palm = self._add_body(False, pose, [gripper.palm], physics.gripper_friction, -1)
        rails = []
        for sign in (1, -1):
            finger = self._add_body(True, pose + sign * side, [gripper.finger(sign)], physics.gripper_friction, -1)
            inertia = SCALE**2 * FINGER_MASS * gripper.finger_length**2
            finger.massData = Box2D.b2MassData(mass=FINGER_MASS, center=(0.0, 0.0), I=inertia)
            rails.append(
                self._world.CreatePrismaticJoint(
                    bodyA=self._palm,
                    bodyB=finger,
                    localAnchorA=(0.0, 0.0),
                    localAnchorB=(0.0, 0.0),
                    localAxisA=(0.0, float(sign)),
                    referenceAngle=0.0,
                    enableLimit=True,
                    lowerTranslation=0.0,
                    upperTranslation=SCALE * half,
                    enableMotor=True,
                    maxMotorForce=SCALE * physics.squeezing_force,
                )
            )
        self._rails = rails
        # Both fingers move by the same distance, as on a pinion.
        self._world.CreateGearJoint(
            bodyA=rails[0].bodyB, bodyB=rails[1].bodyB, joint1=rails[0], joint2=rails[1], ratio=-1.0
        )

    def observe(self) -> tuple[Scene, State]:
        opening = sum(rail.translation for rail in self._rails) / SCALE
        opening = min(max(opening, 0.0), self._scene.gripper.stroke)
        return self._scene, State.create(
            _pose(self._palm), opening, self._closed, np.array([_pose(body) for body in self._objects]).reshape(-1, 3)
        )

    def act(self, action: Action) -> None:
        motion, physics = self._action_space.motion(action), self._physics
        self._closed = self._closed if motion.closed is None else motion.closed
        bodies = [*self._objects, *(rail.bodyB for rail in self._rails)]
        for body in bodies:
            body.linearVelocity, body.angularVelocity = (0.0, 0.0), 0.0
        duration = physics.motion_steps * physics.time_step
        speed = SCALE * self._scene.gripper.stroke / 2.0 / (0.8 * duration)
        for rail in self._rails:
            rail.motorSpeed = -speed if self._closed else speed
        c, s = math.cos(self._palm.angle), math.sin(self._palm.angle)
        self._palm.linearVelocity = (
            SCALE * (c * motion.forward - s * motion.left) / duration,
            SCALE * (s * motion.forward + c * motion.left) / duration,
        )
        self._palm.angularVelocity = motion.rotation / duration
        self._step(physics.motion_steps)
        self._palm.linearVelocity, self._palm.angularVelocity = (0.0, 0.0), 0.0
        for _ in range(physics.settle_steps // 5):
            self._step(5)
            if all(
                body.linearVelocity.length < SCALE * physics.rest_speed
                and abs(body.angularVelocity) < physics.rest_speed
                for body in bodies
            ):
                break
        if not np.isfinite([_pose(body) for body in bodies]).all():
            raise SimulationError("Box2D diverged")

    def _step(self, count: int) -> None:
        for _ in range(count):
            self._world.Step(self._physics.time_step, 20, 10)

    def close(self) -> None:
        pass


def _pose(body: Box2D.b2Body) -> FloatArray:
    return np.array([body.position[0] / SCALE, body.position[1] / SCALE, wrap_angle(body.angle)])


def _pieces(polygon: FloatArray) -> list[FloatArray]:
    """A convex polygon as fans of at most :data:`MAX_VERTICES` vertices."""
    step = MAX_VERTICES - 2
    return [
        polygon[[0, *range(first, min(first + step, len(polygon) - 1) + 1)]]
        for first in range(1, len(polygon) - 1, step)
    ]
