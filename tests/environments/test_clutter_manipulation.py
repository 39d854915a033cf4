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
from visualrhp.errors import ActionError, ConfigError, SceneError
from visualrhp.observation.label_image import label_image
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.streams import Split
from visualrhp.types import State

ENVIRONMENT = f"{visualrhp.__name__}/ClutterManipulation-v0"

FAR_OPEN = 7
"""The discrete action that opens the open gripper: nothing moves."""


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
@pytest.mark.parametrize(("observation", "num_objects"), [("image", (1, 7)), ("image", 2), ("cartesian", 3)])
def test_follows_the_gymnasium_api(action_space, observation, num_objects):
    arguments = {"action_space": action_space, "observation": observation, "num_objects": num_objects}
    options = {"object_size": "small", "render_mode": "rgb_array", "disable_env_checker": False}
    made = gymnasium.make(ENVIRONMENT, **arguments, **options)
    check_env(made.unwrapped)
    check_env(ClutterManipulation(**arguments), skip_render_check=True)  # which needs what gymnasium.make adds
    made.reset(seed=0)
    for _ in range(5):  # through the wrappers of gymnasium.make, which check, too
        _, _, terminated, truncated, _ = made.step(made.action_space.sample())
        if terminated or truncated:
            made.reset()
    assert made.render().shape[2] == 3


def test_a_number_of_objects_is_a_pair_of_equal_numbers():
    number, pair = ClutterManipulation(num_objects=3), ClutterManipulation(num_objects=(3, 3))
    number.reset(seed=1), pair.reset(seed=1)
    assert number.scene.num_objects == 3 and number.scene == pair.scene and number.state == pair.state


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


def test_rollouts_are_the_same_bit_exactly():
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
    for num_objects in (0, 2.5, True, (1,), (1, 2, 3), (3, 1), "33"):
        with pytest.raises(ConfigError, match="num_objects"):
            ClutterManipulation(num_objects=num_objects)
    with pytest.raises(ConfigError, match="split"):
        ClutterManipulation(split=77)
    env = ClutterManipulation("discrete")
    with pytest.raises(ActionError, match="reset"):
        env.step(0)
    with pytest.raises(ActionError, match="reset"):
        _ = env.scene
    with pytest.raises(ConfigError, match="colour"):
        env.reset(options={"colour": 3})
    env.reset(seed=0)
    for action in (8, -1, 0.5, [0.0] * 4):
        with pytest.raises(ActionError):
            env.step(action)


def several_steps(env: ClutterManipulation, num_steps: int) -> list[tuple]:
    rng = np.random.default_rng(0)
    steps = []
    for _ in range(num_steps):
        observation, *rest = env.step(rng.uniform(-1.0, 1.0, 4))
        steps.append((observation["observation"].tobytes(), observation["gripper_closed"], rest[:3], env.state))
        if rest[1]:
            break
    return steps


@pytest.mark.parametrize("observation", ["image", "cartesian"])
def test_starts_from_a_given_scene_and_state_bit_exactly(observation):
    original = ClutterManipulation(observation=observation, num_objects=3)
    original.reset(seed=3)
    for _ in range(4):
        original.step(np.array([0.4, 0.1, 0.2, 1.0]))
    scene, state = original.scene, original.state
    given = ClutterManipulation(observation=observation, num_objects=3)
    seen, info = given.reset(seed=8, options={"scene": scene, "state": state})
    assert given.scene is scene and given.state == state
    assert (info["instance"], info["num_actions"]) == (-1, 0)
    assert seen["gripper_closed"] == 1 and seen in given.observation_space
    assert several_steps(given, 10) == several_steps(original, 10)
    given.reset(options={"state": state})  # the same scene again
    assert given.scene is scene and given.state == state
    assert given.reset()[1]["instance"] == 0  # what is given takes no instance off the stream
    assert given.state == sample_task_instance(SceneDistribution((3, 3)), 8, Split.REINFORCEMENT, 0).state


def test_a_given_scene_may_have_any_number_of_objects_where_images_are_shown():
    task = sample_task_instance(SceneDistribution(num_objects=(9, 9)), 0, Split.EVALUATION, 0)
    env = ClutterManipulation(num_objects=1)
    seen, _ = env.reset(options={"scene": task.scene, "state": task.state})
    np.testing.assert_array_equal(seen["observation"], label_image(task.scene, task.state))


def test_a_bad_start_is_refused_before_anything_changes():
    task = sample_task_instance(SceneDistribution(num_objects=(3, 3)), 0, Split.EVALUATION, 0)
    fewer = sample_task_instance(SceneDistribution(num_objects=(2, 2)), 0, Split.EVALUATION, 0)
    stacked = State.create(task.state.gripper_pose, 0.085, False, np.zeros((3, 3)))
    env = ClutterManipulation(observation="cartesian", num_objects=3)
    with pytest.raises(SceneError, match="no running episode"):
        env.reset(options={"state": task.state})
    env.reset(seed=4)
    scene, state = env.scene, env.state
    for message, options in [
        ("without 'state'", {"scene": task.scene}),
        ("not Scene and ndarray", {"scene": task.scene, "state": task.state.vector}),
        ("overlap", {"scene": task.scene, "state": stacked}),
        ("2 objects and the scene 3", {"scene": task.scene, "state": fewer.state}),
        ("of 3 objects", {"scene": fewer.scene, "state": fewer.state}),
    ]:
        with pytest.raises(SceneError, match=message):
            env.reset(seed=5, options=options)
    for message, options in [
        ("either", {"instance": 3, "scene": task.scene, "state": task.state}),
        ("0 or more", {"instance": -1}),
        ("0 or more", {"instance": 1.5}),
    ]:
        with pytest.raises(ConfigError, match=message):
            env.reset(seed=5, options=options)
    assert env.scene is scene and env.state is state
    assert env.reset()[1]["instance"] == 1
    assert env.state == sample_task_instance(SceneDistribution((3, 3)), 4, Split.REINFORCEMENT, 1).state


def test_an_observation_is_not_written_over_by_the_next():
    env = ClutterManipulation()
    first, _ = env.reset(seed=0)
    kept = first["observation"].copy()
    env.step(np.array([0.5, 0.0, 0.5, 0.0]))
    np.testing.assert_array_equal(first["observation"], kept)


def test_renders_a_picture_only_in_a_render_mode():
    env = ClutterManipulation(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[2] == 3
    assert ClutterManipulation().render() is None
