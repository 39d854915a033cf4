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
        (C3POConfig, "gae_lambda", -0.1),
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
