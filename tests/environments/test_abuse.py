"""Both environments under abuse: what is refused by a named error, what is warned of, and what may be copied."""

from __future__ import annotations

import copy
import itertools
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from tests.environments.rollouts import FEW, random_policy, run
from visualrhp.environments import ClutterManipulation
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.errors import ActionError, ConfigError
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.streams import Split
from visualrhp.types import State

ENVIRONMENT = "visualrhp/ClutterManipulation-v0"
OPEN = 7
"""The discrete action that opens the open gripper: nothing moves."""

# The Gymnasium environment


def trace(env: gymnasium.Env, num_steps: int, action_space_seed: int = 5) -> list[Any]:
    """What some steps return, to the bit."""
    rng = np.random.default_rng(action_space_seed)
    found: list[Any] = []
    for _ in range(num_steps):
        action = int(rng.integers(8)) if env.action_space.shape == () else rng.uniform(-1.0, 1.0, 4)
        observation, *rest = env.step(action)
        found.append((observation["observation"].tobytes(), observation["gripper_closed"], *rest))
        if rest[1] or rest[2]:
            observation, info = env.reset()
            found.append((observation["observation"].tobytes(), info))
    return found


COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda thing: pickle.loads(pickle.dumps(thing))}


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
@pytest.mark.parametrize("made", [True, False], ids=["make", "class"])
def test_a_copied_environment_continues_to_the_bit(copied: Any, action_space: Any, made: bool) -> None:
    env: Any = gymnasium.make(ENVIRONMENT, action_space=action_space) if made else ClutterManipulation(action_space)
    fresh = copied(env)
    assert fresh.reset(seed=4)[0]["observation"].tobytes() == env.reset(seed=4)[0]["observation"].tobytes()
    trace(env, 7)
    twin = copied(env)
    assert twin.unwrapped.state == env.unwrapped.state and twin.unwrapped.scene == env.unwrapped.scene
    assert not twin.unwrapped.state.vector.flags.writeable
    assert twin.unwrapped.scene is twin.unwrapped.model.scene
    expected = trace(env, 60)
    assert trace(twin, 60) == expected  # and neither moves the other
    assert twin.unwrapped.state == env.unwrapped.state


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_a_copied_model_simulates_to_the_bit(copied: Any) -> None:
    env = ClutterManipulation(num_objects=5)
    env.reset(seed=2)
    state, model = env.state, env.model
    twin = copied(model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        action = rng.uniform(-1.0, 1.0, 4)
        found, expected = (each.simulate(state, action) for each in (twin, model))
        assert found.next_state == expected.next_state and found.reward == expected.reward
        state = expected.next_state
    with pytest.raises(TypeError, match="copy or pickle the Simulator"):
        copied(model.simulator.world)


def test_an_environment_without_a_seed_is_copied_with_its_random_numbers() -> None:
    env = ClutterManipulation()
    env.reset()
    twin = copy.deepcopy(env)
    env.reset(), twin.reset()
    assert env.state == twin.state


def test_a_refused_action_changes_nothing_and_does_not_count() -> None:
    for space, wrong in [
        ("discrete", [True, 3.0, "3", None, 8]),
        ("continuous", ["1000", [True] * 4, [[1], [2, 3]], 1j]),
    ]:
        env = gymnasium.make(ENVIRONMENT, action_space=space)
        good = OPEN if space == "discrete" else np.zeros(4, np.float32)
        env.reset(seed=0)
        for count, action in zip(range(1, 50), itertools.cycle(wrong)):
            state = env.unwrapped.state
            with pytest.raises(ActionError, match="action is an"):
                env.step(action)
            assert env.unwrapped.state is state
            *_, truncated, info = env.step(good)
            assert info["num_actions"] == count and truncated == (count == 49)


def test_actions_with_gradients_are_those_without() -> None:
    env, other = ClutterManipulation(), ClutterManipulation()
    env.reset(seed=0), other.reset(seed=0)
    env.step(torch.tensor([0.5, 0.0, 0.25, 1.0], requires_grad=True))
    other.step(np.array([0.5, 0.0, 0.25, 1.0]))
    assert env.state == other.state


@pytest.mark.parametrize("made", [True, False], ids=["make", "class"])
def test_a_step_after_the_end_is_warned_of_once(made: bool) -> None:
    env: Any = gymnasium.make(ENVIRONMENT, action_space="discrete") if made else ClutterManipulation("discrete")
    for _ in range(2):
        env.reset(seed=0)
        for _ in range(49):
            env.step(OPEN)
        with pytest.raises(ActionError):
            env.step(99)
        with pytest.warns(UserWarning, match=r"after the end of the episode \(out of actions after 49 actions\)"):
            *_, truncated, _ = env.step(OPEN)
        assert truncated
        env.step(OPEN)


def test_a_task_may_begin_at_its_goal() -> None:
    env = ClutterManipulation("discrete", num_objects=1)
    env.reset(seed=0)
    scene, state = env.scene, env.state
    at_goal = State.create(state.gripper_pose, state.gripper_opening, False, [[*scene.target.position, 0.0]])
    env.reset(options={"scene": scene, "state": at_goal})
    *_, terminated, truncated, info = env.step(OPEN)
    assert terminated and info["is_goal"] and not truncated


def test_close_ends_the_episode_until_the_next_reset() -> None:
    env = ClutterManipulation("discrete", render_mode="rgb_array")
    env.close()
    env.reset(seed=3)
    env.close(), env.close()
    for use in (lambda: env.step(OPEN), lambda: env.state, lambda: env.scene, lambda: env.model, env.render):
        with pytest.raises(ActionError, match="call reset first"):
            use()
    assert env.reset()[1]["instance"] == 1
    env.step(OPEN)


@pytest.mark.parametrize("seed", [-1, 1.5, True, "3", [1], np.timedelta64(3, "s")], ids=repr)
def test_a_bad_seed_is_refused_before_anything_changes(seed: Any) -> None:
    env = ClutterManipulation(num_objects=2)
    env.reset(seed=4)
    state = env.state
    with pytest.raises(ConfigError, match="seed"):
        env.reset(seed=seed)
    assert env.state is state and env.reset()[1]["instance"] == 1
    assert env.state == sample_task_instance(SceneDistribution((2, 2)), 4, Split.REINFORCEMENT, 1).state


def test_seeds_of_any_size_and_of_numpy() -> None:
    env, other = ClutterManipulation(), ClutterManipulation()
    env.reset(seed=np.int64(3)), other.reset(seed=3)
    assert env.state == other.state
    env.reset(seed=2**100)
    assert env.state != other.state


@pytest.mark.parametrize(
    "options",
    [
        "abc",
        [1],
        3,
        {1: 2, "b": 3},
        {"x" * 10_000: 1},
        {"instance": True},
        {"instance": "3"},
        {"instance": 2**63},
        {"instance": [3]},
        {"instance": np.timedelta64(1, "s")},
    ],
    ids=lambda options: str(options)[:30],
)
def test_bad_options_are_config_errors(options: Any) -> None:
    env = ClutterManipulation()
    env.reset(seed=1)
    with pytest.raises(ConfigError) as caught:
        env.reset(seed=2, options=options)
    assert len(str(caught.value)) < 300 and env.reset()[1]["instance"] == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("action_space", ["discrete"]),
        ("action_space", None),
        ("observation", ["image"]),
        ("observation", 3),
        ("render_mode", 3),
        ("render_mode", ["rgb_array"]),
        ("object_size", ["small"]),
        ("object_size", 3),
        ("split", True),
        ("split", [1]),
        ("num_objects", [3] * 10_000),
        ("num_objects", {}),
        ("num_objects", np.array([1, 3])),
    ],
    ids=lambda value: str(value)[:20],
)
def test_bad_arguments_are_config_errors(name: str, value: Any) -> None:
    with pytest.raises(ConfigError, match=name) as caught:
        ClutterManipulation(**{name: value})
    assert len(str(caught.value)) < 300


