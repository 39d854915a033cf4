"""The decision process of one scene: transition function, reward and terminal states (paper, Sec. 4)."""

from __future__ import annotations

from visualrhp.scene.scene import Scene
from visualrhp.simulation import task
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.simulator import Simulator
from visualrhp.types import Action, State, Transition


class TransitionModel:
    """T and r of Sec. 4 for one scene: a function of (state, action), exact to the bit, whatever was simulated before.

    Attributes:
        scene: the scene simulated.
        action_space: translates actions into gripper motions.
    """

    def __init__(self, scene: Scene, action_space: ActionSpace, physics: Physics | None = None) -> None:
        self.scene = scene
        self.action_space = action_space
        self._simulator = Simulator(scene, physics or Physics())

    def simulate(self, state: State, action: Action) -> Transition:
        """Execute ``action`` in ``state`` and wait until the world is at rest.

        Raises:
            ActionError: the action is not of this model's space.
            SceneError: the state has another number of objects than the scene.
            SimulationError: the physics diverged.
        """
        next_state = self._simulator.advance(state, self.action_space.motion(action))
        dropped = self.is_dropped(next_state)
        return Transition(
            state=state,
            action=action,
            reward=task.reward(dropped),
            next_state=next_state,
            is_goal=not dropped and self.is_goal(next_state),
            is_dropped=dropped,
        )

    def is_goal(self, state: State) -> bool:
        """Whether the desired object is in the target region."""
        return task.is_goal(self.scene, state)

    def is_dropped(self, state: State) -> bool:
        """Whether an object's centre is outside the surface edges."""
        return task.is_dropped(self.scene, state)
