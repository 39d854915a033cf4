"""One task being solved: the state machine under the Gymnasium and the torchrl environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from visualrhp.errors import ConfigError, SimulationError
from visualrhp.rendering.cartesian import cartesian_dimension, cartesian_features
from visualrhp.rendering.label_image import IMAGE_SIZE, Label, label_image
from visualrhp.scene.sampling import SceneDistribution, Split, sample_task_instance
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.task import ACTION_REWARD, MAX_EPISODE_ACTIONS
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import Action, State

ObservationName = Literal["image", "cartesian"]

NUM_LABELS = len(Label)


@dataclass(frozen=True)
class ObservationFunction:
    """What an agent sees of a state: the label image (Sec. 5.1) or the Cartesian features (Sec. 7.5).

    Attributes:
        name: ``image`` or ``cartesian``.
        num_objects: objects m in every scene (``cartesian`` only, whose length is fixed by m).

    Raises:
        ConfigError: unknown name, or ``cartesian`` without ``num_objects``.
    """

    name: ObservationName
    num_objects: int | None = None

    def __post_init__(self) -> None:
        if self.name not in ("image", "cartesian"):
            raise ConfigError(f"observation is {self.name!r}; choose image or cartesian")
        if self.name == "cartesian" and self.num_objects is None:
            raise ConfigError(
                "Cartesian observations have a fixed number of objects (paper, Sec. 7.5): give scenes of one density, "
                "for instance num_objects=4"
            )

    @classmethod
    def for_distribution(cls, name: ObservationName, distribution: SceneDistribution) -> ObservationFunction:
        """The observation of scenes drawn from ``distribution``."""
        fewest, most = distribution.num_objects
        return cls(name, fewest if name == "cartesian" and fewest == most else None)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one observation: [64, 64] or [4 m + 6]."""
        if self.num_objects is None or self.name == "image":
            return (IMAGE_SIZE, IMAGE_SIZE)
        return (cartesian_dimension(self.num_objects),)

    @property
    def dtype(self) -> type[np.uint8 | np.float32]:
        """uint8 labels or float32 features."""
        return np.uint8 if self.name == "image" else np.float32

    def __call__(self, scene: Scene, state: State) -> npt.NDArray[np.uint8] | npt.NDArray[np.float32]:
        """The observation of ``state``, an array of :attr:`shape` and :attr:`dtype`."""
        return label_image(scene, state) if self.name == "image" else cartesian_features(scene, state)


class Outcome(NamedTuple):
    """What one action led to; ``terminated`` is a goal or a drop, ``truncated`` the action limit."""

    reward: float
    terminated: bool
    truncated: bool
    is_goal: bool
    is_dropped: bool


class ClutterTask:
    """A task instance and how far its solution has come.

    An episode ends with the goal or a drop (``terminated``) or after 49 actions (``truncated``: success must come in
    under 50 actions, Sec. 7.3). If the physics diverges the state stays what it was and the episode is truncated.

    Attributes:
        instance: scene and initial state.
        index: index of the instance in its stream, or -1.
        model: the decision process of the scene.
        state: current state.
        num_actions: actions taken so far.
    """

    def __init__(
        self, distribution: SceneDistribution, action_space: ActionSpace, physics: Physics | None = None
    ) -> None:
        self._distribution = distribution
        self._action_space = action_space
        self._physics = physics or Physics()
        self.index = -1
        self.num_actions = 0
        self.instance: TaskInstance
        self.model: TransitionModel
        self.state: State

    def start(self, seed: int, split: Split, index: int) -> None:
        """Begin task instance (seed, split, index)."""
        self.begin(sample_task_instance(self._distribution, seed, split, index), index)

    def begin(self, instance: TaskInstance, index: int = -1) -> None:
        """Begin ``instance``, which has the index -1 if it is from no stream."""
        self.index = index
        self.instance = instance
        self.model = TransitionModel(instance.scene, self._action_space, self._physics)
        self.state = instance.state
        self.num_actions = 0

    def resume(self, num_actions: int, state: State) -> None:
        """Go on with the started task instance from ``state``, reached by ``num_actions`` actions."""
        self.state = state
        self.num_actions = num_actions

    def act(self, action: Action) -> Outcome:
        """Take one action.

        Raises:
            ActionError: the action is not in the action space.
        """
        self.num_actions += 1
        at_limit = self.num_actions >= MAX_EPISODE_ACTIONS
        try:
            transition = self.model.simulate(self.state, action)
        except SimulationError:
            return Outcome(ACTION_REWARD, terminated=False, truncated=True, is_goal=False, is_dropped=False)
        self.state = transition.next_state
        is_goal, is_dropped = transition.is_goal, transition.is_dropped
        terminated = is_goal or is_dropped
        return Outcome(transition.reward, terminated, at_limit and not terminated, is_goal, is_dropped)
