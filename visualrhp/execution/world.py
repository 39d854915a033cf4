"""Worlds that can be observed and acted on: a simulation, or a robot that cannot be set to a state (Sec. 3)."""

from __future__ import annotations

from typing import Protocol

from visualrhp.scene.noise import perturb
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import Action, State


class World(Protocol):
    """The world in which an episode runs."""

    def observe(self) -> tuple[Scene, State]:
        """Observe the current scene and state, at rest.

        Raises:
            CellFault, PerceptionError: a robot cell cannot be observed; the robot is at rest.
        """
        ...

    def act(self, action: Action) -> None:
        """Execute ``action`` and wait until the world is at rest.

        Raises:
            ActionError: the action is not in the action space; nothing has moved.
            SimulationError: the physics diverged; the state is unchanged.
            UnreachableError: the arm of a robot cannot make the motion; nothing has moved.
            CellFault, PerceptionError: a robot was brought to rest, or has not moved.
        """
        ...

    def close(self) -> None:
        """Release the resources of the world; closing twice has no effect."""
        ...


class SimulatedWorld(World):
    """A task instance in the physics simulator.

    Args:
        instance: the observed scene, and the initial state.
        model: simulates the world. Its scene is the true one, which differs from the observed one if there is noise
            (Sec. 8.2).

    Attributes:
        model: as given.
    """

    def __init__(self, instance: TaskInstance, model: TransitionModel) -> None:
        self.model = model
        self._scene, self._state = instance.scene, instance.state

    def observe(self) -> tuple[Scene, State]:
        return self._scene, self._state

    def act(self, action: Action) -> None:
        self._state = self.model.advance(self._state, action)

    def close(self) -> None:
        pass


def simulated_task(
    instance: TaskInstance,
    seed: int,
    split: Split,
    index: int,
    *,
    action_space: ActionSpace,
    physics: Physics | None = None,
    noise: float = 0.0,
) -> tuple[SimulatedWorld, TransitionModel]:
    """Make the world of task instance ``index`` at a level of ``noise``, and the planner's model of it (Sec. 8.2).

    The noise is a relative standard deviation of the shape, friction and density of the world's objects; the model
    keeps the nominal values. All levels scale the same random numbers, so results at different levels are comparable.
    Without noise the model is exact.
    """
    model = truth = TransitionModel(instance.scene, action_space, physics)
    if noise != 0.0:
        scene = perturb(instance.scene, noise, generator_for(seed, split, index, Stream.NOISE))
        truth = TransitionModel(scene, action_space, physics)
    return SimulatedWorld(instance, truth), model
