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
        settle_steps: further steps, the hand at rest, in which objects come to rest by friction.
        iterations: of the contact and joint solver, each step.
        gravity: [m/s^2]; presses the objects on the surface.
        contact_slop: overlap that the solver leaves alone [m].
        overlap_correction: share of a larger overlap that is taken back each step.
        joint_correction: share of the lag behind the commanded hand pose that the servo takes back each step.
        gripper_density: mass per area of palm and fingers [kg/m^2] (footnote 3).
        gripper_friction: Coulomb coefficient of palm and fingers (footnote 3).
        hand_inertia: moment of inertia of the drive that turns the palm [kg m^2].
        finger_inertia: moment of inertia that stands for a finger's stiff guide [kg m^2]; without it the solver does
            not hold the fingers straight against the arm that moves them.
        hand_force: limit of the servo that drives the palm [N].
        hand_torque: limit of the servo that turns the palm [N m].
        squeezing_force: of each finger [N].

    Raises:
        ConfigError: a parameter is out of range.
    """

    time_step: float = 0.01
    motion_steps: int = 50
    settle_steps: int = 10
    iterations: int = 10
    gravity: float = 9.81
    contact_slop: float = 1e-4
    overlap_correction: float = 0.5
    joint_correction: float = 0.5
    gripper_density: float = 1.0
    gripper_friction: float = 0.3
    hand_inertia: float = 1e-4
    finger_inertia: float = 1e-5
    hand_force: float = 5.0
    hand_torque: float = 0.5
    squeezing_force: float = 0.1

    def __post_init__(self) -> None:
        for name in ("time_step", "gravity", "gripper_density", "hand_force", "hand_torque", "squeezing_force"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"physics.{name}={getattr(self, name)}: must be positive")
        for name in ("motion_steps", "settle_steps", "iterations"):
            if getattr(self, name) < 1:
                raise ConfigError(f"physics.{name}={getattr(self, name)}: must be at least 1")
        for name in ("contact_slop", "gripper_friction"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"physics.{name}={getattr(self, name)}: must not be negative")
        for name in ("overlap_correction", "joint_correction"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ConfigError(f"physics.{name}={getattr(self, name)}: must be between 0 and 1")
