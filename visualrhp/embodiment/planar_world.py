"""A task of the robot cell in the planner's simulator, to tell what the arm, friction and the third dimension cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.looking import StepLatency
from visualrhp.execution.world import World
from visualrhp.scene.scene import Scene
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import Action, FloatArray, State


class PlanarWorld(World):
    """A task in the plane: gripper and objects are what the planner takes them for.

    Args:
        scene: as the planner knows it.
        state: at the start.
        action_space: of the actions.
        physics: of the simulator.
        frictions: [m] Coulomb coefficients of the objects; None for those that the planner knows.
        masses: [m] of the objects [kg]; None for those that the planner knows.
        kinematics: of an arm, which has to be able to make the motions; None for a gripper without an arm.
        joints: [6] positions of the arm at the start [rad].

    Attributes:
        joints: [6] positions of the arm [rad]; None without an arm.
        followers: called with the scene after every action, such as ``ReachableModel.follow``.
        latencies: one for every action so far, and one for that to come; nothing is measured.
    """

    def __init__(
        self,
        scene: Scene,
        state: State,
        action_space: ActionSpace,
        physics: Physics | None = None,
        *,
        frictions: npt.ArrayLike | None = None,
        masses: npt.ArrayLike | None = None,
        kinematics: ArmKinematics | None = None,
        joints: FloatArray | None = None,
    ) -> None:
        self.joints = None if kinematics is None else joints
        self.followers: list[Callable[[Scene], None]] = []
        self.latencies = [StepLatency()]
        self._scene, self._state = scene, state
        self._space = action_space
        self._kinematics = kinematics
        shapes = scene.objects
        if frictions is not None:
            shapes = [replace(shape, friction=float(f)) for shape, f in zip(shapes, np.asarray(frictions), strict=True)]
        if masses is not None:
            parts = zip(shapes, np.asarray(masses), strict=True)
            shapes = [replace(shape, density=float(mass) / shape.area) for shape, mass in parts]
        true = Scene(scene.target, tuple(shapes), scene.edges, scene.gripper)
        self._model = TransitionModel(true, action_space, physics)

    def observe(self) -> tuple[Scene, State]:
        return self._scene, self._state

    def act(self, action: Action) -> None:
        if self._kinematics is not None:
            motion = self._space.motion(action)
            if motion.forward or motion.left or motion.rotation:
                assert self.joints is not None
                self.joints = self._kinematics.path(self.joints, motion).positions[-1]
        self._state = self._model.advance(self._state, action)
        self.latencies.append(StepLatency())
        for follow in self.followers:
            follow(self._scene)

    def close(self) -> None:
        pass
