"""The planner's model of the robot cell: what the camera saw last, moved only as the arm can move."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
import shapely

from visualrhp.embodiment.reach import ReachMap, TurningRange
from visualrhp.errors import SimulationError
from visualrhp.scene.noise import perturb
from visualrhp.scene.scene import Scene
from visualrhp.simulation import rules
from visualrhp.simulation.action_spaces import ActionSpace, GripperMotion
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import Action, State, Transition

_MOVED: Final = 1e-2
"""Less is no motion of an object towards an edge [m]."""


class ReachableModel:
    """A model for planners (PlanningModel) in which a motion that the arm cannot make is an invalid action.

    Planners keep the model with which they began, and the camera's scene changes between decisions: after
    :meth:`follow`, the model and all that were perturbed from it simulate the new scene. A copy, such as an unpickled
    one, follows on its own, together with the perturbed models that are copied with it.

    Args:
        scene: as observed.
        action_space: of the planner.
        reach: what the arm can reach; None if it can reach everything.
        physics: of the simulator.
        edge_margin: in perturbed models, an object that is pushed closer to an edge than a part of this counts as
            dropped [m]: in three dimensions, it may tip or roll on. It may change.

    Attributes:
        action_space, reach, edge_margin: as given.
    """

    def __init__(
        self,
        scene: Scene,
        action_space: ActionSpace,
        reach: ReachMap | None = None,
        physics: Physics | None = None,
        edge_margin: float = 0.0,
    ) -> None:
        self.action_space = action_space
        self.reach = reach
        self.edge_margin = edge_margin
        self._turning: TurningRange | None = None
        self._physics = physics or Physics()
        self._scene = scene
        self._model: TransitionModel | None = None

    @property
    def scene(self) -> Scene:
        """The scene that is followed."""
        return self._scene

    @property
    def turning(self) -> TurningRange | None:
        """How far wrist 3 can turn on from where it is; None without a limit."""
        return self._turning

    def follow(self, scene: Scene, turning: TurningRange | None = None) -> None:
        """Simulate ``scene`` from now on, with motions within ``turning``. An equal scene costs nothing."""
        self._turning = turning
        if scene is not self._scene and scene != self._scene:
            self._scene = scene
            self._model = None

    @property
    def transition_model(self) -> TransitionModel:
        """The model of the current scene without the constraint; assembled when it is first needed."""
        if self._model is None:
            self._model = TransitionModel(self.scene, self.action_space, self._physics)
        return self._model

    def simulate(self, state: State, action: Action) -> Transition:
        """Execute ``action`` in ``state`` and wait until the world is at rest.

        Raises:
            ActionError: the action is not in the action space.
            SceneError: the numbers of objects in the state and the scene differ.
            SimulationError: the physics diverged, or the arm cannot make this motion.
        """
        fault = self.motion_fault(state, action)
        if fault is not None:
            raise SimulationError(fault)
        return self.transition_model.simulate(state, action)

    def motion_fault(self, state: State, action: Action) -> str | None:
        """Why the arm cannot make the motion of ``action`` in ``state``; None if it can.

        Raises:
            ActionError: the action is not in the action space.
        """
        motion = self.action_space.motion(action)
        if self.reach is not None and not self.reach.allows(state.gripper_pose, motion):
            return _unreachable(state, motion)
        if self.turning is not None and not self.turning.allows(state.gripper_pose, motion):
            return f"wrist 3 cannot turn on by {math.degrees(motion.rotation):.1f} degrees"
        return None

    def is_goal(self, state: State) -> bool:
        """Whether ``state`` is valid and has the desired object in the target region."""
        return self.transition_model.is_goal(state)

    def is_dropped(self, state: State) -> bool:
        """Whether an object's centre is outside the surface edges."""
        return self.transition_model.is_dropped(state)

    def perturbed(self, relative_std: float, turning_std: float, rng: np.random.Generator) -> PerturbedReachableModel:
        """A model with perturbed objects (:func:`visualrhp.scene.noise.perturb`), which follows this one.

        The perturbation is drawn from one seed that is taken from ``rng``, and again from the same for every scene, so
        that an object that is seen again is perturbed alike.
        """
        return PerturbedReachableModel(self, relative_std, turning_std, int(rng.integers(1 << 63)))


class PerturbedReachableModel(ReachableModel):
    """A :class:`ReachableModel` with a perturbed scene, derived anew whenever ``nominal`` follows another scene.

    Args:
        nominal: the model whose scene is perturbed.
        relative_std, turning_std: as of :func:`visualrhp.scene.noise.perturb`.
        seed: of the perturbation.
    """

    def __init__(self, nominal: ReachableModel, relative_std: float, turning_std: float, seed: int) -> None:
        super().__init__(nominal.scene, nominal.action_space, nominal.reach, nominal._physics)
        self._part = float(np.random.default_rng([seed, 1]).uniform())
        self._nominal, self._perturbation, self._seed = nominal, (relative_std, turning_std), seed
        self._perturbed_from: Scene | None = None

    @property
    def turning(self) -> TurningRange | None:
        """As of the nominal model."""
        return self._nominal.turning

    @property
    def scene(self) -> Scene:
        """The perturbed scene."""
        source = self._nominal.scene
        if source is not self._perturbed_from:
            relative_std, turning_std = self._perturbation
            super().follow(perturb(source, relative_std, np.random.default_rng(self._seed), turning_std))
            self._perturbed_from = source
        return self._scene

    def follow(self, scene: Scene, turning: TurningRange | None = None) -> None:
        """Let the nominal model follow ``scene``; this one does so, too."""
        self._nominal.follow(scene, turning)

    def simulate(self, state: State, action: Action) -> Transition:
        """As of the nominal model, but that an object which is pushed into the margin at an edge is dropped."""
        transition = super().simulate(state, action)
        margin = self._part * self._nominal.edge_margin
        if transition.is_dropped or not _nears_edge(self.scene, state, transition.next_state, margin):
            return transition
        return replace(transition, reward=rules.reward(dropped=True), is_goal=False, is_dropped=True)

    @property
    def transition_model(self) -> TransitionModel:
        scene = self.scene
        if self._model is None or self._model.scene is not scene:
            self._model = TransitionModel(scene, self.action_space, self._physics)
        return self._model


def _nears_edge(scene: Scene, before: State, after: State, margin: float) -> bool:
    """Whether an object is closer to the edges than ``margin`` [m], and closer than it was before."""
    if margin <= 0.0:
        return False
    border = shapely.LinearRing(scene.edges)
    first, last = (shapely.distance(border, shapely.points(state.object_positions)) for state in (before, after))
    return bool(((last < margin) & (last < first - _MOVED)).any())


def _unreachable(state: State, motion: GripperMotion) -> str:
    x, y, theta = state.gripper_pose.tolist()
    return (
        f"the arm cannot move the gripper from ({x:.3f} m, {y:.3f} m, {math.degrees(theta):.1f} degrees) by {motion}: "
        "it is outside its reach"
    )
