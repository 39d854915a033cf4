"""Wrappers of the Gymnasium environment, and its time limit."""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec, register

from visualrhp.environments import ClutterManipulation, ColourImage
from visualrhp.environments.wrappers import own_time_limit
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


OWN, THEIRS, NONE = "visualrhp/ClutterManipulation-v0", "test/Limit-v0", "test/NoLimit-v0"
ENTRY_POINT = f"{ClutterManipulation.__module__}:{ClutterManipulation.__name__}"


@pytest.fixture(scope="module", autouse=True)
def registrations() -> Iterator[None]:
    """One with Gymnasium's wrapper, and one without a limit."""
    register(THEIRS, ENTRY_POINT, max_episode_steps=60)
    register(NONE, ENTRY_POINT)
    yield
    for name in (THEIRS, NONE):
        del gymnasium.registry[name]


def length(env: gymnasium.Env) -> int | None:
    """Actions in which nothing moves until the episode ends; None if that takes more than 150."""
    env.reset(seed=0)
    for count in range(1, 151):
        _, _, terminated, truncated, _ = env.step(7)
        assert not terminated
        if truncated:
            return count
    return None


@pytest.mark.parametrize(
    ("name", "arguments", "expected"),
    [
        (OWN, {}, 49),
        (OWN, {"max_episode_steps": 10}, 10),
        (OWN, {"max_episode_steps": 100}, 100),
        (OWN, {"max_episode_steps": -1}, None),  # Gymnasium's word for no limit
        (THEIRS, {}, 60),
        (THEIRS, {"max_episode_steps": 10}, 10),
        (THEIRS, {"max_episode_steps": 100}, 100),
        (NONE, {}, 49),
        (NONE, {"max_episode_steps": 10}, 10),
    ],
)
def test_max_episode_steps_is_the_length_of_an_episode(name: str, arguments: dict, expected: int | None) -> None:
    env = gymnasium.make(name, action_space="discrete", **arguments)
    assert length(env) == length(env) == expected
    assert length(pickle.loads(pickle.dumps(env))) == expected
    assert env.spec is not None and env.spec.max_episode_steps == (None if name == NONE and not arguments else expected)
    assert length(gymnasium.make(env.spec)) == expected
    assert length(gymnasium.make(EnvSpec.from_json(env.spec.to_json()))) == expected
    envs = gymnasium.make_vec(name, 2, vectorization_mode="sync", action_space="discrete", **arguments)
    envs.reset(seed=0)
    assert [bool(envs.step(np.full(2, 7))[3].any()) for _ in range(12)][9] == (expected == 10)
    envs.close()


def test_the_environment_keeps_the_limit_itself() -> None:
    """The wrapper would say that an episode whose last action reaches the goal was truncated, too."""
    env = gymnasium.make(OWN, num_objects=1, max_episode_steps=3)
    wrappers = itertools.takewhile(lambda each: each is not env.unwrapped, iter_wrappers(env))
    assert not any(isinstance(wrapper, gymnasium.wrappers.TimeLimit) for wrapper in wrappers)
    assert own_time_limit(env) is env
    length_of_episode = length(gymnasium.make(OWN, action_space="discrete", max_episode_steps=3))
    assert length_of_episode == 3
    limited = gymnasium.make(OWN, action_space="discrete", max_episode_steps=3)
    length(limited)
    with pytest.warns(UserWarning, match="after 3 actions"):
        limited.step(7)


def iter_wrappers(env: gymnasium.Env) -> Iterator[gymnasium.Env]:
    """The environment and what it wraps, from outside."""
    while isinstance(env, gymnasium.Wrapper):
        yield env
        env = env.env
    yield env
