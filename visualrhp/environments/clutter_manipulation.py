"""The task as a Gymnasium environment, ``visualrhp/ClutterManipulation-v0``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Literal

import gymnasium
import numpy as np
import numpy.typing as npt

from visualrhp.environments.actions import continuous_action, discrete_action
from visualrhp.environments.arguments import (
    MAX_INDEX,
    checked_name,
    checked_seed,
    checked_split,
    is_integer,
    shown,
)
from visualrhp.errors import ActionError, ConfigError, SceneError
from visualrhp.execution.episode import RunningEpisode
from visualrhp.execution.world import SimulatedWorld
from visualrhp.observation import observation_for
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.scene.start import check_start
from visualrhp.simulation import rules
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace, make_action_space
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.streams import Split
from visualrhp.types import ActionSpaceName, ObjectSize, Outcome, State

RESET_OPTIONS = ("instance", "scene", "state")
"""Options of ``reset``."""

_SEED_BOUND = 2**31


class ClutterManipulation(gymnasium.Env[dict[str, Any], Any]):
    """Move the desired object into the target region without dropping anything off the surface (paper, Sec. 4).

    Observation space, a ``Dict``:

    ================== ============================== =======================================================
    key                space                          meaning
    ================== ============================== =======================================================
    ``observation``    ``Box(0, 5, [64, 64], uint8)`` gripper-centric label image (Sec. 5.1), or
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
    actions without either, or the physics diverged. ``info``: ``is_goal``, ``is_dropped``, ``num_actions``,
    ``instance`` (index of the task). ``max_episode_steps`` of ``gymnasium.make`` or of a registration replaces the 49.

    A step is taken or refused: an action that is refused changes nothing and does not count. An environment can be
    pickled and deep-copied at any time; the copy continues to the bit.

    Task instances are a function of (seed, split, episode): ``reset(seed=s)`` starts instance 0 of seed s, every later
    ``reset()`` the next one; ``reset(options={"instance": k})`` starts instance k. ``reset(options={"scene": scene,
    "state": state})`` starts a user-defined task from exactly that state and does not advance the stream of
    instances; without ``scene``, the scene of the running episode is used.

    Args:
        action_space: ``discrete`` or ``continuous``.
        observation: ``image`` or ``cartesian`` (which needs a fixed number of objects).
        num_objects: objects in a scene, 1 to 7 in the paper: a number, or the fewest and the most.
        object_size: ``small``, ``mixed`` or ``large`` relative to the gripper.
        split: disjoint set of task instances to sample from.
        render_mode: None or ``rgb_array``.

    Raises:
        ConfigError: an argument is unknown or out of range.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012 (as gymnasium has it)

    def __init__(
        self,
        action_space: ActionSpaceName = "continuous",
        observation: str = "image",
        num_objects: int | tuple[int, int] = (1, 7),
        object_size: ObjectSize = "mixed",
        split: Split = Split.REINFORCEMENT,
        render_mode: Literal["rgb_array"] | None = None,
    ) -> None:
        if render_mode is not None and checked_name("render_mode", render_mode) not in self.metadata["render_modes"]:
            raise ConfigError(f"render_mode is {shown(render_mode)}; choose None or rgb_array")
        distribution = SceneDistribution(num_objects=_bounds(num_objects), object_size=object_size)
        self.render_mode = render_mode
        self._observe = observation_for(checked_name("observation", observation), distribution)
        self._split = checked_split(split)
        self._instance_seed: int | None = None
        self._next_index = 0
        self._distribution = distribution
        self._actions = make_action_space(checked_name("action_space", action_space))
        self._is_discrete = self._actions.name == "discrete"
        self._episode: RunningEpisode | None = None
        self._outcome: Outcome | None = None  # of the last action
        self._is_after_end = False
        self._index = -1  # of the task instance; -1 for a user-defined task
        self.action_space = self._action_box()
        self.observation_space = gymnasium.spaces.Dict(
            {"observation": self._observation_box(), "gripper_closed": gymnasium.spaces.Discrete(2)}
        )

    def _action_box(self) -> gymnasium.Space[Any]:
        if self._is_discrete:
            return gymnasium.spaces.Discrete(DiscreteActionSpace.NUM_ACTIONS)
        return gymnasium.spaces.Box(-1.0, 1.0, (ContinuousActionSpace.DIMENSION,), np.float32)

    def _observation_box(self) -> gymnasium.spaces.Box:
        observe = self._observe
        return gymnasium.spaces.Box(observe.low, observe.high, observe.shape, observe.dtype)

    @property
    def scene(self) -> Scene:
        """The scene of the running episode.

        Raises:
            ActionError: before the first ``reset``.
        """
        return self._running().scene

    @property
    def state(self) -> State:
        """The current state.

        Raises:
            ActionError: before the first ``reset``.
        """
        return self._running().state

    @property
    def model(self) -> TransitionModel:
        """The decision process of the running episode, for planners.

        Raises:
            ActionError: before the first ``reset``.
        """
        world = self._running().world
        assert isinstance(world, SimulatedWorld)
        return world.model

    def _running(self) -> RunningEpisode:
        if self._episode is None:
            raise ActionError("no episode is running; call reset first")
        return self._episode

    @cached_property
    def _max_actions(self) -> int | None:
        """Actions after which an episode is truncated; None if only Gymnasium's wrapper limits them.

        A registration with ``max_episode_steps`` puts that wrapper, with a limit that only the wrapper knows, around
        every environment that ``gymnasium.make`` makes.
        """
        if self.spec is None:
            return rules.MAX_EPISODE_ACTIONS
        registered = gymnasium.registry.get(self.spec.id)
        is_left = registered is not None and registered.max_episode_steps is not None
        return self.spec.max_episode_steps or (None if is_left else rules.MAX_EPISODE_ACTIONS)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin the next task instance, or the one chosen by ``seed`` and ``options`` (see the class).

        Raises:
            ConfigError: the seed is not an integer, 0 or more; an option is unknown, or contradicts another. Nothing
                changes on an error.
            SceneError: the scene and the state cannot be simulated, or the observations need another number of objects.
        """
        chosen = self._instance_seed if seed is None else checked_seed(seed)
        options = self._checked_options(options)
        index = self._chosen_index(options)
        given = self._given_task(options)
        if chosen is None:
            chosen = self._instance_seed = int(self.np_random.integers(_SEED_BOUND))
        if index is None:
            index = self._next_index if seed is None else 0
        task = given or sample_task_instance(self._distribution, chosen, self._split, index)
        episode = RunningEpisode(SimulatedWorld(task, TransitionModel(task.scene, self._actions)))
        super().reset(seed=None if seed is None else chosen)
        self._episode, self._outcome, self._is_after_end = episode, None, False
        self._instance_seed = chosen
        if given is None:
            self._index, self._next_index = index, index + 1
        else:
            self._index, self._next_index = -1, 0 if seed is not None else self._next_index
        return self._observation(), self._info()

    def _checked_options(self, options: Any) -> dict[str, Any]:
        if options is None:
            return {}
        if not isinstance(options, Mapping):
            raise ConfigError(f"the options of reset are a dictionary, not {shown(options)}")
        unknown = [option for option in options if option not in RESET_OPTIONS]
        if unknown:
            raise ConfigError(f"reset got the unknown options {shown(unknown)}; choose from {', '.join(RESET_OPTIONS)}")
        return dict(options)

    def _chosen_index(self, options: dict[str, Any]) -> int | None:
        """The index of the task instance in ``options``."""
        index = options.get("instance")
        if index is None:
            return None
        if len(options) > 1:
            raise ConfigError("reset starts either a task instance ('instance') or what is given ('scene', 'state')")
        if not is_integer(index) or not 0 <= index < MAX_INDEX:
            raise ConfigError(f"the option 'instance' is the index of a task instance, 0 or more, not {shown(index)}")
        return int(index)

    def _given_task(self, options: dict[str, Any]) -> TaskInstance | None:
        """The user-defined task in ``options``, validated."""
        scene, state = options.get("scene"), options.get("state")
        if scene is None and state is None:
            return None
        if state is None:
            raise SceneError("reset got the option 'scene' without 'state', the state from which the episode starts")
        if scene is None:
            if self._episode is None:
                raise SceneError(
                    "reset got the option 'state' without 'scene', and there is no running episode's scene"
                )
            scene = self.scene
        if not isinstance(scene, Scene) or not isinstance(state, State):
            raise SceneError(
                "the options 'scene' and 'state' are a visualrhp.scene.Scene and a visualrhp.types.State, not "
                f"{type(scene).__name__} and {type(state).__name__}"
            )
        check_start(scene, state)
        self._observe.check(scene)
        return TaskInstance(scene, state)

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Take ``action`` (see the class). As Gymnasium's environments do, warn once where the episode is over.

        Raises:
            ActionError: the action is not in the action space, or no episode was started. Nothing changes.
        """
        episode = self._running()
        checked = discrete_action(action) if self._is_discrete else continuous_action(action)
        if self._outcome is not None and not self._is_after_end:
            self._is_after_end = True
            gymnasium.logger.warn(
                f"step was called after the end of the episode ({self._outcome.value} after {episode.num_actions} "
                "actions): what follows is no part of the task; call reset to begin another episode"
            )
        episode.act(checked)
        outcome = episode.outcome
        if outcome in (None, Outcome.OUT_OF_ACTIONS):  # the limit may be another than that of the paper
            is_last = self._max_actions is not None and episode.num_actions >= self._max_actions
            outcome = Outcome.OUT_OF_ACTIONS if is_last else None
        self._outcome = outcome
        terminated = outcome is not None and outcome.is_terminal
        truncated = outcome is not None and not outcome.is_terminal
        return self._observation(), episode.reward, terminated, truncated, self._info()

    def _observation(self) -> dict[str, Any]:
        episode = self._running()
        return {
            "observation": self._observe(episode.scene, episode.state),
            "gripper_closed": int(episode.state.gripper_closed),
        }

    def _info(self) -> dict[str, Any]:
        return {
            "is_goal": self._outcome is Outcome.SUCCESS,
            "is_dropped": self._outcome is Outcome.DROPPED,
            "num_actions": self._running().num_actions,
            "instance": self._index,
        }

    def render(self) -> npt.NDArray[np.uint8] | None:  # type: ignore[override]
        """[H, W, 3] uint8 RGB picture of the world, or None without a render mode.

        Raises:
            ActionError: before the first ``reset``, or after ``close``.
        """
        if self.render_mode is None:
            return None
        from visualrhp.rendering.frames import render_frame  # imported only to render

        return render_frame(self.scene, self.state)

    def close(self) -> None:
        """End the episode; ``reset`` begins the next one. Closing twice has no effect."""
        self._episode, self._outcome = None, None


def _bounds(num_objects: Any) -> tuple[int, int]:
    """Fewest and most objects."""
    pair = num_objects if isinstance(num_objects, Sequence) else (num_objects, num_objects)
    if len(pair) != 2 or not all(map(is_integer, pair)):
        raise ConfigError(f"num_objects is a number of objects or a pair (fewest, most), not {shown(num_objects)}")
    return int(pair[0]), int(pair[1])