# The batched environment


def test_a_refused_action_moves_no_slot_whatever_it_is():
    """A number that the action space cannot add up was refused only after the slots before it had moved."""
    env = BatchedClutterEnv(FEW, "continuous", num_envs=2)
    env.reset()
    states = env.states
    for last in (torch.nan, -torch.inf):
        actions = torch.tensor([[0.5, 0.0, 0.0, 1.0], [1e308, 1e308, 1e308, last]], dtype=torch.float64)
        with pytest.raises(ActionError, match="slot 1"):
            env.step(TensorDict({"action": actions}, [2]))
    with pytest.raises(ActionError, match=r"tensor of \[2, 4\] numbers, not of \[2, 1\]"):
        env.step(TensorDict({"action": torch.full((2, 1), 0.5)}, [2]))
    with pytest.raises(ActionError, match="no entry 'action'"):
        env.step(TensorDict({}, [2]))
    with pytest.raises(ConfigError, match=r"batch size \[2\] of the environment, not \[3\]"):
        env.step(TensorDict({"action": torch.zeros(3, 4)}, [3]))
    assert env.states == states and env.num_actions == [0, 0]
    large = torch.tensor([[0.5, 0.0, 0.0, 1.0], [1e308, 1e308, -1e308, 1e308]], dtype=torch.float64)
    env.step(TensorDict({"action": large}, [2]))
    other = BatchedClutterEnv(FEW, "continuous", num_envs=2)
    other.reset()
    other.step(TensorDict({"action": large.clamp(-1.0, 1.0)}, [2]))
    assert env.states == other.states and env.num_actions == [1, 1]


@pytest.mark.parametrize("action", [1.99, 3.0])
def test_a_discrete_action_is_an_integer(action):
    env = BatchedClutterEnv(FEW, "discrete", num_envs=2)
    env.reset()
    with pytest.raises(ActionError, match=r"\[2\] integers, not of \[2\] torch.float32"):
        env.step(TensorDict({"action": torch.full((2,), action)}, [2]))


