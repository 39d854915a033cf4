"""The Gymnasium environment under other people's libraries: vector environments and Stable-Baselines3 as they come."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import stable_baselines3
import torch
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.torch_layers import NatureCNN

import visualrhp
from visualrhp.environments import ColourImage
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.streams import Split

ENVIRONMENT = f"{visualrhp.__name__}/ClutterManipulation-v0"
OPEN = 7
OBSERVATIONS = [("image", (1, 7)), ("cartesian", 3)]


def make(**arguments):
    return gymnasium.make(ENVIRONMENT, **arguments)


def vector_env(kind: str, observation: str = "image", num_objects=(1, 7)):
    arguments = {"action_space": "discrete", "observation": observation, "num_objects": num_objects}
    if kind in ("sync", "async"):
        return gymnasium.make_vec(ENVIRONMENT, num_envs=3, vectorization_mode=kind, **arguments)
    cls = {"SyncVectorEnv": SyncVectorEnv, "AsyncVectorEnv": AsyncVectorEnv}[kind]
    return cls([lambda: make(**arguments) for _ in range(3)])


@pytest.mark.parametrize("kind", ["SyncVectorEnv", "AsyncVectorEnv", "sync", "async"])
def test_a_seed_gives_every_sub_environment_its_own_tasks_and_the_same_again(kind):
    env = vector_env(kind)
    images = [env.reset(seed=seed)[0]["observation"].copy() for seed in (5, 5, 6)]
    env.close()
    assert images[0].shape == (3, 64, 64)
    np.testing.assert_array_equal(images[0], images[1])
    for first, second in [(0, 1), (0, 2), (1, 2)]:
        assert (images[0][first] != images[0][second]).any()
    np.testing.assert_array_equal(images[2][:2], images[0][1:])  # sub-environment i has the seed s + i
    expected = sample_task_instance(SceneDistribution(), 6, Split.REINFORCEMENT, 0)
    alone = make()
    np.testing.assert_array_equal(alone.reset(seed=6)[0]["observation"], images[0][1])
    assert alone.unwrapped.state == expected.state


@pytest.mark.parametrize("kind", ["SyncVectorEnv", "AsyncVectorEnv"])
@pytest.mark.parametrize(("observation", "num_objects"), OBSERVATIONS)
def test_sub_environments_begin_their_next_tasks_by_themselves(kind, observation, num_objects):
    env = vector_env(kind, observation, num_objects)
    first, _ = env.reset(seed=0)
    first = first["observation"].copy()
    truncated = [env.step(np.full(3, OPEN))[3] for _ in range(49)]
    assert not np.any(truncated[:-1]) and np.all(truncated[-1])
    following, rewards, _, _, info = env.step(np.full(3, OPEN))  # the step that Gymnasium takes to reset
    env.close()
    np.testing.assert_array_equal(info["instance"], [1, 1, 1])
    np.testing.assert_array_equal(rewards, np.zeros(3))
    assert all((following["observation"][i] != first[i]).any() for i in range(3))


PPO = {"n_steps": 64, "batch_size": 32, "n_epochs": 1}
DQN = {"buffer_size": 300, "learning_starts": 50}


@pytest.mark.parametrize(("observation", "num_objects"), OBSERVATIONS)
@pytest.mark.parametrize(
    ("algorithm", "action_space", "arguments"),
    [("PPO", "continuous", PPO), ("PPO", "discrete", PPO), ("DQN", "discrete", DQN)],
)
def test_stable_baselines_trains(algorithm, action_space, arguments, observation, num_objects):
    env = make(action_space=action_space, observation=observation, num_objects=num_objects)
    learner = getattr(stable_baselines3, algorithm)("MultiInputPolicy", env, seed=0, device="cpu", **arguments)
    before = torch.nn.utils.parameters_to_vector(learner.policy.parameters()).detach().clone()
    learner.learn(192)
    after = torch.nn.utils.parameters_to_vector(learner.policy.parameters()).detach()
    assert after.isfinite().all() and (after != before).any()
    action, _ = learner.predict(env.reset(seed=1)[0], deterministic=True)
    assert env.action_space.contains(action if action_space == "continuous" else int(action))


def test_stable_baselines_reads_colour_images_with_a_convolutional_network():
    env = ColourImage(make())
    check_env(env)
    learner = stable_baselines3.PPO("MultiInputPolicy", env, seed=0, device="cpu", **PPO)
    assert isinstance(learner.policy.features_extractor.extractors["observation"], NatureCNN)
    learner.learn(64)


def test_stable_baselines_accepts_features():
    check_env(make(observation="cartesian", num_objects=3).unwrapped)
