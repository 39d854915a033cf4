"""Parameters of the learners: ranges, and a module that does not import torch."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from visualrhp.errors import ConfigError
from visualrhp.learning.configs import ActorCriticImitationConfig, C3POConfig, DQNConfig, QImitationConfig


@pytest.mark.parametrize(
    ("kind", "parameter", "value"),
    [
        (QImitationConfig, "lr", 0.0),
        (QImitationConfig, "batch_size", 0),
        (QImitationConfig, "epochs", -1),
        (QImitationConfig, "lr_schedule", "linear"),
        (QImitationConfig, "validation_fraction", 1.0),
        (QImitationConfig, "margin_cost", -1.0),
        (ActorCriticImitationConfig, "likelihood_coefficient", 0.0),
        (ActorCriticImitationConfig, "entropy_coefficient", -0.1),
        (DQNConfig, "epsilon", 1.5),
        (DQNConfig, "target_update_interval", 0),
        (DQNConfig, "max_grad_norm", 0.0),
        (DQNConfig, "discount", 1.1),
        (DQNConfig, "l2_regularization", -1e-5),
        (C3POConfig, "gae_lambda", -0.1),
        (C3POConfig, "gae_lambda", 1.1),
        (C3POConfig, "clip_epsilon", 0.0),
        (C3POConfig, "frames_per_batch", 2.5),
        (C3POConfig, "baseline_step", 1),
    ],
)
def test_parameters_out_of_range_are_named(kind: Any, parameter: str, value: object) -> None:
    with pytest.raises(ConfigError, match=f"^{parameter}="):
        kind(**{parameter: value})


def test_a_minibatch_is_not_larger_than_what_is_collected() -> None:
    assert C3POConfig(batch_size=10, frames_per_batch=10).batch_size == 10
    with pytest.raises(ConfigError, match=r"batch_size=11: it should not exceed frames_per_batch=10"):
        C3POConfig(batch_size=11, frames_per_batch=10)


def test_the_parameters_do_not_import_torch() -> None:
    code = "import sys, visualrhp.learning.configs; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("kind", "parameter", "value"),
    [
        (QImitationConfig, "validation_fraction", 0.0),
        (ActorCriticImitationConfig, "entropy_coefficient", 0.0),
        (DQNConfig, "target_update_interval", None),
        (DQNConfig, "max_grad_norm", None),
        (DQNConfig, "epsilon", 0.0),
        (C3POConfig, "gae_lambda", 1.0),
    ],
)
def test_ends_of_the_ranges_are_allowed(kind: Any, parameter: str, value: object) -> None:
    assert getattr(kind(**{parameter: value}), parameter) == value


def test_defaults_are_those_of_the_paper() -> None:
    """Sec. 7.4."""
    dqn, c3po = DQNConfig(), C3POConfig()
    q, actor_critic = QImitationConfig(), ActorCriticImitationConfig()
    assert {config.discount for config in (q, actor_critic, dqn, c3po)} == {0.995}
    assert {config.batch_size for config in (q, actor_critic, dqn, c3po)} == {2000}
    assert (q.lr, actor_critic.lr, dqn.lr, c3po.lr) == (1e-4, 1e-4, 1e-5, 1e-5)
    assert q.margin_actions == 3
    assert (actor_critic.likelihood_coefficient, actor_critic.value_coefficient) == (0.5, 0.7)
    assert actor_critic.entropy_coefficient == 0.01
    assert (dqn.epsilon, dqn.epochs, dqn.frames_per_batch) == (0.2, 3, 2000)
    assert (c3po.frames_per_batch, c3po.baseline_epochs, c3po.policy_epochs) == (10_000, 20, 15)
    assert (c3po.clip_epsilon, c3po.entropy_coefficient) == (0.075, 0.1)
    assert (c3po.value_coefficient, c3po.baseline_value_coefficient) == (0.7, 0.35)
