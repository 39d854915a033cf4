"""Parameters of the physics simulation."""

from __future__ import annotations

from typing import Annotated

from visualrhp.parameters import Count, Field, Index, NonNegative, Positive, parameters

Share = Annotated[float, Field(gt=0, lt=1)]


@parameters
class Physics:
    """Parameters of the simulation. SI units.

    Attributes:
        time_step: one step of the integrator [s].
        motion_steps: number of steps with the velocity of the action.
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

    time_step: Positive = 0.01
    motion_steps: Count = 50
    settle_steps: Count = 200
    rest_speed: Positive = 1e-3
    iterations: Count = 10
    grip_steps: Index = 3
    grip_iterations: Count = 100
    gravity: Positive = 9.81
    contact_slop: NonNegative = 5e-4
    overlap_correction: Share = 0.5
    joint_correction: Share = 0.5
    gripper_density: Positive = 1.0
    gripper_friction: NonNegative = 0.3
    squeezing_force: Positive = 0.1

    def __post_init__(self) -> None:
        if self.grip_steps > self.motion_steps:
            raise ValueError(
                f"grip_steps={self.grip_steps}: it should be between 0 and motion_steps={self.motion_steps}."
            )
