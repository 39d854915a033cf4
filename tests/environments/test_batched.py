"""N tasks in one torchrl environment: specs, which tasks, partial resets, and that each slot is an environment."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from visualrhp.environments import ClutterManipulation
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.scene.sampling import SceneDistribution, Split, sample_task_instance

FEW = SceneDistribution(num_objects=(1, 3))
OPEN = 7


def random_policy(seed: int, env: BatchedClutterEnv):
    generator = torch.Generator().manual_seed(seed)

    def act(td):
        if env.action_space.name == "discrete":
            return td.set("action", torch.randint(8, (env.num_envs,), generator=generator))
        return td.set("action", torch.empty(env.num_envs, 4).uniform_(-1.5, 1.5, generator=generator))

    return act


def run(env: BatchedClutterEnv, act, num_steps: int, current: TensorDict | None = None):
    current = env.reset() if current is None else current
    steps = []
    for _ in range(num_steps):
        step, current = env.step_and_maybe_reset(act(current))
        steps.append(step)
    return torch.stack(steps, 1), current


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
@pytest.mark.parametrize(("observation", "num_objects"), [("image", (1, 7)), ("cartesian", (3, 3))])
def test_specs_describe_the_data(action_space, observation, num_objects):
    env = BatchedClutterEnv(SceneDistribution(num_objects=num_objects), action_space, observation, num_envs=3)
    check_env_specs(env, break_when_any_done="both")


def test_slots_draw_every_nth_instance_whenever_they_are_reset():
    env = BatchedClutterEnv(FEW, "discrete", num_envs=3, seed=4)
    env.reset()
    assert env.instances == [0, 1, 2]
    env.reset(TensorDict({"_reset": torch.tensor([[False], [True], [False]])}, batch_size=[3]))
    env.reset(TensorDict({"_reset": torch.tensor([[True], [True], [False]])}, batch_size=[3]))
    assert env.instances == [3, 7, 2]
    for index, state in zip(env.instances, env.states, strict=True):
        assert state == sample_task_instance(FEW, 4, Split.REINFORCEMENT, index).state


def test_a_partial_reset_leaves_the_other_slots_alone():
    env = BatchedClutterEnv(FEW, "continuous", num_envs=2)
    _, current = run(env, random_policy(0, env), 3)
    states = env.states
    seen = current["observation"][1].clone()
    after = env.reset(current.set("_reset", torch.tensor([[True], [False]])))
    assert env.states[1] == states[1] and env.states[0] != states[0]
    assert env.num_actions[0] == 0 and env.num_actions[1] > 0
    assert torch.equal(after["observation"][1], seen)


def test_a_slot_is_the_gymnasium_environment():
    env = BatchedClutterEnv(FEW, "continuous", num_envs=2, seed=9)
    single = ClutterManipulation("continuous", num_objects=(1, 3))
    steps, _ = run(env, random_policy(1, env), 60)
    assert steps["next", "done"].any()
    for slot in range(2):
        single.reset(seed=9)
        observation, _ = single.reset(options={"instance": slot})
        for step in steps[slot].unbind(0):
            assert np.array_equal(step["observation"].numpy(), observation["observation"])
            observation, reward, terminated, truncated, info = single.step(step["action"].numpy())
            following = step["next"]
            assert np.array_equal(following["observation"].numpy(), observation["observation"])
            assert following["gripper_closed"].item() == observation["gripper_closed"]
            assert following["state"].numpy().tobytes().startswith(single.state.vector.tobytes())
            found = (following[key].item() for key in ("reward", "terminated", "truncated", "is_goal", "is_dropped"))
            assert tuple(found) == (reward, terminated, truncated, info["is_goal"], info["is_dropped"])
            if terminated or truncated:
                observation, _ = single.reset(options={"instance": info["instance"] + 2})


def test_truncation_is_not_termination():
    env = BatchedClutterEnv(FEW, "discrete", num_envs=2)
    steps, current = run(env, lambda td: td.set("action", torch.full((2,), OPEN)), 49)
    assert steps["next", "truncated"][:, -1].all() and not steps["next", "truncated"][:, :-1].any()
    assert not steps["next", "terminated"].any() and steps["next", "done"][:, -1].all()
    assert (steps["next", "reward"] == -1.0).all()
    assert env.instances == [2, 3] and not current["done"].any()


def test_seeded_rollouts_are_the_same_to_the_bit():
    first, second, other = (
        run(env, random_policy(0, env), 40)[0]
        for env in (BatchedClutterEnv(FEW, "continuous", num_envs=3, seed=seed) for seed in (1, 1, 2))
    )
    assert (first == second).all()
    assert not torch.equal(first["state"], other["state"])


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_goes_on_from_a_snapshot_to_the_bit(action_space):
    env = BatchedClutterEnv(FEW, action_space, num_envs=3, seed=1)
    _, current = run(env, random_policy(0, env), 35)
    snapshot = {name: tensor.clone() for name, tensor in env.snapshot().items()}
    expected, _ = run(env, random_policy(5, env), 40, current)
    restored = BatchedClutterEnv(FEW, action_space, num_envs=3, seed=1)
    found, _ = run(restored, random_policy(5, restored), 40, restored.restore(snapshot))
    assert (expected == found).all()
    with pytest.raises(CheckpointError, match="another number"):
        BatchedClutterEnv(FEW, action_space, num_envs=2).restore(snapshot)


def test_recalls_what_was_seen():
    env = BatchedClutterEnv(FEW, "continuous", num_envs=2)
    steps = run(env, random_policy(0, env), 20)[0].flatten(0, 1)
    recalled = env.recall(steps["instance"], steps["state"])
    assert torch.equal(recalled["observation"], steps["observation"])
    assert torch.equal(recalled["gripper_closed"], steps["gripper_closed"])


def test_bad_arguments_are_refused():
    with pytest.raises(ConfigError, match="num_envs"):
        BatchedClutterEnv(FEW, "discrete", num_envs=0)
    with pytest.raises(ConfigError, match="Cartesian"):
        BatchedClutterEnv(FEW, "discrete", "cartesian")
