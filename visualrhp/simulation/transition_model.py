"""The decision process of one scene: transition function, reward and terminal states (paper, Sec. 4)."""

from __future__ import annotations

import numpy as np

from visualrhp.scene.noise import perturb
from visualrhp.scene.scene import Scene
from visualrhp.simulation import rules
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.simulator import Simulator
from visualrhp.types import Action, State, Transition


class TransitionModel:
    """T and r of Sec. 4 for one scene: a bit-exact function of (state, action), independent of earlier simulations.

    Attributes:
        scene: the simulated scene.
        action_space: translates actions into gripper motions.
    """

    def __init__(self, scene: Scene, action_space: ActionSpace, physics: Physics | None = None) -> None:
        self.scene = scene
        self.action_space = action_space
        self.simulator = Simulator(scene, physics or Physics())

    def simulate(self, state: State, action: Action) -> Transition:
        """Execute ``action`` in ``state`` and wait until the world is at rest.

        Raises:
            ActionError: the action is not in the action space of this model.
            SceneError: the numbers of objects in the state and the scene differ.
            SimulationError: the physics diverged.
        """
        next_state = self.advance(state, action)
        dropped = self.is_dropped(next_state)
        return Transition(
            state=state,
            action=action,
            reward=rules.reward(dropped),
            next_state=next_state,
            is_goal=not dropped and rules.is_goal(self.scene, next_state),
            is_dropped=dropped,
        )

    def perturbed(self, relative_std: float, turning_std: float, rng: np.random.Generator) -> TransitionModel:
        """A model with perturbed objects (:func:`visualrhp.scene.noise.perturb`)."""
        scene = perturb(self.scene, relative_std, rng, turning_std)
        return TransitionModel(scene, self.action_space, self.simulator.physics)

    def advance(self, state: State, action: Action) -> State:
        """Return only the next state; errors as :meth:`simulate`."""
        return self.simulator.advance(state, self.action_space.motion(action))

    def is_goal(self, state: State) -> bool:
        """Whether ``state`` is valid and has the desired object in the target region."""
        return rules.is_goal(self.scene, state) and not self.is_dropped(state)

    def is_dropped(self, state: State) -> bool:
        """Whether an object's centre is outside the surface edges."""
        return rules.is_dropped(self.scene, state)
