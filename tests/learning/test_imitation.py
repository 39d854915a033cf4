"""Imitation: trivial problems are learned, and an interrupted training resumes bit-exactly."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.learning.motionless import CARTESIAN, IMAGE, data_of
from visualrhp.errors import CheckpointError, ConfigError, LearningError
from visualrhp.heuristics.networks import ActorCritic, QNetwork, make_network
from visualrhp.learning.configs import ActorCriticImitationConfig, QImitationConfig
from visualrhp.learning.imitation import ImitationLearner
from visualrhp.learning.imitation_data import ImitationData
from visualrhp.types import Metrics


def steering(count: int, action_space: str, seed: int = 0) -> ImitationData:
    """A trivial problem: go where the first feature points; the return is the second one."""
    generator = torch.Generator().manual_seed(seed)
    features = torch.randn(count, *CARTESIAN.shape, generator=generator)
    left = features[:, 0] > 0
    if action_space == "discrete":
        action = torch.where(left, 2, 3)
    else:
        action = torch.zeros(count, 4)
        action[:, 1] = torch.where(left, 0.8, -0.8)
    return ImitationData(
        observation=CARTESIAN,
        observations=features.numpy(),
        gripper_closed=torch.zeros(count, dtype=torch.bool),
        action=action,
        returns=-10.0 + 3.0 * features[:, 1].clamp(-2, 2),
        steps_to_go=torch.full((count,), 5),
        demonstration=torch.arange(count) // 4,
    )


def learner_for(action_space: str, epochs: int = 6, network_seed: int = 1, **options: object) -> ImitationLearner:
    torch.manual_seed(network_seed)
    kind = QImitationConfig if action_space == "discrete" else ActorCriticImitationConfig
    parameters = {"mirror": False, "lr": 3e-3, "batch_size": 128, "validation_fraction": 0.1, **options}
    config = kind(epochs=epochs, **parameters)  # pyright: ignore[reportArgumentType]
    return ImitationLearner(make_network(action_space, CARTESIAN), steering(1200, action_space), config, seed=0)


def last(learner: ImitationLearner) -> Metrics:
    return list(learner.run())[-1]


def test_a_trivial_discrete_problem_is_learned() -> None:
    metrics = last(learner_for("discrete", epochs=25))
    assert metrics["validation/agreement"] > 0.9
    assert metrics["validation/value_rmse"] < 1.2


def test_a_trivial_continuous_problem_is_learned() -> None:
    learner = learner_for("continuous", epochs=25, lr_schedule="cosine")
    metrics = last(learner)
    assert metrics["validation/value_rmse"] < 1.2
    probe = steering(200, "continuous", seed=7)
    with torch.no_grad():
        mean, std, _ = learner.network(torch.from_numpy(probe.observations), probe.gripper_closed)
    assert (mean[:, 1].sign() == probe.action[:, 1].sign()).float().mean() > 0.93
    assert std[:, 0].mean() < 0.2


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_a_resumed_training_ends_at_the_same_bits(tmp_path: Path, action_space: str) -> None:
    options = {"mirror": True, "lr_schedule": "cosine", "l2_regularization": 1e-4, "epochs": 4}
    uninterrupted = learner_for(action_space, **options)  # pyright: ignore[reportArgumentType]
    last(uninterrupted)
    interrupted = learner_for(action_space, **options)  # pyright: ignore[reportArgumentType]
    rows = interrupted.run()
    for _ in range(2):
        next(rows)
    interrupted.save(tmp_path / "state.safetensors")
    resumed = learner_for(action_space, network_seed=2, **options)  # pyright: ignore[reportArgumentType]
    resumed.load(tmp_path / "state.safetensors")
    assert [row["epoch"] for row in resumed.run()] == [3.0, 4.0]
    for name, tensor in uninterrupted.network.state_dict().items():
        assert torch.equal(tensor, resumed.network.state_dict()[name]), name
    assert [row["train/loss"] for row in resumed.history] == [row["train/loss"] for row in uninterrupted.history]


def test_l2_regularization_shrinks_the_weights() -> None:
    norms = []
    for l2_regularization in (0.0, 0.1):
        learner = learner_for("discrete", epochs=3, l2_regularization=l2_regularization)
        last(learner)
        norms.append(sum(parameter.square().sum().item() for parameter in learner.network.parameters()))
    assert norms[1] < norms[0]


def test_learning_rate_schedules() -> None:
    constant = [row["lr"] for row in learner_for("discrete", epochs=3).run()]
    assert constant == [3e-3] * 3
    cosine = [row["lr"] for row in learner_for("discrete", epochs=3, lr_schedule="cosine").run()]
    assert 3e-3 > cosine[0] > cosine[1] > cosine[2] > 0.0


def test_every_epoch_reports_what_the_curves_show() -> None:
    for action_space, terms in (
        ("discrete", {"train/selected", "train/unselected", "validation/agreement"}),
        ("continuous", {"train/log_likelihood", "train/entropy", "train/value_error"}),
    ):
        metrics = last(learner_for(action_space, epochs=1))
        common = {"epoch", "train/loss", "validation/loss", "validation/value_rmse", "samples_per_s", "lr"}
        assert common | terms <= set(metrics)


def test_images_are_learned_from() -> None:
    data = data_of("discrete", IMAGE)
    config = QImitationConfig(epochs=6, batch_size=16, lr=1e-3, validation_fraction=0.0)
    torch.manual_seed(0)
    losses = [row["train/loss"] for row in ImitationLearner(QNetwork(IMAGE), data, config, seed=0).run()]
    assert losses[-1] < 0.5 * losses[0]


def test_configuration_of_the_other_action_space_is_refused() -> None:
    with pytest.raises(ConfigError, match="QImitationConfig cannot train a network of the continuous"):
        ImitationLearner(ActorCritic(CARTESIAN), steering(20, "continuous"), QImitationConfig(), seed=0)


def test_state_of_the_other_action_space_is_refused(tmp_path: Path) -> None:
    learner_for("discrete").save(tmp_path / "state.safetensors")
    with pytest.raises(CheckpointError, match="another architecture"):
        learner_for("continuous").load(tmp_path / "state.safetensors")


def test_divergence_is_a_learning_error() -> None:
    learner = learner_for("continuous", epochs=1)
    with torch.no_grad():
        next(learner.network.parameters()).fill_(float("nan"))
    with pytest.raises(LearningError, match="diverged in epoch 1"):
        last(learner)
