"""N tasks in one torchrl environment: specs, which tasks, partial resets, and that each slot is an environment."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.envs.utils import check_env_specs
from torchrl.objectives.value import GAE

from tests.environments.rollouts import FEW, random_policy, run
from visualrhp.environments import ClutterManipulation
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.errors import ActionError, CheckpointError, ConfigError
from visualrhp.learning.c3po import C3PO
from visualrhp.learning.configs import C3POConfig
from visualrhp.learning.dqn import make_q_loss
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.streams import Split

OPEN = 7


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


def test_seeded_rollouts_are_the_same_bit_exactly():
    first, second, other = (
        run(env, random_policy(0, env), 40)[0]
        for env in (BatchedClutterEnv(FEW, "continuous", num_envs=3, seed=seed) for seed in (1, 1, 2))
    )
    assert (first == second).all()
    assert not torch.equal(first["state"], other["state"])


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_resumes_from_a_snapshot_bit_exactly(action_space):
    env = BatchedClutterEnv(FEW, action_space, num_envs=3, seed=1)
    _, current = run(env, random_policy(0, env), 35)
    snapshot = {name: tensor.clone() for name, tensor in env.snapshot().items()}
    expected, _ = run(env, random_policy(5, env), 40, current)
    restored = BatchedClutterEnv(FEW, action_space, num_envs=3, seed=1)
    current = restored.restore(snapshot)
    assert all(torch.equal(tensor, snapshot[name]) for name, tensor in restored.snapshot().items())
    found, _ = run(restored, random_policy(5, restored), 40, current)
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
    for number in (0, -1, 2.0, True, "3", None, 10**9):
        with pytest.raises(ConfigError, match="num_envs"):
            BatchedClutterEnv(FEW, "discrete", num_envs=number)
    for name, value in [
        ("num_workers", 1.5),
        ("seed", -1),
        ("seed", "0"),
        ("split", 77),
        ("physics", {}),
        ("observation", ["image"]),
        ("observation", "sonar"),
        ("action_space", ["discrete"]),
        ("action_space", "binary"),
        ("distribution", {"num_objects": 3}),
        ("distribution", None),
    ]:
        with pytest.raises(ConfigError, match=name):
            BatchedClutterEnv(**{"distribution": FEW, "action_space": "discrete", name: value})
    with pytest.raises(ConfigError, match="num_workers"):
        BatchedClutterEnv(FEW, "discrete", num_workers=-1)
    with pytest.raises(ActionError, match="reset"):
        _ = BatchedClutterEnv(FEW, "discrete").states
    with pytest.raises(ConfigError, match="Cartesian"):
        BatchedClutterEnv(FEW, "discrete", "cartesian")


@pytest.mark.parametrize(("action_space", "action"), [("discrete", 8), ("continuous", float("nan"))])
def test_a_bad_action_is_refused_before_any_slot_moves(action_space, action):
    env = BatchedClutterEnv(FEW, action_space, num_envs=2)
    current = random_policy(0, env)(env.reset())
    states = env.states
    current["action"][1] = action
    with pytest.raises(ActionError):
        env.step(current)
    assert env.states == states and env.num_actions == [0, 0]


def test_slots_that_are_left_out_of_a_step_stay_where_they_are():
    env = BatchedClutterEnv(FEW, "continuous", num_envs=3)
    current = random_policy(0, env)(env.reset())
    states = env.states
    following = env.step(current.set("_step", torch.tensor([True, False, True])))["next"]
    assert env.num_actions == [1, 0, 1]
    assert [state == before for state, before in zip(env.states, states, strict=True)] == [False, True, False]
    assert following["reward"].flatten().tolist() == [-1.0, 0.0, -1.0]
    assert torch.equal(following["observation"][1], current["observation"][1])


def test_a_pickled_environment_resumes_bit_exactly():
    env = BatchedClutterEnv(FEW, "continuous", num_envs=2, seed=1)
    fresh = pickle.loads(pickle.dumps(env))
    assert torch.equal(fresh.reset()["state"], env.reset()["state"])
    _, current = run(env, random_policy(0, env), 5)
    copied = pickle.loads(pickle.dumps(env))
    expected, _ = run(env, random_policy(1, env), 50, current.clone())
    found, _ = run(copied, random_policy(1, copied), 50, current.clone())
    assert (expected == found).all()


# What reaches the losses

VALUE = 10.0
"""What the networks below say of every state, so that a target tells whether it bootstrapped."""

GAMMA = 0.9


class SameValue(torch.nn.Module):
    """The same output for every state; a parameter, because losses want one."""

    def __init__(self, *shape: int) -> None:
        super().__init__()
        self.output = torch.nn.Parameter(torch.full(shape, VALUE))

    def forward(self, observation, gripper_closed):
        return self.output.expand(*gripper_closed.shape, *self.output.shape)


class SamePolicy(torch.nn.Module):
    """A standard normal distribution everywhere, and the same value."""

    def __init__(self) -> None:
        super().__init__()
        self.output = torch.nn.Parameter(torch.tensor(VALUE))

    def forward(self, observation, gripper_closed):
        rows = gripper_closed.shape
        return torch.zeros(*rows, 4) + 0.0 * self.output, torch.ones(*rows, 4), self.output.expand(rows)


@pytest.fixture(scope="module", params=["discrete", "continuous"])
def episodes(request):
    """[N, T] with goals or drops, with truncations, and with neither at the end."""
    env = BatchedClutterEnv(FEW, request.param, num_envs=6)
    act = random_policy(3, env)

    forward, idle = (0, OPEN) if request.param == "discrete" else (torch.eye(4)[0], torch.zeros(4))

    def some_do_nothing_and_some_push(td):
        """The first never end by themselves, the last sweep the surface until something drops."""
        act(td)["action"][:2] = torch.as_tensor(idle)
        td["action"][4:] = torch.as_tensor(forward)
        return td

    steps, _ = run(env, some_do_nothing_and_some_push, 60)
    ends = steps["next"]
    assert ends["terminated"].any() and ends["truncated"].any() and not ends["done"][:, -1].all()
    return steps


def test_flags_say_how_an_episode_ended_and_the_next_row_begins_another(episodes):
    ends = episodes["next"]
    assert torch.equal(ends["done"], ends["terminated"] | ends["truncated"])
    assert not (ends["terminated"] & ends["truncated"]).any()
    assert torch.equal(ends["terminated"].squeeze(-1), ends["is_goal"] | ends["is_dropped"])
    assert torch.equal(ends["reward"] == -50.0, ends["is_dropped"].unsqueeze(-1))
    assert not episodes["done"].any()
    over = ends["done"][:, :-1, 0]
    changed = (ends["state"][:, :-1] != episodes["state"][:, 1:]).any(-1)
    assert torch.equal(changed, over)  # s' of an episode's last action is its own, not the next one's start
    assert torch.equal(episodes["instance"][:, 1:] - ends["instance"][:, :-1], 6 * over.long())


def targets(episodes):
    """r + gamma v(s'), without the second term after the goal or a drop: computed from the rewards and flags alone."""
    ends = episodes["next"]
    over = (ends["is_goal"] | ends["is_dropped"]).unsqueeze(-1)
    return ends["reward"] + GAMMA * VALUE * ~over


@pytest.mark.parametrize("decay", [0.0, 0.8])
def test_gae_bootstraps_after_a_truncation_and_not_after_a_terminal_state(episodes, decay):
    critic = TensorDictModule(SameValue(1), ["observation", "gripper_closed"], ["state_value"])
    found = GAE(gamma=GAMMA, lmbda=decay, value_network=critic, average_gae=False)(episodes.clone())["advantage"]
    surprise = targets(episodes) - VALUE
    expected = torch.zeros_like(surprise)
    following = torch.zeros(len(surprise), 1)
    for step in reversed(range(surprise.shape[1])):  # nothing of an episode enters the one before it
        over = episodes["next", "done"][:, step]
        expected[:, step] = following = surprise[:, step] + GAMMA * decay * following * ~over
    torch.testing.assert_close(found, expected)


def test_c3po_bootstraps_after_a_truncation_and_not_after_a_terminal_state(episodes):
    env = BatchedClutterEnv(FEW, "continuous", num_envs=6)
    learner = C3PO(SamePolicy(), env, C3POConfig(frames_per_batch=360, batch_size=90, discount=GAMMA), seed=0)
    episodes = episodes.clone().set("action", torch.zeros(*episodes.shape, 4))
    found = learner.with_old_parameters(episodes)["value_target"]
    torch.testing.assert_close(found, targets(episodes).flatten(0, 1))


def test_dqn_bootstraps_after_a_truncation_and_not_after_a_terminal_state(episodes):
    loss = make_q_loss(SameValue(8), GAMMA)
    for step in episodes.clone().set("action", torch.zeros(episodes.shape, dtype=torch.int64)).flatten(0, 1).split(1):
        expected = (targets(step) - VALUE).square().mean()
        torch.testing.assert_close(loss(step)["loss"].detach(), expected)
