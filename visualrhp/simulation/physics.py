"""Parameters of the physics simulation."""

from __future__ import annotations

from dataclasses import dataclass

from visualrhp.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Physics:
    """How the world is simulated. SI units.

    Attributes:
        time_step: one step of the integrator [s].
        motion_steps: steps for which an action's velocity is held.
        settle_steps: most further steps, the hand at rest, until everything else has come to rest, too.
        rest_speed: a body is at rest below it [m/s], [rad/s].
        iterations: of the contact and joint solver, each step.
        grip_steps: first steps of a motion with the gripper closed, in which the forces of a grasp build up.
        grip_iterations: of the solver in these steps.
        gravity: [m/s^2]; presses the objects on the surface.
        contact_slop: overlap that the solver leaves alone [m].
        overlap_correction: share of a larger overlap that is taken back each step.
        joint_correction: share of a finger's distance from its rail that is taken back each step.
        gripper_density: mass per area of the fingers [kg/m^2] (footnote 3).
        gripper_friction: Coulomb coefficient of palm and fingers (footnote 3).
        squeezing_force: largest force of each finger [N].

    Raises:
        ConfigError: a parameter is out of range.
    """

    time_step: float = 0.01
    motion_steps: int = 50
    settle_steps: int = 200
    rest_speed: float = 1e-3
    iterations: int = 10
    grip_steps: int = 3
    grip_iterations: int = 100
    gravity: float = 9.81
    contact_slop: float = 5e-4
    overlap_correction: float = 0.5
    joint_correction: float = 0.5
    gripper_density: float = 1.0
    gripper_friction: float = 0.3
    squeezing_force: float = 0.1

    def __post_init__(self) -> None:
        for name in ("time_step", "rest_speed", "gravity", "gripper_density", "squeezing_force"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"physics.{name}={getattr(self, name)}: must be positive")
        for name in ("motion_steps", "settle_steps", "iterations", "grip_iterations"):
            if getattr(self, name) < 1:
                raise ConfigError(f"physics.{name}={getattr(self, name)}: must be at least 1")
        if not 0 <= self.grip_steps <= self.motion_steps:
            raise ConfigError(
                f"physics.grip_steps={self.grip_steps}: must be between 0 and motion_steps={self.motion_steps}"
            )
        for name in ("contact_slop", "gripper_friction"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"physics.{name}={getattr(self, name)}: must not be negative")
        for name in ("overlap_correction", "joint_correction"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ConfigError(f"physics.{name}={getattr(self, name)}: must be between 0 and 1")