def test_reset_with_a_seed_sets_the_seed():
    def instances(env):
        return env.states, env.instances

    env, other = (BatchedClutterEnv(FEW, "discrete", num_envs=3, seed=seed) for seed in (0, 3))
    other.reset()
    env.reset()
    env.reset(seed=np.int64(3))
    assert instances(env) == instances(other)
    env.set_seed(0), env.reset(seed=3)
    assert instances(env) == instances(other)
    assert env.reset(seed=0)["instance"].tolist() == [0, 1, 2] and env.states != other.states
    env.reset(TensorDict({"_reset": torch.tensor([True, False, False])}, [3]), seed=3)
    assert env.states[0] == other.states[0] and env.states[1] != other.states[1]
    for arguments in ({"seed": -1}, {"seed": 1.5}, {"seed": True}, {"nonsense": 1}, {"seed": 3, "options": {}}):
        with pytest.raises(ConfigError):
            env.reset(**arguments)
    for seed in (-1, "3", 0.5):
        with pytest.raises(ConfigError, match="seed"):
            env.set_seed(seed)
    for mask in (torch.ones(3), torch.ones(3, 4, dtype=torch.bool)):
        with pytest.raises(ConfigError, match="3 booleans"):
            env.reset(TensorDict({"_reset": mask}, [3]))
    assert env.states[0] == other.states[0]


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_actions_with_gradients_are_executed(action_space):
    env, other = (BatchedClutterEnv(FEW, action_space, num_envs=2) for _ in range(2))
    network = torch.nn.Linear(5 + 3 * 3, 4)

    def policy(td):
        scores = network(td["state"].float())
        return td.set("action", scores if action_space == "continuous" else scores.argmax(-1))

    found = env.rollout(5, policy)
    assert found["action"].requires_grad == (action_space == "continuous")
    assert torch.equal(found["next", "state"], other.rollout(5, lambda td: policy(td).detach())["next", "state"])


def test_tensors_are_on_the_device_of_the_environment(monkeypatch):
    """The device without data, meta, stands for an accelerator; torchrl cannot reset on it."""
    env, other = (BatchedClutterEnv(FEW, "discrete", num_envs=2) for _ in range(2))
    env.reset(), other.reset()
    assert env.to("cpu") is env and env.cpu() is env and env.to("meta") is env
    seen = env.current()
    assert {tensor.device.type for tensor in seen.values()} == {"meta"} and seen.device.type == "meta"
    assert {spec.device.type for spec in env.observation_spec.values()} == {"meta"}
    with pytest.raises(ActionError, match="tensor of"):  # it has no data
        env.step(env.rand_action(seen))
    actions = torch.tensor([0, 4])
    monkeypatch.setattr(torch.Tensor, "cpu", lambda tensor: actions if tensor.is_meta else tensor)
    following = env.step(env.rand_action(seen))["next"]
    assert {tensor.device.type for tensor in following.values()} == {"meta"} and env.num_actions == [1, 1]
    assert {tensor.device.type for tensor in env.snapshot().values()} == {"cpu"}
    other.step(other.current().set("action", actions))
    assert env.states == other.states
    assert env.cpu().current()["state"].equal(other.current()["state"])


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_device_that_is_not_here_is_refused():
    env = BatchedClutterEnv(FEW, "discrete", num_envs=2)
    for move in (lambda: env.to("cuda"), lambda: env.to("cuda:1"), env.cuda, lambda: env.cuda(1)):
        with pytest.raises(ConfigError, match=r"cuda.* cannot be used"):
            move()
    assert env.device == torch.device("cpu")
    env.reset()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_an_environment_on_a_cuda_device_is_the_same(action_space):
    env, other = (BatchedClutterEnv(FEW, action_space, num_envs=3) for _ in range(2))
    check_env_specs(env.to("cuda"))
    env.set_seed(0)
    (found, _), (expected, _) = (run(each, random_policy(0, each), 60) for each in (env, other))
    assert found["next", "state"].is_cuda and (found.cpu() == expected).all()


def test_a_step_after_the_end_is_said_once():
    env = BatchedClutterEnv(FEW, "discrete", num_envs=3)
    env.reset()
    opening = TensorDict({"action": torch.full((3,), OPEN)}, [3])
    for _ in range(49):
        env.step(opening.clone())
    with pytest.warns(UserWarning, match=r"after the end of the episodes in the slots \[1\]"):
        env.step(opening.clone().set("_step", torch.tensor([False, True, False])))
    with pytest.warns(UserWarning, match=r"slots \[0, 2\]"):
        env.step(opening.clone())
    env.step(opening.clone())
    env.reset()
    env.step(opening.clone())


@pytest.mark.parametrize("num_workers", [0, 1])
def test_a_distribution_that_cannot_be_drawn_leaves_nothing_behind(num_workers):
    env = BatchedClutterEnv(SceneDistribution(target_radius=0.66), "discrete", num_envs=2, num_workers=num_workers)
    with pytest.raises(ConfigError, match="target_radius"):
        env.reset()
    with pytest.raises(ActionError, match="call reset first"):
        env.step(TensorDict({"action": torch.zeros(2, dtype=torch.int64)}, [2]))
