"""Wrappers of the Gymnasium environment, and its time limit."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import WrapperSpec

from visualrhp.errors import ConfigError
from visualrhp.observation.label_image import IMAGE_SIZE, PALETTE

OWN_TIME_LIMIT = WrapperSpec("OwnTimeLimit", f"{__name__}:own_time_limit", {})
"""For ``additional_wrappers`` of a registration of the environment: see :func:`own_time_limit`."""


def own_time_limit(env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """Let the environment itself keep the limit of ``max_episode_steps``, and remove Gymnasium's wrapper for it.

    The wrapper would say ``truncated`` beside ``terminated`` when the last action reaches the goal, and would let
    actions after the end pass. The specification of the environment keeps the limit, so that
    ``gymnasium.make(env.spec)`` makes the same environment.

    Args:
        env: as ``gymnasium.make`` made it.

    Returns:
        It without its ``TimeLimit``, if it has one outermost.
    """
    spec = env.unwrapped.spec
    if spec is None or not isinstance(env, gymnasium.wrappers.TimeLimit):
        return env
    spec.max_episode_steps = env.get_wrapper_attr("_max_episode_steps")
    spec.additional_wrappers = (OWN_TIME_LIMIT,)
    return env.env


class ColourImage(gymnasium.ObservationWrapper[dict[str, Any], Any, dict[str, Any]]):
    """Label images in the paper's six colours (Sec. 5.1), for libraries that identify images by their shape.

    ``observation`` becomes ``Box(0, 255, [64, 64, 3], uint8)``, RGB; the rest is unchanged. Stable-Baselines3, for
    instance, then uses a convolutional network; it would flatten a label image.

    Args:
        env: environment with ``observation="image"``.

    Raises:
        ConfigError: the environment does not return label images.
    """

    def __init__(self, env: gymnasium.Env[dict[str, Any], Any]) -> None:
        super().__init__(env)
        if not isinstance(env.observation_space, gymnasium.spaces.Dict):
            raise ConfigError("ColourImage wraps visualrhp/ClutterManipulation-v0")
        spaces = env.observation_space.spaces
        labels = spaces.get("observation")
        if labels is None or labels.shape != (IMAGE_SIZE, IMAGE_SIZE) or labels.dtype != np.uint8:
            raise ConfigError("ColourImage converts label images: make the environment with observation='image'")
        colours = gymnasium.spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        self.observation_space = gymnasium.spaces.Dict({**spaces, "observation": colours})

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with colours for labels."""
        return {**observation, "observation": PALETTE.take(observation["observation"], axis=0)}
