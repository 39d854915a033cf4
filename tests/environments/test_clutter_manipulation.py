"""The Gymnasium environment: its contract, determinism, and that it is the transition model underneath."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import visualrhp
from visualrhp.environments import ClutterManipulation
from visualrhp.errors import ActionError, ConfigError
from visualrhp.rendering.label_image import label_image
from visualrhp.scene.sampling import SceneDistribution, Split, sample_task_instance

FAR_OPEN = 7
"""The discrete action that opens the open gripper: nothing moves."""


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
@pytest.mark.parametrize(("observation", "num_objects"), [("image", (1, 7)), ("cartesian", (3, 3))])
def test_follows_the_gymnasium_api(action_space, observation, num_objects):
    env = gymnasium.make(
        f"{visualrhp.__name__}/ClutterManipulation-v0",
        action_space=action_space,
        observation=observation,
        num_objects=num_objects,
    )
    check_env(env.unwrapped, skip_render_check=True)


def test_import_of_the_package_stays_light():
    heavy = ("torch", "torchrl", "pymunk", "cv2", "shapely")
    code = f"import sys, visualrhp; print([name for name in {heavy} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_task_instances_are_a_function_of_seed_and_episode():
    env = ClutterManipulation(num_objects=(2, 4), object_size="small")
    distribution = SceneDistribution(num_objects=(2, 4), object_size="small")
    for index, arguments in enumerate([{"seed": 5}, {}, {}]):
        observation, info = env.reset(**arguments)
        expected = sample_task_instance(distribution, 5, Split.REINFORCEMENT, index)
        assert env.state == expected.state and info["instance"] == index
        np.testing.assert_array_equal(observation["observation"], label_image(expected.scene, expected.state))
    assert env.reset(options={"instance": 1})[1]["instance"] == 1
    assert env.state == sample_task_instance(distribution, 5, Split.REINFORCEMENT, 1).state


def test_rollouts_are_the_same_to_the_bit():
    def rollout():
        env = ClutterManipulation()
        env.action_space.seed(3)
        observation, info = env.reset(seed=7)
        steps = [(observation["observation"].tobytes(), info)]
        for _ in range(30):
            observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
            steps.append((observation["observation"].tobytes(), reward, terminated, truncated, info))
            if terminated or truncated:
                env.reset()
        return steps

    assert rollout() == rollout()


def test_a_step_is_a_transition_of_the_model():
    env = ClutterManipulation("continuous")
    env.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(10):
        action = rng.uniform(-1.5, 1.5, 4)
        expected = env.model.simulate(env.state, action)
        observation, reward, terminated, truncated, info = env.step(action)
        assert env.state == expected.next_state and reward == expected.reward
        assert (terminated, info["is_goal"]) == (expected.is_terminal, expected.is_goal) and not truncated
        assert observation["gripper_closed"] == (action[3] > 0.0)
        if terminated:
            env.reset()


def test_an_episode_is_truncated_after_49_actions():
    env = ClutterManipulation("discrete")
    env.reset(seed=0)
    flags = [env.step(FAR_OPEN)[2:4] for _ in range(49)]
    assert flags == [(False, False)] * 48 + [(False, True)]


def test_bad_arguments_and_actions_are_refused():
    with pytest.raises(ConfigError, match="Cartesian"):
        ClutterManipulation(observation="cartesian")
    with pytest.raises(ConfigError, match="sonar"):
        ClutterManipulation(observation="sonar")
    with pytest.raises(ConfigError, match="human"):
        ClutterManipulation(render_mode="human")
    env = ClutterManipulation("discrete")
    with pytest.raises(ActionError, match="reset"):
        env.step(0)
    with pytest.raises(ConfigError, match="colour"):
        env.reset(options={"colour": 3})
    env.reset(seed=0)
    for action in (8, -1, 0.5, [0.0] * 4):
        with pytest.raises((ActionError, ValueError)):
            env.step(action)


def test_renders_a_picture_only_when_asked():
    env = ClutterManipulation(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[2] == 3
    assert ClutterManipulation().render() is None
