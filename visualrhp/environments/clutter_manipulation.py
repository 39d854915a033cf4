"""The task as a Gymnasium environment, ``visualrhp/ClutterManipulation-v0``."""

from __future__ import annotations

from typing import Any, Literal

import gymnasium
import numpy as np
import numpy.typing as npt

from visualrhp.environments.task import NUM_LABELS, ClutterTask, ObservationFunction, ObservationName, Outcome
from visualrhp.errors import ActionError, ConfigError
from visualrhp.rendering.label_image import IMAGE_SIZE
from visualrhp.scene.sampling import SceneDistribution, Split
from visualrhp.scene.scene import Scene
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace, make_action_space
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import Action, ActionSpaceName, ObjectSize, State

_SEED_BOUND = 2**31
_FEATURE_BOUND = 100.0
"""No feature gets this large: 49 actions move the gripper by 7 m, which is 28 in units of the features."""


class ClutterManipulation(gymnasium.Env[dict[str, Any], Any]):
    """Move the desired object into the target region without dropping anything off the surface (paper, Sec. 4).

    Observation space, a ``Dict``:

    ================== ============================== =======================================================
    key                space                          meaning
    ================== ============================== =======================================================
    ``observation``    ``Box(0, 5, [64, 64], uint8)`` robot-centric label image (Sec. 5.1), or
                       ``Box(.., [4 m + 6], float32)`` Cartesian features (Sec. 7.5)
    ``gripper_closed`` ``Discrete(2)``                1: the gripper was last commanded to close
    ================== ============================== =======================================================

    Action space:

    ============ ====================== =======================================================================
    name         space                  meaning
    ============ ====================== =======================================================================
    discrete     ``Discrete(8)``        forward, backward, left, right (5 cm), turn left, right (30 deg), close, open
    continuous   ``Box(-1, 1, [4])``    forward, left (x 10 cm), rotation (x 50 deg), gripper (above 0 closes)
    ============ ====================== =======================================================================

    Reward: -1 per action, -50 when an object is dropped (Sec. 7). ``terminated``: goal or drop. ``truncated``: 49
    actions without either. ``info``: ``is_goal``, ``is_dropped``, ``num_actions``, ``instance`` (index of the task).

    Task instances are a function of (seed, split, episode): ``reset(seed=s)`` starts instance 0 of seed s, every later
    ``reset()`` the next one; ``reset(options={"instance": k})`` starts instance k.

    Args:
        action_space: ``discrete`` or ``continuous``.
        observation: ``image`` or ``cartesian`` (which needs a fixed number of objects).
        num_objects: fewest and most objects in a scene, 1 to 7 in the paper.
        object_size: ``small``, ``mixed`` or ``large`` relative to the gripper.
        split: which of the disjoint streams of task instances to draw from.
        render_mode: None or ``rgb_array``.

    Raises:
        ConfigError: an argument is unknown or out of range.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012 (as gymnasium has it)

    def __init__(
        self,
        action_space: ActionSpaceName = "continuous",
        observation: ObservationName = "image",
        num_objects: tuple[int, int] = (1, 7),
        object_size: ObjectSize = "mixed",
        split: Split = Split.REINFORCEMENT,
        render_mode: Literal["rgb_array"] | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode is {render_mode!r}; choose None or rgb_array")
        distribution = SceneDistribution(num_objects=(num_objects[0], num_objects[1]), object_size=object_size)
        self.render_mode = render_mode
        self._observe = ObservationFunction.for_distribution(observation, distribution)
        self._split = Split(split)
        self._instance_seed: int | None = None
        self._next_index = 0
        self._actions = make_action_space(action_space)
        self._task = ClutterTask(distribution, self._actions)
        self.action_space = self._action_box()
        self.observation_space = gymnasium.spaces.Dict(
            {"observation": self._observation_box(), "gripper_closed": gymnasium.spaces.Discrete(2)}
        )

    def _action_box(self) -> gymnasium.Space[Any]:
        if self._actions.name == "discrete":
            return gymnasium.spaces.Discrete(DiscreteActionSpace.NUM_ACTIONS)
        return gymnasium.spaces.Box(-1.0, 1.0, (ContinuousActionSpace.DIMENSION,), np.float32)

    def _observation_box(self) -> gymnasium.spaces.Box:
        if self._observe.name == "image":
            return gymnasium.spaces.Box(0, NUM_LABELS - 1, (IMAGE_SIZE, IMAGE_SIZE), np.uint8)
        return gymnasium.spaces.Box(-_FEATURE_BOUND, _FEATURE_BOUND, self._observe.shape, np.float32)

    @property
    def scene(self) -> Scene:
        """The scene of the running episode (after ``reset``)."""
        return self._task.instance.scene

    @property
    def state(self) -> State:
        """The current state (after ``reset``)."""
        return self._task.state

    @property
    def model(self) -> TransitionModel:
        """The decision process of the running episode, for planners (after ``reset``)."""
        return self._task.model

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin the next task instance, or the one chosen by ``seed`` and ``options`` (see the class)."""
        super().reset(seed=seed)
        unknown = set(options or {}) - {"instance"}
        if unknown:
            raise ConfigError(f"reset got the unknown options {sorted(unknown)}; only 'instance' is known")
        if seed is not None:
            self._instance_seed, self._next_index = seed, 0
        elif self._instance_seed is None:
            self._instance_seed = int(self.np_random.integers(_SEED_BOUND))
        if options:
            self._next_index = int(options["instance"])
        self._task.start(self._instance_seed, self._split, self._next_index)
        self._next_index += 1
        return self._observation(), self._info(is_goal=False, is_dropped=False)

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Take ``action`` (see the class).

        Raises:
            ActionError: the action is not in the action space, or the episode has not been started.
        """
        if self._task.index < 0:
            raise ActionError("step was called before reset; call reset first")
        outcome: Outcome = self._task.act(self._action(action))
        info = self._info(is_goal=outcome.is_goal, is_dropped=outcome.is_dropped)
        return self._observation(), outcome.reward, outcome.terminated, outcome.truncated, info

    def _action(self, action: npt.ArrayLike) -> Action:
        if self._actions.name == "discrete":
            return np.asarray(action).item()  # a fraction stays one, and is refused by the action space
        return np.asarray(action, dtype=np.float64)

    def _observation(self) -> dict[str, Any]:
        state = self._task.state
        return {
            "observation": np.array(self._observe(self._task.instance.scene, state), dtype=self._observe.dtype),
            "gripper_closed": int(state.gripper_closed),
        }

    def _info(self, *, is_goal: bool, is_dropped: bool) -> dict[str, Any]:
        return {
            "is_goal": is_goal,
            "is_dropped": is_dropped,
            "num_actions": self._task.num_actions,
            "instance": self._task.index,
        }

    def render(self) -> npt.NDArray[np.uint8] | None:  # type: ignore[override]
        """[H, W, 3] uint8 RGB picture of the world, or None without a render mode."""
        if self.render_mode is None:
            return None
        from visualrhp.rendering.frames import render_frame  # drawing is imported only by who draws

        return render_frame(self.scene, self.state)
