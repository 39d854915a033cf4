"""Parameters of the physics simulation."""

from __future__ import annotations

import math
from typing import Annotated

from visualrhp.errors import ConfigError
from visualrhp.parameters import Field, NonNegative, parameters
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.polygons import MIN_OBJECT_THICKNESS
from visualrhp.simulation.action_spaces import MAX_TRANSLATION

LONGEST_MOTION = math.hypot(MAX_TRANSLATION, MAX_TRANSLATION)
"""The longest translation of an action [m], along a diagonal."""

MAX_SPEED = 2.0
"""Largest speed of the gripper [m/s]: what it hits slides on by v^2 / (2 mu g), here 70 cm, beyond any table."""

Share = Annotated[float, Field(gt=0, lt=1)]
Bounded = Annotated[float, Field(gt=0, le=1e6)]
Steps = Annotated[int, Field(ge=1, le=10_000)]


@parameters
class Physics:
    """Parameters of the simulation. SI units.

    Attributes:
        time_step: one step of the integrator [s].
        motion_steps: number of steps with the velocity of the action. With fewer than :func:`least_motion_steps` of
            the gripper, its fingers could pass through an object between two steps.
        settle_steps: largest number of further steps, with the gripper at rest, until all objects are at rest.
        rest_speed: bodies slower than this are at rest [m/s], [rad/s].
        iterations: of the contact and joint solver in each step.
        grip_steps: first steps of a motion with closed gripper, in which the forces of a grasp build up.
        grip_iterations: of the solver in these steps.
        gravity: [m/s^2]; presses the objects onto the surface.
        contact_slop: overlap that the solver does not correct [m].
        overlap_correction: share of a larger overlap that is corrected in each step.
        joint_correction: share of a finger's distance from its rail that is corrected in each step.
        gripper_density: mass per area of the fingers [kg/m^2] (footnote 3).
        gripper_friction: Coulomb coefficient of palm and fingers (footnote 3).
        squeezing_force: largest force of each finger [N].

    Raises:
        ConfigError: a parameter is out of range.
    """

    time_step: Annotated[float, Field(gt=0, le=0.1)] = 0.01
    motion_steps: Steps = 50
    settle_steps: Steps = 200
    rest_speed: Bounded = 1e-3
    iterations: Steps = 10
    grip_steps: Annotated[int, Field(ge=0, le=10_000)] = 3
    grip_iterations: Steps = 100
    gravity: Bounded = 9.81
    contact_slop: NonNegative = 5e-4
    overlap_correction: Share = 0.5
    joint_correction: Share = 0.5
    gripper_density: Bounded = 1.0
    gripper_friction: Annotated[float, Field(ge=0, le=1e6)] = 0.3
    squeezing_force: Bounded = 0.1

    def __post_init__(self) -> None:
        if self.grip_steps > self.motion_steps:
            raise ValueError(
                f"grip_steps={self.grip_steps}: it should be between 0 and motion_steps={self.motion_steps}."
            )
        needed = least_motion_steps(Gripper().finger_thickness)
        if self.motion_steps < needed:
            raise ValueError(
                f"motion_steps={self.motion_steps} is out of range: it should be at least {needed}, since the gripper "
                f"would move by up to {1e3 * LONGEST_MOTION / self.motion_steps:.0f} mm in a step and pass through "
                "what it hits. For faster motions, decrease time_step."
            )
        speed = LONGEST_MOTION / (self.motion_steps * self.time_step)
        if speed > MAX_SPEED:
            raise ValueError(
                f"time_step={self.time_step:g} is out of range: with motion_steps={self.motion_steps}, the gripper "
                f"would move at up to {speed:.3g} m/s and shoot away what it hits; it should be at most {MAX_SPEED:g} "
                f"m/s, so time_step at least {LONGEST_MOTION / MAX_SPEED / self.motion_steps:.2g}."
            )
        drift = self.rest_speed * self.time_step
        if drift > 0.5 * MIN_OBJECT_THICKNESS:
            raise ValueError(
                f"rest_speed={self.rest_speed:g} is out of range: an object that counts as at rest would move by "
                f"{1e3 * drift:.3g} mm in a step of time_step={self.time_step:g} s; it should be at most "
                f"{0.5 * MIN_OBJECT_THICKNESS / self.time_step:.2g}."
            )

    def check_gripper(self, gripper: Gripper) -> None:
        """Check that no part of ``gripper`` is too thin for the steps of a motion.

        Raises:
            ConfigError: it could pass through an object between two steps.
        """
        for name in ("finger_thickness", "finger_length", "palm_length", "palm_front_width", "palm_back_width"):
            thickness = getattr(gripper, name)
            needed = least_motion_steps(thickness)
            if self.motion_steps < needed:
                least = 2.0 * LONGEST_MOTION / self.motion_steps - MIN_OBJECT_THICKNESS
                raise ConfigError(
                    f"gripper.{name}={thickness:g}: a part this thin could pass through an object in one of the "
                    f"motion_steps={self.motion_steps} of a motion; it should be at least {least:.2g} m, or "
                    f"physics.motion_steps at least {needed}."
                )


def least_motion_steps(thickness: float) -> int:
    """The number of steps in which a part of the gripper of a ``thickness`` [m] makes the longest motion safely.

    A body that enters another is pushed out on the side that is nearer. So that this is the side from which it came, it
    moves by less than half of both thicknesses in a step; the thinnest object has :data:`MIN_OBJECT_THICKNESS`.
    """
    return math.ceil(LONGEST_MOTION / (0.5 * (thickness + MIN_OBJECT_THICKNESS)))
