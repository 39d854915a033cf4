"""The discrete and the continuous action space (paper, Sec. 7.1)."""

from __future__ import annotations

import math
import reprlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Final, get_args

import numpy as np

from visualrhp.errors import ActionError, ConfigError, SceneError
from visualrhp.scene.contours import numbers
from visualrhp.types import Action, ActionSpaceName

MAX_TRANSLATION: Final = 0.1
"""Largest displacement of a motion along an axis [m]; a faster gripper could pass through thin objects."""

MAX_ROTATION: Final = math.radians(50.0)
"""Largest rotation of a motion [rad]."""


@dataclass(frozen=True, slots=True)
class GripperMotion:
    """The motion that an action commands, in the gripper frame at its start.

    Attributes:
        forward: longitudinal displacement [m].
        left: lateral displacement [m].
        rotation: counter-clockwise [rad].
        closed: commanded gripper state, or None to keep the current one.

    Raises:
        ActionError: a displacement or the rotation is not finite or too large for one action.
    """

    forward: float = 0.0
    left: float = 0.0
    rotation: float = 0.0
    closed: bool | None = None

    def __post_init__(self) -> None:
        try:
            is_possible = (
                abs(self.forward) <= MAX_TRANSLATION
                and abs(self.left) <= MAX_TRANSLATION
                and abs(self.rotation) <= MAX_ROTATION
            )
        except TypeError as error:
            raise ActionError(f"a motion consists of numbers, in metres and radians, not {self!r:.200}") from error
        if not is_possible:
            raise ActionError(
                f"a motion is at most {MAX_TRANSLATION} m along each axis and {MAX_ROTATION:.4f} rad of rotation, not "
                f"{self.forward} m, {self.left} m and {self.rotation} rad; divide it into several motions"
            )


class ActionSpace(ABC):
    """A set of actions and the gripper motions that they command."""

    name: ClassVar[ActionSpaceName]

    @abstractmethod
    def motion(self, action: Action) -> GripperMotion:
        """The motion that ``action`` commands.

        Raises:
            ActionError: the action is not in this space, or not finite.
        """

    @abstractmethod
    def sample(self, rng: np.random.Generator) -> Action:
        """Sample an action uniformly."""

    @abstractmethod
    def mirror(self, action: Action) -> Action:
        """The action with the effect of ``action`` in the mirrored scene (left and right exchanged)."""


class DiscreteActionSpace(ActionSpace):
    """Eight actions: four 5 cm translations along the axes of the gripper frame, two 30 degree rotations, close, open.

    ===== ==========================
    index motion
    ===== ==========================
    0     forward 5 cm
    1     backward 5 cm
    2     left 5 cm
    3     right 5 cm
    4     turn counter-clockwise 30°
    5     turn clockwise 30°
    6     close
    7     open
    ===== ==========================
    """

    name = "discrete"
    NUM_ACTIONS: Final = 8
    TRANSLATION: Final = 0.05
    ROTATION: Final = math.radians(30.0)
    MIRRORED: Final = (0, 1, 3, 2, 5, 4, 6, 7)

    _MOTIONS: Final = (
        GripperMotion(forward=TRANSLATION),
        GripperMotion(forward=-TRANSLATION),
        GripperMotion(left=TRANSLATION),
        GripperMotion(left=-TRANSLATION),
        GripperMotion(rotation=ROTATION),
        GripperMotion(rotation=-ROTATION),
        GripperMotion(closed=True),
        GripperMotion(closed=False),
    )

    def _index(self, action: Action) -> int:
        is_integer = isinstance(action, (int, np.integer)) and not isinstance(action, bool)
        if is_integer and 0 <= action < self.NUM_ACTIONS:
            return int(action)
        raise ActionError(f"a discrete action is an integer from 0 to {self.NUM_ACTIONS - 1}, not {_shown(action)}")

    def motion(self, action: Action) -> GripperMotion:
        return self._MOTIONS[self._index(action)]

    def sample(self, rng: np.random.Generator) -> Action:
        return int(rng.integers(self.NUM_ACTIONS))

    def mirror(self, action: Action) -> Action:
        return self.MIRRORED[self._index(action)]


class ContinuousActionSpace(ActionSpace):
    """Four numbers: longitudinal, lateral, rotation and gripper, each clipped to [-1, 1] for execution.

    ===== ============== ============================
    index component      range of the motion
    ===== ============== ============================
    0     longitudinal   -10 cm to 10 cm (forward)
    1     lateral        -10 cm to 10 cm (left)
    2     rotation       -50° to 50° (counter-clockwise)
    3     gripper        above 0 closes, else opens
    ===== ============== ============================

    The fingers open or close while the gripper moves.
    """

    name = "continuous"
    DIMENSION: Final = 4
    TRANSLATION: Final = MAX_TRANSLATION
    ROTATION: Final = MAX_ROTATION

    def _components(self, action: Action) -> list[float]:
        if not (type(action) is np.ndarray and action.dtype in (np.float64, np.float32)):
            action = self._as_numbers(action)
        values = action.tolist()
        if action.shape != (self.DIMENSION,) or not math.isfinite(sum(values)):
            raise ActionError(self._fault(action))
        return values

    def _as_numbers(self, action: object) -> np.ndarray:
        """What is no array of floats as one; booleans, text, complex numbers and dates are no numbers."""
        try:
            return numbers(action, "")
        except SceneError as error:
            raise ActionError(self._fault(action)) from error

    def _fault(self, action: object) -> str:
        return f"a continuous action is an array of {self.DIMENSION} finite numbers, not {_shown(action)}"

    def motion(self, action: Action) -> GripperMotion:
        forward, left, rotation, gripper = [min(max(value, -1.0), 1.0) for value in self._components(action)]
        return GripperMotion(
            self.TRANSLATION * forward, self.TRANSLATION * left, self.ROTATION * rotation, closed=gripper > 0.0
        )

    def sample(self, rng: np.random.Generator) -> Action:
        return rng.uniform(-1.0, 1.0, self.DIMENSION)

    def mirror(self, action: Action) -> Action:
        return np.array(self._components(action)) * (1.0, -1.0, -1.0, 1.0)


def _shown(action: object) -> str:
    return f"{action!r:.200}" if isinstance(action, np.ndarray | np.generic) else reprlib.repr(action)


_ACTION_SPACES: dict[str, type[ActionSpace]] = {
    space.name: space for space in (DiscreteActionSpace, ContinuousActionSpace)
}


def make_action_space(name: ActionSpaceName) -> ActionSpace:
    """Return the action space called ``name``.

    Raises:
        ConfigError: the name is unknown.
    """
    if not isinstance(name, str) or name not in _ACTION_SPACES:
        raise ConfigError(f"action_space={name!r:.60}: choose one of {', '.join(get_args(ActionSpaceName))}")
    return _ACTION_SPACES[name]()
