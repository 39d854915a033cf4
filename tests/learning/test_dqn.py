"""Eq. 7 recomputed by hand, the exploration policy, the replay buffer, and a trivial problem."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.learning.corridor import FEATURES, Corridor, CorridorPlanner, TinyQNetwork, features, success_rate
from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.learning.configs import DQNConfig
from visualrhp.learning.dqn import DQN, EpsilonRHP, demonstration_transitions, make_q_loss
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.streams import Split
from visualrhp.types import Episode, Metrics, Outcome, State

SMALL = DQNConfig(buffer_size=200, frames_per_batch=40, epochs=2, batch_size=16, lr=1e-3)


def demonstrations() -> list:
    task = sample_task_instance(SceneDistribution(num_objects=(2, 2)), 0, Split.DEMONSTRATIONS, 0)
    vectors = [np.r_[0.25 * step, np.zeros(3), step % 2, np.zeros(6)] for step in range(4)]
    states = tuple(State(vector) for vector in vectors)
    return [(task, Episode(states, (0, 6, 7), (-1.0, -1.0, -1.0), Outcome.SUCCESS))]


def make(config: DQNConfig = SMALL, seed: int = 0, shown: int = 1) -> DQN:
    return DQN(
        TinyQNetwork(),
        Corridor("discrete"),
        lambda network: CorridorPlanner(),
        config,
        demonstrations()[:shown],
        seed=seed,
    )


def greedy_success(network: torch.nn.Module) -> dict[str, float]:
    return success_rate("discrete", lambda observation: network(observation, None).argmax(-1))


def without_times(metrics: Metrics) -> Metrics:
    return {name: value for name, value in metrics.items() if not name.endswith("_per_s")}


def batch_of(size: int) -> TensorDict:
    """Random transitions; the first ends in a goal, the second is truncated."""
    generator = torch.Generator().manual_seed(0)
    terminated = torch.arange(size)[:, None] == 0
    following = {
        "observation": torch.randn(size, FEATURES, generator=generator),
        "gripper_closed": torch.zeros(size, dtype=torch.bool),
        "reward": -torch.rand(size, 1, generator=generator),
        "terminated": terminated,
        "done": terminated | (torch.arange(size)[:, None] == 1),
    }
    return TensorDict(
        {
            "observation": torch.randn(size, FEATURES, generator=generator),
            "gripper_closed": torch.zeros(size, dtype=torch.bool),
            "action": torch.randint(8, (size,), generator=generator),
            "next": TensorDict(following, batch_size=[size]),
        },
        batch_size=[size],
    )


def test_loss_is_equation_7_and_its_gradient_holds_the_target_fixed():
    network, batch = TinyQNetwork(), batch_of(6)
    loss = make_q_loss(network, discount=0.9)(batch)["loss"]
    loss.backward()
    gradients = [parameter.grad.clone() for parameter in network.parameters()]
    network.zero_grad()
    expected = torch.zeros(())
    for i in range(6):
        following = batch["next"][i]
        with torch.no_grad():
            best = 0.0 if i == 0 else network(following["observation"][None], None).max().item()
        target = following["reward"].item() + 0.9 * best
        expected = expected + (target - network(batch["observation"][i : i + 1], None)[0, batch["action"][i]]) ** 2 / 6
    assert loss.item() == pytest.approx(expected.item(), rel=1e-5)
    expected.backward()
    for gradient, parameter in zip(gradients, network.parameters(), strict=True):
        torch.testing.assert_close(gradient, parameter.grad, rtol=1e-4, atol=1e-6)


def test_target_network_is_copied_at_the_interval_only():
    learner = make(DQNConfig(buffer_size=200, frames_per_batch=40, batch_size=16, lr=1e-2, target_update_interval=3))
    batch = batch_of(6)
    copies = []
    for _ in range(7):
        learner.optimize(batch)
        target = learner.q_loss.target_value_network_params["module", "0", "module", "layers", "0", "weight"]
        copies.append(torch.equal(target, learner.network.layers[0].weight))
    assert copies == [False, False, True, False, False, True, False]


def test_demonstrations_become_transitions_with_a_terminal_end():
    ((task, episode),) = demonstrations()
    transitions = demonstration_transitions(task, episode, Corridor.observe)
    assert transitions.shape == (3,)
    assert transitions["observation"][:, 0].tolist() == [0.0, 0.25, 0.5]
    assert transitions["next", "observation"][:, 0].tolist() == [0.25, 0.5, 0.75]
    assert transitions["gripper_closed"].tolist() == [False, True, False]
    assert transitions["next", "terminated"][:, 0].tolist() == [False, False, True]
    assert transitions["action"].tolist() == [0, 6, 7]
    learner = make()
    assert len(learner.replay) == 3


@pytest.mark.parametrize(("epsilon", "low", "high"), [(0.0, 1.0, 1.0), (1.0, 0.0, 0.0), (0.2, 0.7, 0.9)])
def test_exploration_plans_with_probability_one_minus_epsilon(epsilon, low, high):
    env, planner = Corridor("discrete", num_envs=10), CorridorPlanner()
    policy = EpsilonRHP(env, planner, epsilon, seed=0)
    env.rollout(30, policy, break_when_any_done=False)
    assert low <= sum(planner.asked) / 300 <= high


def test_exploration_depends_on_the_task_and_the_step_alone():
    actions: dict[tuple[int, int], int] = {}
    for num_envs in (1, 5):
        env = Corridor("discrete", num_envs=num_envs)
        policy = EpsilonRHP(env, CorridorPlanner(), 0.5, seed=3)
        step = env.reset()
        for _ in range(12):
            keys = list(zip(env.instances, env.num_actions, strict=True))
            policy(step)
            for key, action in zip(keys, step["action"].tolist(), strict=True):
                assert actions.setdefault(key, action) == action
            _, step = env.step_and_maybe_reset(step)


@pytest.mark.parametrize("interval", [None, 10])
def test_solves_the_corridor(interval):
    config = DQNConfig(
        buffer_size=2000,
        frames_per_batch=200,
        epochs=10,
        batch_size=100,
        lr=1e-3,
        discount=0.9,
        target_update_interval=interval,
    )
    env = Corridor("discrete")
    learner = DQN(TinyQNetwork(), env, lambda network: CorridorPlanner(), config, [], seed=0, evaluate=greedy_success)
    rows = list(learner.run(20))
    assert rows[0]["greedy/success_rate"] < 1.0
    assert greedy_success(learner.best_network)["success_rate"] == 1.0
    assert greedy_success(learner.network)["success_rate"] == 1.0
    with torch.no_grad():
        best = learner.network(features(torch.tensor([0.0, 0.25, 0.5, 0.75])), torch.zeros(4, dtype=torch.bool)).max(1)[
            0
        ]
    torch.testing.assert_close(best, torch.tensor([-3.439, -2.71, -1.9, -1.0]), atol=0.4, rtol=0.0)


@pytest.mark.parametrize("interval", [None, 3])
@pytest.mark.parametrize("buffer_size", [500, 60])  # holds everything; has wrapped around when it is saved
def test_a_resumed_run_is_the_uninterrupted_one(tmp_path, buffer_size, interval):
    config = DQNConfig(
        buffer_size=buffer_size, frames_per_batch=40, epochs=2, batch_size=16, lr=1e-3, target_update_interval=interval
    )
    whole, first = make(config), make(config)
    rows = list(whole.run(5))
    list(first.run(3))
    first.save(tmp_path / "state.safetensors")
    resumed = make(config)
    resumed.load(tmp_path / "state.safetensors")
    for key in ("observation", "action"):
        assert torch.equal(first.replay[:][key], resumed.replay[:][key])
    assert [without_times(row) for row in resumed.run(5)] == [without_times(row) for row in rows[3:]]
    for name, parameter in whole.network.state_dict().items():
        assert torch.equal(parameter, resumed.network.state_dict()[name])
    with pytest.raises(CheckpointError, match="demonstrat"):
        make(config, shown=0).load(tmp_path / "state.safetensors")


def test_bad_parameters_are_refused():
    with pytest.raises(ConfigError, match="frames_per_batch=41"):
        make(DQNConfig(frames_per_batch=41))
    for parameters in ({"epsilon": 1.5}, {"lr": -1.0}, {"epochs": 0}, {"target_update_interval": 0}):
        (name,) = parameters
        with pytest.raises(ConfigError, match=name):
            DQNConfig(**parameters)
