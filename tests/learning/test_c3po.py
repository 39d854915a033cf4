"""Eq. 8, 9 and 10 recomputed by hand, Alg. 2, and a trivial problem."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.learning.corridor import Corridor, TinyActorCritic, success_rate
from visualrhp.errors import ConfigError
from visualrhp.learning.c3po import C3PO, baseline_loss, policy_distribution
from visualrhp.learning.configs import C3POConfig
from visualrhp.types import Metrics

SMALL = C3POConfig(frames_per_batch=80, batch_size=32, baseline_epochs=2, policy_epochs=2, lr=1e-3)


def make(config: C3POConfig = SMALL, seed: int = 0) -> C3PO:
    return C3PO(TinyActorCritic(), Corridor("continuous"), config, seed=seed)


def greedy_success(network: torch.nn.Module) -> dict[str, float]:
    return success_rate("continuous", lambda observation: network(observation, None)[0])


def log_density(action: np.ndarray, mean: np.ndarray, std: np.ndarray) -> np.ndarray:
    return (-((action - mean) ** 2) / (2 * std**2) - np.log(std) - 0.5 * np.log(2 * np.pi)).sum(-1)


def without_times(metrics: Metrics) -> Metrics:
    return {name: value for name, value in metrics.items() if not name.endswith("_per_s")}


def test_log_probability_of_a_sample_outside_the_action_range_is_that_of_the_sample():
    mean, std, action = np.zeros((1, 4)), np.full((1, 4), 0.5), np.array([[1.5, -2.0, 0.0, 0.3]])
    found = policy_distribution(torch.tensor(mean), torch.tensor(std)).log_prob(torch.tensor(action))
    assert found.item() == pytest.approx(log_density(action, mean, std).item())


def test_baseline_loss_is_equation_10():
    rng = np.random.default_rng(0)
    mean, old_mean = rng.normal(size=(2, 5, 4))
    std, old_std = rng.uniform(0.1, 1.0, size=(2, 5, 4))
    value, target = rng.normal(size=(2, 5, 1))
    divergence = (np.log(std / old_std) + (old_std**2 + (old_mean - mean) ** 2) / (2 * std**2) - 0.5).sum(-1)
    outputs = TensorDict({"loc": mean, "scale": std, "state_value": value}, batch_size=[5])
    batch = TensorDict({"old_loc": old_mean, "old_scale": old_std, "value_target": target}, batch_size=[5])
    losses = baseline_loss(outputs, batch, baseline_value_coefficient=0.35)
    assert losses["loss_value"].item() == pytest.approx(0.35 * ((target - value) ** 2).mean())
    assert losses["loss_kl"].item() == pytest.approx(divergence.mean())


@torch.no_grad()
def test_targets_and_advantages_are_equation_9_and_only_terminal_states_do_not_bootstrap():
    learner = make()
    transitions, _ = learner.collector.collect(learner.act, 80)
    data = learner.with_old_parameters(transitions)
    following = transitions["next"].flatten(0, 1)
    value = learner.network(transitions["observation"].flatten(0, 1), None)[2]
    next_value = learner.network(following["observation"], None)[2]
    worth = torch.where(following["terminated"][:, 0], 0.0, next_value)
    target = following["reward"][:, 0] + 0.995 * worth
    assert following["terminated"].any() and following["truncated"].any()
    torch.testing.assert_close(data["value_target"][:, 0], target)
    torch.testing.assert_close(data["advantage"][:, 0], target - value)


@torch.no_grad()
def test_lambda_one_gives_the_discounted_rest_of_the_episode():
    learner = make(C3POConfig(frames_per_batch=80, batch_size=32, gae_lambda=1.0))
    transitions, _ = learner.collector.collect(learner.act, 80)
    target = learner.with_old_parameters(transitions)["value_target"].unflatten(0, transitions.shape)
    for slot in range(4):
        rest = None
        for step in reversed(range(20)):
            following = transitions["next"][slot, step]
            if following["terminated"]:
                rest = torch.zeros(())
            elif following["done"] or rest is None:
                rest = learner.network(following["observation"][None], None)[2][0]
            rest = following["reward"][0] + 0.995 * rest
            torch.testing.assert_close(target[slot, step, 0], rest)


def test_actor_critic_loss_is_equation_8_with_the_ratio_clipped():
    learner = make()
    transitions, _ = learner.collector.collect(learner.act, 80)
    data = learner.with_old_parameters(transitions)
    with torch.no_grad():
        for parameter in learner.network.parameters():
            parameter.add_(0.05)
        mean, std, value = (column.numpy() for column in learner.network(data["observation"], None))
    losses = learner.policy_loss(data)
    columns = ("action", "old_loc", "old_scale", "advantage", "value_target")
    action, old_mean, old_std, advantage, target = (data[key].squeeze(-1).numpy() for key in columns)
    ratio = np.exp(log_density(action, mean, std) - log_density(action, old_mean, old_std))
    assert (np.abs(ratio - 1.0) > 0.075).any() and (np.abs(ratio - 1.0) < 0.075).any()
    objective = -np.minimum(ratio * advantage, ratio.clip(1 - 0.075, 1 + 0.075) * advantage).mean()
    entropy = (0.5 * np.log(2 * np.pi * np.e * std**2)).sum(-1).mean()
    assert losses["loss_objective"].item() == pytest.approx(objective, rel=1e-4)
    assert losses["loss_critic"].item() == pytest.approx(0.7 * ((target - value) ** 2).mean(), rel=1e-4)
    assert losses["loss_entropy"].item() == pytest.approx(-0.1 * entropy, rel=1e-4)


def test_ratio_is_one_before_the_first_step_also_after_the_baseline_step():
    learner = make()
    transitions, _ = learner.collector.collect(learner.act, 80)
    learner.optimize_baseline(learner.with_old_parameters(transitions))
    losses = learner.policy_loss(learner.with_old_parameters(transitions))
    assert losses["max_ratio"].item() == pytest.approx(1.0, abs=1e-5)
    assert losses["mean_ratio"].item() == pytest.approx(1.0, abs=1e-5)
    assert losses["clip_fraction"].item() == 0.0


@torch.no_grad()
def test_body_is_passed_once_per_loss():
    learner = make()
    transitions, _ = learner.collector.collect(learner.act, 80)
    data = learner.with_old_parameters(transitions)
    passes = []
    learner.network.register_forward_hook(lambda *_: passes.append(1))
    learner.policy_loss(data)
    assert len(passes) == 1


def test_baseline_step_improves_the_value_and_leaves_the_policy():
    learner = make(C3POConfig(frames_per_batch=400, batch_size=100, baseline_epochs=30, lr=1e-3))
    transitions, _ = learner.collector.collect(learner.act, 400)
    data = learner.with_old_parameters(transitions)
    before = (data["value_target"] - data["old_value"]).square().mean().item()
    with torch.enable_grad():
        metrics = learner.optimize_baseline(data)
    with torch.no_grad():
        mean, std, value = learner.network(data["observation"], None)
    after = (data["value_target"][:, 0] - value).square().mean().item()
    assert after < 0.85 * before  # what remains is the chance of falling off
    assert metrics["baseline/kl"] < 0.01
    torch.testing.assert_close(mean, data["old_loc"], atol=0.05, rtol=0.0)
    torch.testing.assert_close(std, data["old_scale"], atol=0.05, rtol=0.0)


def test_without_the_baseline_step_it_is_ppo():
    learner = make(C3POConfig(frames_per_batch=80, batch_size=32, policy_epochs=1, baseline_step=False))
    (metrics,) = learner.run(1)
    assert not any(name.startswith("baseline/") for name in metrics)
    assert {"policy/entropy", "policy/kl", "policy/clip_fraction", "value/td_rmse"} <= metrics.keys()


@pytest.mark.parametrize("baseline_step", [True, False])
def test_solves_the_corridor(baseline_step):
    config = C3POConfig(
        frames_per_batch=400,
        batch_size=100,
        baseline_epochs=5,
        policy_epochs=5,
        baseline_step=baseline_step,
        lr=2e-3,
        clip_epsilon=0.2,
        entropy_coefficient=0.01,
    )
    learner = make(config)
    assert greedy_success(learner.network)["success_rate"] < 1.0
    rows = list(learner.run(12))
    assert greedy_success(learner.network)["success_rate"] == 1.0
    assert rows[-1]["collection/success_rate"] > 0.9 > rows[0]["collection/success_rate"]


def test_same_seed_same_bits_and_a_resumed_run_is_the_uninterrupted_one(tmp_path):
    whole, first, other = make(), make(), make(seed=1)
    rows = list(whole.run(4))
    list(other.run(1))
    assert [without_times(row) for row in first.run(2)] == [without_times(row) for row in rows[:2]]
    first.save(tmp_path / "state.safetensors")
    resumed = make(seed=5)
    resumed.load(tmp_path / "state.safetensors")
    assert [without_times(row) for row in resumed.run(4)] == [without_times(row) for row in rows[2:]]
    for name, parameter in whole.network.state_dict().items():
        assert torch.equal(parameter, resumed.network.state_dict()[name])
        assert name.endswith("bias") or not torch.equal(parameter, other.network.state_dict()[name])


def test_bad_parameters_are_refused():
    with pytest.raises(ConfigError, match="frames_per_batch=81"):
        make(C3POConfig(frames_per_batch=81, batch_size=10))
    for parameters in ({"lr": 0.0}, {"discount": 1.1}, {"policy_epochs": 0}, {"batch_size": 20_000}):
        (name,) = parameters
        with pytest.raises(ConfigError, match=name):
            C3POConfig(**parameters)


def test_gradient_norm_can_be_limited():
    learner = make(C3POConfig(frames_per_batch=80, batch_size=80, max_grad_norm=1e-3))
    before = copy.deepcopy(learner.network.state_dict())
    loss = sum(parameter.square().sum() for parameter in learner.network.parameters())
    learner.step(torch.optim.SGD(learner.network.parameters(), lr=1.0), loss * 1e6)
    change = sum((learner.network.state_dict()[name] - old).square().sum() for name, old in before.items())
    assert change.sqrt().item() == pytest.approx(1e-3, rel=1e-2)
