"""Wrappers of the Gymnasium environment."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from visualrhp.environments import ColourImage
from visualrhp.errors import ConfigError
from visualrhp.observation.label_image import PALETTE, label_image

ENVIRONMENT = "visualrhp/ClutterManipulation-v0"


def test_colours_label_images():
    env = ColourImage(gymnasium.make(ENVIRONMENT, action_space="discrete"))
    seen, _ = env.reset(seed=0)
    for _ in range(3):
        labels = label_image(env.unwrapped.scene, env.unwrapped.state)
        assert seen in env.observation_space
        for label, colour in enumerate(PALETTE):
            assert (seen["observation"][labels == label] == colour).all()
        seen, *_ = env.step(env.action_space.sample())
    with pytest.raises(ConfigError, match="image"):
        ColourImage(gymnasium.make(ENVIRONMENT, observation="cartesian", num_objects=2))


def test_only_the_image_of_an_observation_changes():
    plain, coloured = gymnasium.make(ENVIRONMENT), ColourImage(gymnasium.make(ENVIRONMENT))
    before, after = plain.reset(seed=3)[0], coloured.reset(seed=3)[0]
    assert before["gripper_closed"] == after["gripper_closed"]
    assert after["observation"].shape == (64, 64, 3) and after["observation"].dtype == np.uint8
    assert coloured.observation_space["gripper_closed"] == plain.observation_space["gripper_closed"]


def test_environments_without_label_images_are_refused():
    with pytest.raises(ConfigError, match="ColourImage wraps visualrhp/ClutterManipulation-v0"):
        ColourImage(gymnasium.make("CartPole-v1"))


@pytest.mark.parametrize(
    "spaces",
    [
        {"other": gymnasium.spaces.Box(0, 5, (64, 64), np.uint8)},
        {"observation": gymnasium.spaces.Box(0, 5, (64, 64), np.float32)},
        {"observation": gymnasium.spaces.Box(0, 5, (32, 32), np.uint8)},
    ],
    ids=["no observation", "floats", "smaller"],
)
def test_what_only_resembles_label_images_is_refused(spaces: dict[str, gymnasium.Space]) -> None:
    env = gymnasium.Env()
    env.observation_space = gymnasium.spaces.Dict(spaces)
    with pytest.raises(ConfigError, match="observation='image'"):
        ColourImage(env)
